"""A MuJoCo model as a scene: a coupling moves the tool to the hand, and its force is the answer."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError
from hapticnet.samples import Vector
from hapticnet_mujoco.looks import Looks
from hapticnet_mujoco.model import PREFIX, axes_from, couple, slides
from hapticnet_mujoco.physics import FORCES, Coupled, Gains, Physics, Unchanged

FASTEST_M_PER_S: Final = 1.0  # highest speed of the tool's goal, also when the hand jumps


class Scene(Coupled):
    """A body of a MuJoCo model that a hand moves. Satisfies `hapticnet.scene.base.HasStep`.

    Position 0 is the origin of `frame`, and force is positive where it pushes against its axis.

    Parameters
    ----------
    model
        Path of an MJCF file, or a model of this package: arm, ball, block or drawer.
    tool
        The body that the hand moves. If it is free, a mocap body or fixed to the world, it can move along the axes
        only, and keeps its rotation; else it keeps its joints, as an arm.
    axes
        One to three axes of the frame, such as ``-z`` or ``-zxy``. The first is that into what is touched.
    frame
        A site that is fixed to the world. Default: the tool's centre of mass at rest, with the axes of the world.
    scale, force_scale
        Metres of the tool per metre of the hand, and newtons of the hand per newton of the tool.
    stiffness
        Of the coupling at the tool [N/m]. It is damped critically.
    mass
        Least inertia [kg] of a tool that moves along the axes only.
    force
        ``coupling``: that of the coupling, which includes the tool's inertia. ``contact``: the sum of the contact
        forces on the tool.
    key
        Keyframe to begin with.
    """

    def __init__(
        self,
        model: str,
        tool: str,
        axes: str = "-z",
        frame: str = "",
        scale: float = 1.0,
        force_scale: float = 1.0,
        stiffness: float = 1000.0,
        mass: float = 0.02,
        force: str = "coupling",
        key: str = "",
    ) -> None:
        for name, value, unit in (("stiffness", stiffness, "N/m"), ("mass", mass, "kg")):
            check_parameter(name, value, 1e-6, 1e9, unit)
        for name, value in (("scale", scale), ("force_scale", force_scale)):
            check_parameter(name, value, 1e-6, 1e6, "")
        if force not in FORCES:
            raise SettingsError(f"force is {force!r}; it must be {' or '.join(FORCES)}")
        along = axes_from(str(axes))
        own = Unchanged(str(model), str(tool), str(key))
        if frame:
            turned = own.data.site_xmat[own.fixed_site(str(frame))].reshape(3, 3)
        else:
            frame, turned = f"{PREFIX} frame", np.eye(3)
            own.spec.worldbody.add_site(name=frame, pos=own.data.xipos[own.number])
        if own.moves_freely:
            rotation = own.data.xmat[own.number].reshape(3, 3)
            armature_kg = max(mass - float(own.model.body_subtreemass[own.number]), 0.0)
            slides(own.spec, own.body, [coordinate for coordinate, _ in along], turned.T @ rotation, armature_kg)
        couple(own.spec, own.body, own.model.body_ipos[own.number], frame, along)
        super().__init__(own, len(along))
        # From a force that the tool exerts to what the hand feels
        self._signs = np.array([sign * turned[:, coordinate] for coordinate, sign in along])
        self._looks = Looks(self._model, self._now.data, self._now.data.site(frame).xpos, self._signs, scale)
        self._lead_s = self._damp([Gains(self.axes, stiffness, "N/m", "kg")])
        self._scale, self._force_scale, self._of_contact = scale, force_scale, force == "contact"
        goal_m = self._now.data.actuator_length[-self.axes :].tolist()
        self._begin(goal_m, (FASTEST_M_PER_S,) * self.axes)

    def _goal_of(self, position: Vector) -> Sequence[float]:
        return [self._scale * x for x in position]

    def _pull(self, now: Physics, goal: Sequence[float], speeds: Sequence[float], move_s: float) -> None:  # noqa: ARG002
        for index, (at, lead_s, speed) in enumerate(zip(goal, self._lead_s, speeds, strict=True)):
            now.ctrl[index] = at + lead_s * speed

    def _felt(self, now: Physics) -> Vector:
        felt_n = self._signs @ now.sum_n if self._of_contact else now.coupling_n
        return tuple([self._force_scale * each for each in felt_n.tolist()])
