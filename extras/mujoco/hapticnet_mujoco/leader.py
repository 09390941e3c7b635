"""A simulated leader as an operator: an arm with a gripper that a hand holds, and the reflected force pushes it."""

from typing import Final

import mujoco
import numpy as np

from hapticnet.errors import SettingsError
from hapticnet.operator.base import Operator
from hapticnet.rotations import inverse, product, rotated, vector_near
from hapticnet.samples import PositionSample, Vector
from hapticnet_mujoco.pose import Pose, scalar_last
from hapticnet_mujoco.tasks import Task

HAND_N_PER_M: Final = 500.0  # of an arm that is tensed, as `hapticnet.operator.yielding` has it
HAND_NM_PER_RAD: Final = 3.0
FINGERS_N_PER_M: Final = 1000.0
"""Stiffness with which the hand holds the leader's tool and gripper; the last two are assumptions."""


class Leader(Pose):
    """A leader arm of a MuJoCo model, held by a hand. Satisfies `hapticnet.operator.base.Operator`.

    The hand is a spring with critical damping between the pose that it intends and the tool. The reflected force,
    torque and grip force act on the tool and the gripper, so that they give way. A sample is where the tool is.

    Parameters
    ----------
    model, tool, point, grip
        As for `Pose`. Default: the arm of this package.
    stiffness, turning_stiffness, grip_stiffness
        Of the hand [N/m, N·m/rad, N/m].
    intended
        What the hand intends: an operator with as many axes, or what `Task` takes, such as ``drawer+screw``.

    Raises SettingsError if the model or an option cannot be used.
    """

    def __init__(
        self,
        model: str = "leader",
        tool: str = "palm",
        point: str = "tip",
        grip: str = "opening",
        stiffness: float = HAND_N_PER_M,
        turning_stiffness: float = HAND_NM_PER_RAD,
        grip_stiffness: float = FINGERS_N_PER_M,
        intended: Operator | str = "drawer+screw+pad",
    ) -> None:
        super().__init__(
            model, tool, point, grip, stiffness=stiffness, turning_stiffness=turning_stiffness,
            grip_stiffness=grip_stiffness,
        )  # fmt: skip
        self._intended = Task(intended) if isinstance(intended, str) else intended
        if self._intended.axes != self.axes:
            raise SettingsError(f"the leader has {self.axes} axes, but what it intends has {self._intended.axes}")
        self.duration_us = self._intended.duration_us
        self._tool = self._model.body(tool).id
        self._opens = self._moments()[6:]  # how each joint moves the opening, if there is a gripper

    def feel(self, t_us: int, force_n: Vector) -> None:  # noqa: ARG002 - held until the next one
        """Push the tool with the force [N, N·m] held: positive towards smaller positions."""
        a, b, c, d, e, f, *grip = force_n
        push = rotated((-a, -b, -c), self._frame)
        data, applied = self._now.data, self._now.data.xfrc_applied[self._tool]
        lever = data.site_xpos[self._point] - data.xipos[self._tool]
        applied[:3] = push
        applied[3:] = np.add(rotated((-d, -e, -f), self._frame), np.cross(lever, push))
        if grip:
            data.qfrc_applied[:] = -grip[0] * self._opens[0]

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is at a time [µs], and how far its gripper is open."""
        self.step(PositionSample(t_us, self._intended.sample(t_us).position_m))
        data, quat = self._now.data, np.empty(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[self._point])
        back = inverse(self._frame)
        at: Vector = tuple((data.site_xpos[self._point] - self._at_rest_m).tolist())
        turned = vector_near(product(scalar_last(quat), inverse(self._turn_at_rest)))
        opening = data.actuator_length[-1:].tolist() if self.axes > 6 else []
        return PositionSample(t_us, (*rotated(at, back), *rotated(turned, back), *opening))
