"""A MuJoCo model as a scene: a coupling moves the tool to the hand, and its force is the answer."""

import math
from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import Any, Final, NoReturn

import mujoco
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import axes_of, check_parameter
from hapticnet.errors import SampleError, SettingsError, UserCodeError
from hapticnet.samples import PositionSample, Vector, checked_vector
from hapticnet_mujoco.model import PREFIX, STIFFEST, axes_from, compiled, couple, load, slides, tool_of

LONGEST_MOTION_US: Final = 100_000  # after a longer pause, physics makes only the steps of this time
FASTEST_M_PER_S: Final = 1.0  # highest speed of the tool's goal, also when the hand jumps
STRIDE: Final = 5  # steps of the model that a copy makes as one, so that 100 ms take it some 100 µs
FORCES: Final = "coupling", "contact"
WARNINGS: Final = int(mujoco.mjtWarning.mjNWARNING)
"""Number of MuJoCo's warnings: NaN, values that are too large, contacts that found no room."""

_PLACES: Final = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}  # numbers in qpos; else 1


class Physics:
    """The state of a model, and views of what each step reads and writes."""

    __slots__ = ("coupling_n", "ctrl", "data", "sum_n", "warnings")

    def __init__(self, model: Any, axes: int) -> None:
        self.data = mujoco.MjData(model)
        self.ctrl = self.data.ctrl[-axes:]  # the coupling's actuators are the last
        self.coupling_n = self.data.actuator_force[-axes:]
        self.sum_n = self.data.sensordata[-3:]  # of all contacts, in the axes of the world
        self.warnings = [self.data.warning[each] for each in range(WARNINGS)]


class Scene:
    """A body of a MuJoCo model that a hand moves. Satisfies `hapticnet.scene.base.HasStep`.

    Position 0 is the origin of `frame`, and force is positive where it pushes against its axis. Time is that of the
    positions: physics makes as many steps of the model as fit, and never waits. Euler's integrator is replaced by
    MuJoCo's implicit one.

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
        if mujoco.get_mju_user_warning() is None:  # else it writes MUJOCO_LOG.TXT; `_fail` raises warnings
            mujoco.set_mju_user_warning(lambda _: None)
        what = f"model {model}"
        for name, value, unit in (("stiffness", stiffness, "N/m"), ("mass", mass, "kg")):
            check_parameter(name, value, 1e-6, 1e9, unit)
        for name, value in (("scale", scale), ("force_scale", force_scale)):
            check_parameter(name, value, 1e-6, 1e6, "")
        if force not in FORCES:
            raise SettingsError(f"force is {force!r}; it must be {' or '.join(FORCES)}")
        along = axes_from(str(axes))
        spec = load(str(model))
        body = tool_of(spec, str(tool), what)
        whole = compiled(spec, what)
        check_parameter(f"{what}: timestep", whole.opt.timestep, 1e-5, 0.02, "s")
        number = body.id  # until the specification changes
        at_rest = mujoco.MjData(whole)
        if key:
            _begin_with(whole, at_rest, str(key), what)
        mujoco.mj_forward(whole, at_rest)

        if frame:
            site = mujoco.mj_name2id(whole, mujoco.mjtObj.mjOBJ_SITE, str(frame))
            if site < 0 or whole.body_weldid[whole.site_bodyid[site]]:
                raise SettingsError(f"{what}: frame {frame!r} must be the name of a site that is fixed to the world")
            turned = at_rest.site_xmat[site].reshape(3, 3)
        else:
            frame, turned = f"{PREFIX} frame", np.eye(3)
            spec.worldbody.add_site(name=frame, pos=at_rest.xipos[number])
        is_free = any(each.type == mujoco.mjtJoint.mjJNT_FREE for each in body.joints)
        if is_free or body.mocap or not whole.body_weldid[number]:
            rotation = at_rest.xmat[number].reshape(3, 3)
            armature_kg = max(mass - float(whole.body_subtreemass[number]), 0.0)
            slides(spec, body, [coordinate for coordinate, _ in along], turned.T @ rotation, armature_kg)
        couple(spec, body, whole.body_ipos[number], frame, along)
        for each in list(spec.keys):  # they fit the joints and actuators of the file
            spec.delete(each)

        self._model = compiled(spec, what)
        self.axes = len(along)
        self.name = f"mujoco:{Path(str(model)).stem}"[:64]
        hurried = copy(self._model)
        for each in (self._model, hurried):
            if each.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:  # which takes the coupling's damping explicitly
                each.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        hurried.opt.timestep *= STRIDE
        self._models = {1: self._model, STRIDE: hurried}
        self._now, self._rest, spare = (Physics(self._model, self.axes) for _ in range(3))
        self._stock = [spare]  # data of deleted copies, for the next ones, because to make one takes a millisecond
        _copy_state(whole, at_rest, self._model, self._now.data)
        mujoco.mj_forward(self._model, self._now.data)
        # From a force that the tool exerts to what the hand feels
        self._signs = np.array([sign * turned[:, coordinate] for coordinate, sign in along])
        self._lead_s = self._damp(what, stiffness, self._now.data, self._signs)
        hurried.actuator_gainprm[:], hurried.actuator_biasprm[:] = (
            self._model.actuator_gainprm,
            self._model.actuator_biasprm,
        )
        mujoco.mj_copyData(self._rest.data, self._model, self._now.data)
        self._scale, self._force_scale, self._of_contact = scale, force_scale, force == "contact"
        self._step_ns = round(1e9 * self._model.opt.timestep)
        self._most_steps = math.ceil(1000 * LONGEST_MOTION_US / self._step_ns)
        self._begin_us: int | None = None
        self._steps = 0  # since `_begin_us`, those skipped after a pause too
        self._target_m: list[float] = self._now.data.actuator_length[-self.axes :].tolist()
        self._force_n: Vector = (0.0,) * self.axes

    def _damp(self, what: str, stiffness: float, data: Any, along: FloatArray) -> list[float]:
        """Set stiffness and damping of the coupling; return damping over stiffness [s] of each axis.

        The damping is critical for the mass that the tool has along an axis at rest; an axis along which it can hardly
        move counts as ten times as heavy as the lightest.
        """
        model = self._model
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"{PREFIX} tool").id)
        rows = np.ascontiguousarray(along @ jacobian)
        moved = np.zeros_like(rows)
        mujoco.mj_solveM(model, data, moved, rows)
        per_kg = (rows * moved).sum(axis=1)
        mass_kg = 1.0 / np.maximum(per_kg, max(0.1 * per_kg.max(), 1e-6))
        step_s = model.opt.timestep
        if mass_kg.min() < stiffness * step_s**2 / STIFFEST:
            raise SettingsError(
                f"{what}: the tool moves like {1e3 * mass_kg.min():.3g} g, too light for a coupling of"
                f" {stiffness:g} N/m at steps of {1e3 * step_s:g} ms: give it a stiffness of at most"
                f" {0.99 * mass_kg.min() * STIFFEST / step_s**2:.3g}, more mass, or the model a shorter timestep"
            )
        damping = 2.0 * np.sqrt(stiffness * mass_kg)
        model.actuator_gainprm[-self.axes :, 0] = stiffness
        model.actuator_biasprm[-self.axes :, 1] = -stiffness
        model.actuator_biasprm[-self.axes :, 2] = -damping
        lead_s: list[float] = (damping / stiffness).tolist()
        return lead_s

    def step(self, sample: PositionSample) -> Vector:
        """Return the force [N] at a position; UserCodeError if physics has failed."""
        position_m = checked_vector(sample.position_m, "position")
        if len(position_m) != self.axes:
            raise SampleError(f"position has {axes_of(len(position_m))}; the scene has {self.axes}")
        if self._begin_us is None:
            self._begin_us = sample.t_us
            # The tool goes to the hand before time begins
            self._move(position_m, self._most_steps, 1e-9 * self._step_ns * self._most_steps)
            self._steps = 0
        elapsed_ns = 1000 * (sample.t_us - self._begin_us)
        due = elapsed_ns // self._step_ns - self._steps
        if due > 0:
            steps = min(due, self._most_steps)
            self._steps += due - steps
            self._move(position_m, steps, 1e-9 * (elapsed_ns - self._steps * self._step_ns))
        return self._force_n

    def _move(self, position_m: Vector, steps: int, time_s: float) -> None:
        """Make so many steps, in which the target moves evenly to where the position is after a time."""
        now, target_m, scale = self._now, self._target_m, self._scale
        speeds = [
            min(max((scale * x - at) / time_s, -FASTEST_M_PER_S), FASTEST_M_PER_S)
            for x, at in zip(position_m, target_m, strict=True)
        ]
        for each, count in self._pace(steps):
            move_s = 1e-9 * self._step_ns * each
            for _ in range(count):
                for index, speed in enumerate(speeds):
                    target_m[index] += speed * move_s
                    now.ctrl[index] = target_m[index] + self._lead_s[index] * speed
                mujoco.mj_step(self._models[each], now.data)
        self._steps += steps
        for warning in now.warnings:
            if warning.number:
                self._fail()
        felt_n = self._signs @ now.sum_n if self._of_contact else now.coupling_n
        self._force_n = tuple([self._force_scale * each for each in felt_n.tolist()])

    def _pace(self, steps: int) -> Iterable[tuple[int, int]]:
        """Return pairs: how many times the timestep of the model one step is, and how many such steps to make."""
        return ((1, steps),)

    def _fail(self) -> NoReturn:
        """Begin again at rest, and raise UserCodeError."""
        kind, warning = next((kind, each) for kind, each in enumerate(self._now.warnings) if each.number)
        words = mujoco.mju_warningText(kind, warning.lastinfo)
        mujoco.mj_copyData(self._now.data, self._model, self._rest.data)
        self._target_m = self._rest.data.actuator_length[-self.axes :].tolist()
        raise UserCodeError(f"{self.name}: physics has failed and begins again at rest: {words}")

    def copy(self) -> "Scene":
        """Return a scene in the same state, which shares the model."""
        other = object.__new__(_Copy)
        other.__dict__.update(self.__dict__)
        other._target_m = self._target_m[:]
        other._now = self._stock.pop() if self._stock else Physics(self._model, self.axes)
        mujoco.mj_copyData(other._now.data, self._model, self._now.data)
        return other


class _Copy(Scene):
    """A copy for predicting: it makes longer steps, and returns its data to the stock when it is deleted."""

    def _pace(self, steps: int) -> Iterable[tuple[int, int]]:
        return (STRIDE, steps // STRIDE), (1, steps % STRIDE)

    def __del__(self) -> None:
        self._stock.append(self._now)


def _begin_with(model: Any, data: Any, key: str, what: str) -> None:
    """Begin with a keyframe; SettingsError if there is none of this name."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, key)
    if number < 0:
        names = ", ".join(model.key(each).name for each in range(model.nkey))
        raise SettingsError(f"{what}: has no keyframe {key!r}; it has: {names or 'none'}")
    mujoco.mj_resetDataKeyframe(model, data, number)


def _copy_state(model: Any, data: Any, to_model: Any, to_data: Any) -> None:
    """Copy positions, velocities and controls of a model to one that has other joints at one body only."""
    for body in range(model.nbody):
        if model.body_dofnum[body] == to_model.body_dofnum[body] and model.body_dofnum[body]:
            joint, to_joint = model.body_jntadr[body], to_model.body_jntadr[body]
            dof, to_dof, dofs = model.body_dofadr[body], to_model.body_dofadr[body], model.body_dofnum[body]
            to_data.qvel[to_dof : to_dof + dofs] = data.qvel[dof : dof + dofs]
            places = sum(_PLACES.get(each, 1) for each in model.jnt_type[joint : joint + model.body_jntnum[body]])
            place, to_place = model.jnt_qposadr[joint], to_model.jnt_qposadr[to_joint]
            to_data.qpos[to_place : to_place + places] = data.qpos[place : place + places]
    to_data.ctrl[: model.nu] = data.ctrl
