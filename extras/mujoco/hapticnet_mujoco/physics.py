"""What every MuJoCo scene shares: steps that follow the time of the positions, copies for predicting, and faults."""

import math
from collections.abc import Iterable, Sequence
from copy import copy
from itertools import accumulate
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, NoReturn, Self

import mujoco
import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import axes_of, check_parameter
from hapticnet.errors import SampleError, SettingsError, UserCodeError
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.shapes import Shape
from hapticnet_mujoco.looks import Looks
from hapticnet_mujoco.model import STIFFEST, compiled, load, tool_of

LONGEST_MOTION_US: Final = 100_000  # after a longer pause, physics makes only the steps of this time
STRIDE: Final = 5  # steps of the model that a copy makes as one, so that 100 ms take it some 100 µs
FORCES: Final = "coupling", "contact"  # what a scene may answer
LARGEST: Final = 1e6  # of any number of a position
WARNINGS: Final = int(mujoco.mjtWarning.mjNWARNING)
"""Number of MuJoCo's warnings: NaN, values that are too large, contacts that found no room."""

_PLACES: Final = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}  # numbers in qpos; else 1


class Unchanged:
    """A user's model before anything is added to it, at rest or at a keyframe; SettingsError if it cannot be used."""

    def __init__(self, model: str, tool: str, key: str) -> None:
        if mujoco.get_mju_user_warning() is None:  # else it writes MUJOCO_LOG.TXT; scenes raise warnings
            mujoco.set_mju_user_warning(lambda _: None)
        self.what = f"model {model}"
        self.name = f"mujoco:{Path(model).stem}"[:64]
        self.spec = load(model)
        self.body = tool_of(self.spec, tool, self.what)
        self.model = compiled(self.spec, self.what)
        check_parameter(f"{self.what}: timestep", self.model.opt.timestep, 1e-5, 0.02, "s")
        self.number = self.body.id  # until the specification changes
        self.data = mujoco.MjData(self.model)
        if key:
            self._begin_with(key)
        mujoco.mj_forward(self.model, self.data)

    @property
    def moves_freely(self) -> bool:
        """Whether the tool is a free body, a mocap body or fixed to the world, and so has no joints to keep."""
        is_free = any(each.type == mujoco.mjtJoint.mjJNT_FREE for each in self.body.joints)
        return is_free or bool(self.body.mocap) or not self.model.body_weldid[self.number]

    def fixed_site(self, name: str) -> int:
        """Return the number of a site that is fixed to the world; SettingsError if there is none of this name."""
        site = int(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name))
        if site < 0 or self.model.body_weldid[self.model.site_bodyid[site]]:
            raise SettingsError(f"{self.what}: frame {name!r} must be the name of a site that is fixed to the world")
        return site

    def _begin_with(self, key: str) -> None:
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, key)
        if number < 0:
            names = ", ".join(self.model.key(each).name for each in range(self.model.nkey))
            raise SettingsError(f"{self.what}: has no keyframe {key!r}; it has: {names or 'none'}")
        mujoco.mj_resetDataKeyframe(self.model, self.data, number)


class Physics:
    """The state of a model, and views of what each step reads and writes."""

    __slots__ = ("coupling_n", "ctrl", "data", "hand_m", "hand_quat", "sum_n", "warnings")

    def __init__(self, model: Any, axes: int) -> None:
        self.data = mujoco.MjData(model)
        self.ctrl = self.data.ctrl[-axes:]  # the coupling's actuators are the last
        self.coupling_n = self.data.actuator_force[-axes:]
        if model.nmocap:  # of a pose that is followed, the hand's body is the last
            self.hand_m, self.hand_quat = self.data.mocap_pos[-1], self.data.mocap_quat[-1]
        self.sum_n = self.data.sensordata[-3:]  # of all contacts, in the axes of the world
        self.warnings = [self.data.warning[each] for each in range(WARNINGS)]


class Gains(NamedTuple):
    """Stiffness of the coupling along a group of axes, and the units in which its errors are told."""

    axes: int
    stiffness: float
    unit: str
    of_mass: str


class Coupled:
    """A model whose tool follows a goal by a coupling, one actuator for each axis of a position.

    Time is that of the positions: physics makes as many steps of the model as fit, and never waits. Euler's integrator
    is replaced by MuJoCo's implicit one, because it takes the coupling's damping explicitly. A subclass adds the
    coupling to the specification before, sets its gains and `_looks`, and calls `_begin` with the goal at rest and the
    highest speed of each of its numbers.
    """

    _looks: Looks

    _bends: ClassVar = False  # True for heavy tools, whose damping errs by newtons at a wrong speed

    def __init__(self, own: Unchanged, axes: int) -> None:
        for each in list(own.spec.keys):  # they fit the joints and actuators of the file
            own.spec.delete(each)
        self._model = compiled(own.spec, own.what)
        if self._model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:
            self._model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.axes, self.name, self._what = axes, own.name, own.what
        self._now = Physics(self._model, axes)
        _copy_state(own.model, own.data, self._model, self._now.data)
        mujoco.mj_forward(self._model, self._now.data)
        self._is_copy = self._is_ahead = False  # a copy that has looked far ahead

    def shapes(self) -> list[Shape]:
        """Return how the model looks."""
        return self._looks.shapes(self._now.data)

    def _damp(self, gains: Sequence[Gains]) -> list[float]:
        """Set stiffness and damping of the coupling; return damping over stiffness [s] of each axis.

        The damping is critical for the mass that the tool has along an axis at rest; an axis along which it can hardly
        move counts as ten times as heavy as the lightest of its group. SettingsError if the steps are too long.
        """
        model, data = self._model, self._now.data
        rows = self._moments()
        moved = np.zeros_like(rows)
        mujoco.mj_solveM(model, data, moved, rows)
        per_mass = (rows * moved).sum(axis=1)
        step_s, first, lead_s = model.opt.timestep, 0, []
        for axes, stiffness, unit, of_mass in gains:
            those = slice(first, first + axes)
            mass = 1.0 / np.maximum(per_mass[those], max(0.1 * per_mass[those].max(), 1e-6))
            if mass.min() < stiffness * step_s**2 / STIFFEST:
                raise SettingsError(
                    f"{self._what}: the tool moves like {mass.min():.3g} {of_mass}, too light for a coupling of"
                    f" {stiffness:g} {unit} at steps of {1e3 * step_s:g} ms: give it a stiffness of at most"
                    f" {0.99 * mass.min() * STIFFEST / step_s**2:.3g}, more mass, or the model a shorter timestep"
                )
            damping = 2.0 * np.sqrt(stiffness * mass)
            actuators = slice(model.nu - self.axes + first, model.nu - self.axes + first + axes)
            model.actuator_gainprm[actuators, 0] = stiffness
            model.actuator_biasprm[actuators, 1] = -stiffness
            model.actuator_biasprm[actuators, 2] = -damping
            lead_s += (damping / stiffness).tolist()
            first += axes
        return lead_s

    def _moments(self) -> FloatArray:
        """Return how each degree of freedom moves each axis of the coupling."""
        model, data = self._model, self._now.data
        moments = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment.reshape(-1), data.moment_rownnz, data.moment_rowadr,
            data.moment_colind.reshape(-1),
        )  # fmt: skip
        return np.ascontiguousarray(moments[-self.axes :])

    def _begin(self, goal: Sequence[float], fastest: Sequence[float]) -> None:
        hurried = copy(self._model)
        hurried.opt.timestep *= STRIDE
        self._models = {1: self._model, STRIDE: hurried}
        self._rest, spare = (Physics(self._model, self.axes) for _ in range(2))
        self._stock = [spare]  # data of deleted copies, for the next ones, because to make one takes a millisecond
        mujoco.mj_copyData(self._rest.data, self._model, self._now.data)
        self._step_ns = round(1e9 * self._model.opt.timestep)
        self._most_steps = math.ceil(1000 * LONGEST_MOTION_US / self._step_ns)
        self._begin_us: int | None = None
        self._steps = 0  # since `_begin_us`, those skipped after a pause too
        self._goal_at_rest, self._fastest = tuple(goal), tuple(fastest)
        self._goal = list(goal)
        self._speeds = [0.0] * len(goal)
        self._force_n: Vector = (0.0,) * self.axes

    def step(self, sample: PositionSample) -> Vector:
        """Return the force at a position; SampleError if it is invalid, UserCodeError if physics has failed."""
        position = sample.position_m
        if len(position) != self.axes:
            raise SampleError(f"position has {axes_of(len(position))}; the scene has {self.axes}")
        if not all(-LARGEST <= each <= LARGEST for each in position):  # False for NaN
            raise SampleError(f"position {position} must be finite numbers of at most {LARGEST:g}")
        if self._begin_us is None:
            self._begin_us = sample.t_us
            for _ in range(2):  # the tool goes to the hand and comes to rest there before time begins
                self._move(position, self._most_steps, 1e-9 * self._step_ns * self._most_steps)
            self._steps = 0
        elapsed_ns = 1000 * (sample.t_us - self._begin_us)
        due = elapsed_ns // self._step_ns - self._steps
        if due > 0:
            steps = min(due, self._most_steps)
            self._steps += due - steps
            self._move(position, steps, 1e-9 * (elapsed_ns - self._steps * self._step_ns))
        return self._force_n

    def _move(self, position: Vector, steps: int, time_s: float) -> None:
        """Make so many steps, in which the goal moves to where the position is after a time."""
        now, goal = self._now, self._goal
        means = [
            min(max((x - at) / time_s, -most), most)
            for x, at, most in zip(self._goal_of(position), goal, self._fastest, strict=True)
        ]
        for each, speeds, end_speeds in self._path(steps, means):
            move_s = 1e-9 * self._step_ns * each
            for index, speed in enumerate(speeds):
                goal[index] += speed * move_s
            self._pull(now, goal, end_speeds, move_s)
            mujoco.mj_step(self._models[each], now.data)
        self._steps += steps
        for warning in now.warnings:
            if warning.number:
                self._fail()
        self._force_n = self._felt(now)

    def _goal_of(self, position: Vector) -> Sequence[float]:
        """Return the goal of a position of the hand."""
        return position

    def _pull(self, now: Physics, goal: Sequence[float], speeds: Sequence[float], move_s: float) -> None:
        """Set the actuators for a goal that has these speeds, `move_s` after the goal before."""
        raise NotImplementedError

    def _felt(self, now: Physics) -> Vector:
        """Return the force that the hand feels."""
        raise NotImplementedError

    def _path(self, steps: int, means: list[float]) -> Iterable[tuple[int, list[float], list[float]]]:
        """Return for each step how many timesteps it is long, and the speeds of the goal in it and at its end.

        A copy makes longer steps. If the goal `bends`, it speeds up or slows down evenly in the first long move of a
        copy, from the speed that it has, and keeps the speed that it has reached in later moves.
        """
        before, self._speeds = self._speeds, means
        if not self._is_copy or (steps < STRIDE and not self._is_ahead):
            return ((1, means, means),) * steps
        lengths = (STRIDE,) * (steps // STRIDE) + (1,) * (steps % STRIDE)
        if not self._bends:
            return [(length, means, means) for length in lengths]
        if self._is_ahead:
            self._speeds = before
            return [(length, means, before) for length in lengths]
        self._is_ahead = True
        self._speeds = [2.0 * mean - speed for mean, speed in zip(means, before, strict=True)]
        change = [2.0 * (mean - speed) / steps for mean, speed in zip(means, before, strict=True)]
        return [
            (
                length,
                [speed + (end - 0.5 * length) * by for speed, by in zip(before, change, strict=True)],
                [speed + end * by for speed, by in zip(before, change, strict=True)],
            )
            for length, end in zip(lengths, accumulate(lengths), strict=True)
        ]

    def _fail(self) -> NoReturn:
        """Begin again at rest, and raise UserCodeError."""
        kind, warning = next((kind, each) for kind, each in enumerate(self._now.warnings) if each.number)
        words = mujoco.mju_warningText(kind, warning.lastinfo)
        mujoco.mj_copyData(self._now.data, self._model, self._rest.data)
        self._goal[:], self._speeds = self._goal_at_rest, [0.0] * len(self._goal)
        raise UserCodeError(f"{self.name}: physics has failed and begins again at rest: {words}")

    def copy(self) -> Self:
        """Return a scene in the same state, which shares the model. It makes longer steps."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._is_copy = True
        other._goal = self._goal[:]
        other._now = self._stock.pop() if self._stock else Physics(self._model, self.axes)
        mujoco.mj_copyData(other._now.data, self._model, self._now.data)
        return other

    def __del__(self) -> None:
        if self.__dict__.get("_is_copy"):
            self._stock.append(self._now)


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
