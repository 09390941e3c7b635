"""A MuJoCo model as a scene with a pose: a coupling moves, turns and closes the tool, and force and torque answer."""

from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.rotations import NO_TURN, Quaternion, inverse, product, quaternion_of, rotated, vector_near
from hapticnet.samples import Vector
from hapticnet_mujoco.looks import Looks
from hapticnet_mujoco.model import PREFIX, couple_pose, float_freely
from hapticnet_mujoco.physics import FORCES, Coupled, Gains, Physics, Unchanged

FASTEST_M_PER_S: Final = 1.0
FASTEST_RAD_PER_S: Final = 10.0
"""Highest speed of the tool's goal, also when the hand jumps."""


class Pose(Coupled):
    """A body of a MuJoCo model that a hand moves and turns, and its gripper. Satisfies `hapticnet.scene.base.HasStep`.

    A position is ``(x, y, z, rx, ry, rz)`` with x, y, z [m] and a rotation vector [rad] about the same axes; with a
    gripper, the opening [m] follows. The answer is the force of the coupling ``(fx, fy, fz)`` [N] and its torque about
    `point` ``(tx, ty, tz)`` [N·m], and with a gripper the grip force [N]. As everywhere in hapticnet, each is positive
    if it pushes the hand towards smaller values: fingers that hold something push the hand open, so that the grip force
    is negative then.

    The pose 0 is the one of `point` at rest. The rotation vector must be continuous; it may exceed a turn.

    Parameters
    ----------
    model
        Path of an MJCF file, or a model of this package: armbench or workbench.
    tool
        The body that the hand moves. If it is free, a mocap body or fixed to the world, it moves freely and has no
        weight; else it keeps its joints, as an arm.
    point
        A site of the tool, to which position and torque refer. Default: the origin of the tool's body.
    grip
        A joint, or a tendon, whose length is the opening of the gripper. Default: there is no gripper.
    frame
        A site that is fixed to the world: its axes are meant. Default: the world's axes.
    stiffness, turning_stiffness, grip_stiffness
        Of the coupling [N/m, N·m/rad, N/m]. It is damped critically.
    force
        ``coupling``: force and torque of the coupling, which include the tool's inertia, and an arm's friction.
        ``contact``: those of the contacts of the tool and its child bodies. The grip force is always the coupling's.
    key
        Keyframe to begin with.

    Raises SettingsError if the model or an option cannot be used.
    """

    _bends = True

    def __init__(
        self,
        model: str,
        tool: str,
        point: str = "",
        grip: str = "",
        frame: str = "",
        stiffness: float = 1000.0,
        turning_stiffness: float = 2.0,
        grip_stiffness: float = 1000.0,
        force: str = "coupling",
        key: str = "",
    ) -> None:
        gains = [Gains(3, stiffness, "N/m", "kg"), Gains(3, turning_stiffness, "N·m/rad", "kg·m²")]
        if grip:
            gains.append(Gains(1, grip_stiffness, "N/m", "kg at the gripper"))
        for name, each in zip(("stiffness", "turning_stiffness", "grip_stiffness"), gains, strict=False):
            check_parameter(name, each.stiffness, 1e-6, 1e9, each.unit)
        if force not in FORCES:
            raise SettingsError(f"force is {force!r}; it must be {' or '.join(FORCES)}")
        own = Unchanged(str(model), str(tool), str(key))
        self.parts = ("force:3", "torque:3", "grip:1") if grip else ("force:3", "torque:3")
        point = _point_of(own, str(point))
        opens = _opening_of(own, str(grip)) if grip else None
        self._frame: Quaternion = NO_TURN
        if frame:
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, own.data.site_xmat[own.fixed_site(str(frame))])
            self._frame = scalar_last(quat)
        if own.moves_freely:
            float_freely(own.spec, own.body)
        at_m, turn = _pose_of(own, point)
        couple_pose(own.spec, point, at_m, turn, opens)
        super().__init__(own, sum(each.axes for each in gains))
        self._at_rest_m: Vector = tuple(at_m.tolist())
        self._turn_at_rest = scalar_last(turn)
        self._turn = self._turn_at_rest
        self._lead_s = self._damp(gains)
        self._of_contact, self._point = force == "contact", self._model.site(point).id
        axes = own.data.site_xmat[own.fixed_site(str(frame))].reshape(3, 3).T if frame else np.eye(3)
        self._looks = Looks(self._model, self._now.data, at_m, axes)
        opening = self._now.data.actuator_length[-1:].tolist() if grip else []
        fastest = (FASTEST_M_PER_S,) * 3 + (FASTEST_RAD_PER_S,) * 3 + (FASTEST_M_PER_S,) * len(opening)
        self._begin((0.0,) * 6 + tuple(opening), fastest)

    def _pull(self, now: Physics, goal: Sequence[float], speeds: Sequence[float], move_s: float) -> None:
        x, y, z, rx, ry, rz, *opening = goal
        vx, vy, vz, _, _, _, *opens = speeds
        before, turn = self._turn, quaternion_of((rx, ry, rz))
        moved_m: Vector = (x, y, z)
        speed: Vector = (vx, vy, vz)
        if self._frame != NO_TURN:
            moved_m, speed = rotated(moved_m, self._frame), rotated(speed, self._frame)
            turn = product(product(self._frame, turn), inverse(self._frame))
        self._turn = turn = product(turn, self._turn_at_rest)
        a, b, c = moved_m
        at_x, at_y, at_z = self._at_rest_m
        now.hand_m[:] = at_x + a, at_y + b, at_z + c
        now.hand_quat[:] = turn[3], *turn[:3]
        # Speeds in the axes of the hand, in which the actuators pull
        back = inverse(turn)
        moving = *rotated(speed, back), *[each / move_s for each in vector_near(product(inverse(before), turn))], *opens
        ctrl = [lead_s * each for lead_s, each in zip(self._lead_s, moving, strict=True)]
        if opening:
            ctrl[6] += opening[0]
        now.ctrl[:] = ctrl

    def _felt(self, now: Physics) -> Vector:
        a, b, c, d, e, f, *grip = now.coupling_n.tolist()
        if self._of_contact:
            return *self._touched(now), *grip
        turn = product(inverse(self._frame), self._turn)
        return *rotated((a, b, c), turn), *rotated((d, e, f), turn), *grip

    def _touched(self, now: Physics) -> Vector:
        """Return the sum of the contact forces on the tool [N], and its torque about the point [N·m]."""
        a, b, c, d, e, f, *at_m = now.data.sensordata[-9:].tolist()
        x, y, z = [at - point for at, point in zip(at_m, now.data.site_xpos[self._point].tolist(), strict=True)]
        torque = d + y * c - z * b, e + z * a - x * c, f + x * b - y * a
        back = inverse(self._frame)
        return *rotated((a, b, c), back), *rotated(torque, back)


def scalar_last(quat: FloatArray) -> Quaternion:
    """Return a quaternion of MuJoCo as one of `hapticnet.rotations`."""
    w, x, y, z = quat.tolist()
    return x, y, z, w


def _point_of(own: Unchanged, name: str) -> str:
    """Return the name of a site of the tool, which is added if none is named; SettingsError if it is not the tool's."""
    if not name:
        own.body.add_site(name=f"{PREFIX} point")
        return f"{PREFIX} point"
    site = own.spec.site(name)
    if site is None or site.parent.name != own.body.name:
        names = ", ".join(each.name for each in own.body.sites if each.name)
        raise SettingsError(f"{own.what}: the tool {own.body.name!r} has no site {name!r}; it has: {names or 'none'}")
    return name


def _pose_of(own: Unchanged, point: str) -> tuple[FloatArray, FloatArray]:
    """Return position [m] and quaternion of a site at rest."""
    site, turn, at_m = own.spec.site(point), np.empty(4), np.empty(3)
    body_turn = own.data.xquat[own.number]
    mujoco.mju_rotVecQuat(at_m, np.array(site.pos), body_turn)
    mujoco.mju_mulQuat(turn, body_turn, np.array(site.quat))
    return at_m + own.data.xpos[own.number], turn


def _opening_of(own: Unchanged, name: str) -> tuple[int, str]:
    """Return the kind of transmission to a joint or tendon; SettingsError if there is none of this name."""
    for kind, trn in (("tendon", mujoco.mjtTrn.mjTRN_TENDON), ("joint", mujoco.mjtTrn.mjTRN_JOINT)):
        if getattr(own.spec, kind)(name) is not None:
            return trn, name
    names = ", ".join(each.name for each in (*own.spec.tendons, *own.spec.joints) if each.name)
    raise SettingsError(f"{own.what}: has no joint or tendon {name!r} as grip; it has: {names or 'none'}")
