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
from hapticnet.samples import PositionSample
from lerobot_robot_hapticnet.config import Joints

LOG: Final = logging.getLogger("hapticnet")
FRESH_S: Final = 0.1  # age of the robot's last observation from which the force decays; it is zero at twice this age
LOST_S: Final = 1.0  # age at which the session ends
SILENT_S: Final = 0.5  # time without positions after which the robot's goal is where it is


class Follower:
    """A LeRobot robot that follows one to three axes of a hand, by differences from where it is when a session begins.

    `type` is a robot, or the name of a robot's type whose configuration has the keys ``config``. The force of a joint
    is the observation ``JOINT.force`` (`force` gives another ending) times `newtons_per_unit`; it is positive if it
    pushes towards smaller values. With ``force=""``, or if the robot reports no force, it is the tracking error (goal
    minus position) times `stiffness` [N/m of the hand]. The goal moves at most at `speed` [m/s of the hand].

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
        clock: Callable[[], float] | None = None,
        **config: Any,
    ) -> None:
        self._joints = Joints(joints=joints, units_per_m=units_per_m)
        self._names = self._joints.names
        self.axes = len(self._names)
        check_parameter("stiffness", stiffness, 0.0, 1e5, "N/m")
        check_parameter("newtons_per_unit", newtons_per_unit, -1e6, 1e6)
        check_parameter("rate_hz", rate_hz, 1.0, 1000.0, "Hz")
        check_parameter("speed", speed, 1e-3, 10.0, "m/s")
        self._stiffness, self._scale, self._speed = stiffness, newtons_per_unit, speed
        self._robot = made(type, config) if isinstance(type, str) else type
        self.name = f"LeRobot {self._robot.name}"[:60]
        keys = [f"{name}.pos" for name in self._names]
        missing = [key for key in keys if key not in self._robot.action_features]
        if missing:
            raise SettingsError(
                f"{self.name} has no {', '.join(missing)}; it has: {', '.join(self._robot.action_features)}"
            )
        forces = [f"{name}.{force}" for name in self._names]
        self._forces = forces if force and all(each in self._robot.observation_features for each in forces) else None
        self._lock = threading.Lock()
        self._clock = clock or time.monotonic
        self._origin: tuple[Sequence[float], Sequence[float]] | None = None  # [m] of the hand, and of the robot
        self._moves = False  # whether positions come
        self._goal_m: list[float] | None = None
        self._stepped_s, self._master = -math.inf, ""
        self._force_n = [0.0] * self.axes
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
        self._at_m = self._read(first)
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
        """Set the robot's goal, and return the newest force [N]; UnavailableError if the robot has stopped."""
        with self._lock:
            now_s = self._clock()
            age_s = now_s - self._seen_s
            if self._fault is not None:
                raise UnavailableError(self._fault)
            if age_s > LOST_S:
                raise UnavailableError(f"{self.name} has not answered for {LOST_S:g} s")
            if self._origin is None or self._goal_m is None:
                self._origin, self._goal_m = (sample.position_m, tuple(self._at_m)), list(self._at_m)
                self._moves = False
            most_m = self._speed * (now_s - self._stepped_s) if self._moves else 0.0
            self._moves = True
            for axis, (hand, began, robot) in enumerate(zip(sample.position_m, *self._origin, strict=True)):
                lacks = robot + hand - began - self._goal_m[axis]
                self._goal_m[axis] += min(max(lacks, -most_m), most_m)
            self._stepped_s = now_s
            share = min(max(2.0 - age_s / FRESH_S, 0.0), 1.0)
            return [share * each for each in self._force_n]

    def cycle(self) -> None:
        """Send the goal to the robot and read its force. If positions stopped coming, its goal is where it is."""
        with self._lock:
            if self._moves and self._clock() - self._stepped_s > SILENT_S:
                self._moves, self._goal_m, self._force_n = False, list(self._at_m), [0.0] * self.axes
                LOG.warning("%s: no positions for %g s; it stays where it is", self.name, SILENT_S)
            goal_m = None if self._goal_m is None else tuple(self._goal_m)
        if goal_m is not None:
            self._robot.send_action({**self._others, **self._joints.action(goal_m)})
        observed = self._robot.get_observation()
        at_m = self._read(observed)
        if self._forces is not None:
            force_n = [self._scale * float(observed[key]) for key in self._forces]
        else:
            force_n = [self._stiffness * (to - at) for to, at in zip(goal_m or at_m, at_m, strict=True)]
        if not all(map(math.isfinite, (*at_m, *force_n))):
            raise ValueError(f"it reports {'a force' if self._forces else 'a position'} that is not finite: {observed}")
        with self._lock:
            self._at_m, self._seen_s = at_m, self._clock()
            if self._moves:
                self._force_n = force_n

    def close(self) -> None:
        """Leave the robot where it is."""
        self._ended.set()
        if hasattr(self, "_thread"):
            self._thread.join(2.0)
        if self._robot.is_connected and self._fault is None:
            self._robot.disconnect()

    def _read(self, observed: dict[str, Any]) -> list[float]:
        return [float(observed[f"{name}.pos"]) / self._joints.units_per_m for name in self._names]

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
