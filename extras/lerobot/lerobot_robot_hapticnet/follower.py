"""The scene beside the robot: a LeRobot robot follows the hand, and the force that it reports is the answer.

A robot on a serial bus answers in 5 to 20 ms, and a scene must not wait: a thread talks to the robot at `rate_hz`, and
`Follower.step` takes the newest force.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from lerobot.robots import Robot, RobotConfig, make_robot_from_config

from hapticnet.checks import check_parameter
from hapticnet.errors import HapticnetError, SettingsError, UnavailableError
from hapticnet.rotations import inverse, product, quaternion_of, toward, vector_near
from hapticnet.samples import PositionSample
from lerobot_robot_hapticnet.config import Joints

LOG: Final = logging.getLogger("hapticnet")
FRESH_S: Final = 0.1  # age of the robot's last observation from which the force decays; it is zero at twice this age
LOST_S: Final = 1.0  # age at which the session ends
SILENT_S: Final = 0.5  # time without positions after which the robot's goal is where it is


class Follower:
    """A LeRobot robot that follows a hand, by differences from where it is when a session begins.

    `type` is a robot, or the name of a robot's type whose configuration has the keys ``config``. `joints`, `turns` and
    `gripper` are those of `Joints`, with their units. The force of a joint or gripper is the observation
    ``NAME.force`` (`force` gives another ending) times `newtons_per_unit`, and the torque of a turn ``NAME.torque``
    (`torque`) times `newton_metres_per_unit`; they are positive if they push towards smaller values. With an empty
    ending, or if the robot reports none, it is the tracking error (goal minus position) times `stiffness` [N/m of the
    hand], `turn_stiffness` [N·m/rad] or `grip_stiffness` [N/m]. The goal moves at most at `speed` [m/s of the hand] and
    turns at most at `turn_speed` [rad/s].

    If a `clock` [s] is given, no thread is started, and the caller must call `cycle`. Raises SettingsError if an option
    is invalid or the robot cannot be connected.
    """

    shared = True  # all sessions move the same robot

    def __init__(
        self,
        type: str | Robot,  # noqa: A002 - LeRobot's name for it
        joints: str = "x",
        units_per_m: float = 1.0,
        stiffness: float = 200.0,
        force: str = "force",
        newtons_per_unit: float = 1.0,
        rate_hz: float = 60.0,
        speed: float = 0.25,
        turns: str = "",
        gripper: str = "",
        units_per_rad: float = 1.0,
        gripper_units_per_m: float = 1.0,
        turn_stiffness: float = 1.0,
        grip_stiffness: float = 200.0,
        torque: str = "torque",
        newton_metres_per_unit: float = 1.0,
        turn_speed: float = 1.0,
        clock: Callable[[], float] | None = None,
        **config: Any,
    ) -> None:
        self._joints = described = Joints(
            joints=joints, turns=turns, gripper=gripper, units_per_m=units_per_m, units_per_rad=units_per_rad,
            gripper_units_per_m=gripper_units_per_m,
        )  # fmt: skip
        names, keys = described.names, described.position_keys
        self._units, self._keys, self.parts = described.units, keys, described.parts
        self._turn_at = described.turn_at if described.has_vector else slice(0)
        check_parameter("stiffness", stiffness, 0.0, 1e5, "N/m")
        check_parameter("turn_stiffness", turn_stiffness, 0.0, 1e3, "N·m/rad")
        check_parameter("grip_stiffness", grip_stiffness, 0.0, 1e5, "N/m")
        check_parameter("newtons_per_unit", newtons_per_unit, -1e6, 1e6)
        check_parameter("newton_metres_per_unit", newton_metres_per_unit, -1e6, 1e6)
        check_parameter("rate_hz", rate_hz, 1.0, 1000.0, "Hz")
        check_parameter("speed", speed, 1e-3, 10.0, "m/s")
        check_parameter("turn_speed", turn_speed, 1e-2, 100.0, "rad/s")
        self._stiffness = described.by_kind(stiffness, turn_stiffness, grip_stiffness)
        self._scale = described.by_kind(newtons_per_unit, newton_metres_per_unit, newtons_per_unit)
        self._speed = described.by_kind(speed, turn_speed, speed)
        self._robot = made(type, config) if isinstance(type, str) else type
        self.name = f"LeRobot {self._robot.name}"[:60]
        missing = [key for key in keys if key not in self._robot.action_features]
        if missing:
            raise SettingsError(
                f"{self.name} has no {', '.join(missing)}; it has: {', '.join(self._robot.action_features)}"
            )
        # What the robot reports, by part; None where the tracking error counts
        endings = described.by_kind(0.0, 1.0, 0.0)
        reported = [
            f"{name}.{ending}" if ending and f"{name}.{ending}" in self._robot.observation_features else None
            for name, ending in zip(names, [torque if each else force for each in endings], strict=True)
        ]
        kinds = described.by_kind(0.0, 1.0, 2.0)
        lacking = {kind for kind, key in zip(kinds, reported, strict=True) if key is None}
        self._felt_keys = [None if kind in lacking else key for kind, key in zip(kinds, reported, strict=True)]
        self._lock = threading.Lock()
        self._clock = clock or time.monotonic
        self._origin: tuple[Sequence[float], Sequence[float]] | None = None  # of the hand, and of the robot
        self._moves = False  # whether positions come
        self._goal: list[float] | None = None  # [m, rad, m] of the hand
        self._stepped_s, self._master = -math.inf, ""
        self._felt = [0.0] * len(names)
        self._fault: str | None = None
        self._ended = threading.Event()
        try:
            if not self._robot.is_connected:
                self._robot.connect(calibrate=False)
            first = self._robot.get_observation()
        except Exception as error:
            raise SettingsError(f"{self.name}: {one_line(error)}") from error
        # Joints that the hand does not move keep their first position as goal; some robots want all in each action.
        self._others = {key: first[key] for key in self._robot.action_features if key not in keys and key in first}
        self._at = self._read(first)
        self._seen_s = self._clock()
        if clock is None:
            self._thread = threading.Thread(target=self._run, args=(1.0 / rate_hz,), name=self.name, daemon=True)
            self._thread.start()

    def welcome(self, master: str) -> None:
        """Refuse a master while another one moves the robot."""
        if self._clock() - self._stepped_s < SILENT_S and master != self._master:
            raise UnavailableError(f"another master moves {self.name}; {master} must wait until that one has finished")
        with self._lock:
            self._origin, self._master = None, master

    def step(self, sample: PositionSample) -> list[float]:
        """Set the robot's goal, and return the newest force [N], torque [N·m] and grip [N].

        UnavailableError if the robot has stopped.
        """
        with self._lock:
            now_s = self._clock()
            age_s = now_s - self._seen_s
            if self._fault is not None:
                raise UnavailableError(self._fault)
            if age_s > LOST_S:
                raise UnavailableError(f"{self.name} has not answered for {LOST_S:g} s")
            if self._origin is None or self._goal is None:
                self._origin, self._goal = (sample.position_m, tuple(self._at)), list(self._at)
                self._moves = False
            self._move(sample.position_m, *self._origin, self._goal, now_s - self._stepped_s if self._moves else 0.0)
            self._moves, self._stepped_s = True, now_s
            share = min(max(2.0 - age_s / FRESH_S, 0.0), 1.0)
            return [share * each for each in self._felt]

    def _move(
        self, hand: Sequence[float], began: Sequence[float], robot: Sequence[float], goal: list[float], passed_s: float
    ) -> None:
        """Move the goal as the hand has moved since it `began` with the robot at `robot`, at most at the speeds."""
        turned = self._turn_at
        for axis, speed in enumerate(self._speed):
            if not turned.start or not turned.start <= axis < turned.stop:
                lacks = robot[axis] + hand[axis] - began[axis] - goal[axis]
                goal[axis] += min(max(lacks, -speed * passed_s), speed * passed_s)
        if turned.start:
            now, start, home, last = [quaternion_of(tuple(each[turned])) for each in (hand, began, robot, goal)]
            wanted = product(product(now, inverse(start)), home)
            reached = toward(last, wanted, self._speed[turned.start] * passed_s)
            goal[turned] = vector_near(reached, tuple(goal[turned]))

    def cycle(self) -> None:
        """Send the goal to the robot and read its force. If positions stopped coming, its goal is where it is."""
        with self._lock:
            if self._moves and self._clock() - self._stepped_s > SILENT_S:
                self._moves, self._goal, self._felt = False, list(self._at), [0.0] * len(self._keys)
                LOG.warning("%s: no positions for %g s; it stays where it is", self.name, SILENT_S)
            goal = None if self._goal is None else tuple(self._goal)
        if goal is not None:
            self._robot.send_action({**self._others, **self._joints.action(goal)})
        observed = self._robot.get_observation()
        at = self._read(observed)
        errors = [
            stiffness * each for stiffness, each in zip(self._stiffness, self._errors(goal or at, at), strict=True)
        ]
        felt = [
            error if key is None else scale * float(observed[key])
            for key, scale, error in zip(self._felt_keys, self._scale, errors, strict=True)
        ]
        if not all(map(math.isfinite, (*at, *felt))):
            what = "a position" if not all(map(math.isfinite, at)) else "a force"
            raise ValueError(f"it reports {what} that is not finite: {observed}")
        with self._lock:
            self._at, self._seen_s = at, self._clock()
            if self._moves:
                self._felt = felt

    def _errors(self, goal: Sequence[float], at: Sequence[float]) -> list[float]:
        """Return how far the robot is from its goal."""
        errors = [to - each for to, each in zip(goal, at, strict=True)]
        if self._turn_at.start:
            to, reached = [quaternion_of(tuple(each[self._turn_at])) for each in (goal, at)]
            errors[self._turn_at] = vector_near(product(to, inverse(reached)))
        return errors

    def close(self) -> None:
        """Leave the robot where it is."""
        self._ended.set()
        if hasattr(self, "_thread"):
            self._thread.join(2.0)
        if self._robot.is_connected and self._fault is None:
            self._robot.disconnect()

    def _read(self, observed: dict[str, Any]) -> list[float]:
        return [float(observed[key]) / unit for key, unit in zip(self._keys, self._units, strict=True)]

    def _run(self, period_s: float) -> None:
        due_s = self._clock()
        while not self._ended.wait(max(0.0, due_s - self._clock())):
            due_s = max(due_s + period_s, self._clock())
            try:
                self.cycle()
            except Exception as error:  # a robot may raise anything
                self.fail(error)
                return

    def fail(self, error: BaseException) -> None:
        """End the session: the force goes to zero."""
        self._fault = f"{self.name} stopped: {one_line(error)}"
        LOG.error(self._fault)


def made(name: str, config: dict[str, Any]) -> Robot:
    """Return a robot of a type, with the keys of its configuration; SettingsError if that fails."""
    known = RobotConfig.get_known_choices()
    if name not in known:
        raise SettingsError(f"LeRobot knows no robot {name!r}; it knows: {', '.join(sorted(known))}")
    try:
        return make_robot_from_config(known[name](**config))
    except (TypeError, ValueError, ImportError, HapticnetError) as error:
        raise SettingsError(f"LeRobot cannot make {name!r}: {one_line(error)}") from error


def one_line(error: BaseException) -> str:
    """Return an error on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
