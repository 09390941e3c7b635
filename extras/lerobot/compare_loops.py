"""Measure what README.md says: a session, beside JSON over TCP at the usual rates of a LeRobot loop.

python extras/lerobot/compare_loops.py

All run in virtual time with the same hand and the same simulated robot, which a loop asks 60 times a second. JSON over
TCP is what LeRobot's own remote robot does: one message with the action to the robot, one with the observation back.
A segment that is lost is sent again one round trip after three later ones have arrived, or after 200 ms and a round
trip, whichever is sooner; all behind it wait. The error is that of the force that the hand feels, against the force at
which the robot would come to rest with the hand where it is.
"""

import heapq
import itertools
import json
import sys
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

sys.path.insert(0, str(Path(__file__).parent / "tests"))
import_module("lerobot_interface")  # where LeRobot is not installed

import hapticnet as hn  # noqa: E402
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator  # noqa: E402
from hapticnet.operator.yielding import HANDS, GroundedSettings, YieldingOperator  # noqa: E402
from hapticnet.samples import PositionSample  # noqa: E402
from lerobot_robot_hapticnet import Follower, HapticnetSimulated, HapticnetSimulatedConfig  # noqa: E402

SECONDS: Final = 20.0
CYCLE_S: Final = 1.0 / 60.0
TCP_HEADERS: Final = 40  # IPv4 and TCP; each message is acknowledged by a segment of as many
FRAMING: Final = 6  # of a WebSocket or ZeroMQ message


def robot() -> HapticnetSimulated:
    """Return the robot."""
    made = HapticnetSimulated(HapticnetSimulatedConfig(id="it", calibration_dir=Path(mkdtemp())))
    made.clock = lambda: 0.0
    made.connect()
    return made


class Steps:
    """A hand on the wall that presses 3 mm deeper in the middle of every second, at a phase of its own."""

    axes, duration_us = 1, None

    def sample(self, t_us: int) -> PositionSample:
        """Return the position."""
        return PositionSample(t_us, (0.016 if self.since_s(t_us) >= 0.0 else 0.013 if t_us > 300_000 else 0.0,))

    @staticmethod
    def since_s(t_us: int) -> float:
        """Return the time since the step of this second; negative before it."""
        return t_us / 1e6 % 1.0 - 0.5 - 0.033 * (t_us // 1_000_000 % 7) / 7.0


def hand(kind: str) -> Any:
    """Return a hand that presses 20 mm, 10 mm behind the wall, again and again; or one of steps."""
    if kind == "steps":
        return Steps()
    motion = ScriptedOperator(InsertionSettings(approach_m=0.0, depth_m=0.020, insertions=20), np.random.default_rng(1))
    return motion if kind == "scripted" else YieldingOperator(motion, HANDS["arm"], GroundedSettings(max_force_n=8.0))


class Paced:
    """The follower and its robot, asked at the pace of its loop in the time of the positions."""

    axes = 1

    def __init__(self) -> None:
        self.now_s = self._due_s = 0.0
        self.robot = robot()
        self.robot.clock = self._clock
        self._follower = Follower(self.robot, units_per_m=1000.0, clock=self._clock)

    def step(self, sample: hn.PositionSample) -> list[float]:
        """Let the robot's loop go on until the time of this position."""
        now_s = sample.t_us / 1e6
        while self._due_s <= now_s:
            self.now_s = self._due_s
            self._follower.cycle()
            self._due_s += CYCLE_S
        self.now_s = now_s
        return self._follower.step(sample)

    def _clock(self) -> float:
        return self.now_s


def at_rest_n(position_m: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the force with which the robot comes to rest behind a hand that stays where it is."""
    config = HapticnetSimulatedConfig(calibration_dir=Path(mkdtemp()))
    series = 1.0 / (1.0 / config.wall_n_per_m + 1.0 / config.servo_n_per_m)
    return series * np.maximum(0.0, position_m - config.wall_mm / 1e3)


class Felt(NamedTuple):
    """What a hand felt."""

    t_us: Any
    position_m: Any
    force_n: Any
    kilobytes_per_s: float

    def rmse_n(self) -> float:
        """Return the error of the force."""
        return float(np.sqrt(np.mean((self.force_n - at_rest_n(self.position_m)) ** 2)))

    def late_ms(self) -> float:
        """Return the median time from a step of the hand to half of the force that it makes."""
        half_n = float(at_rest_n(np.array([0.013, 0.016])).mean())
        steps = np.flatnonzero((self.position_m[1:] > 0.015) & (self.position_m[:-1] < 0.015)) + 1
        late = [
            float(self.t_us[begun + found[0]] - self.t_us[begun]) / 1e3
            for begun, end in itertools.pairwise(steps)
            if len(found := np.flatnonzero(self.force_n[begun:end] > half_n))
        ]
        return float(np.median(late))


def session(kind: str, delay_s: float, loss: float, **options: Any) -> Felt:
    """Return the figures of a hapticnet session."""
    channel = f"delay={1e3 * delay_s:g}ms,loss={loss:g}"
    link = hn.virtual_link(
        scene=Paced(), operator=hand(kind), forward=channel, feedback=channel, seed=3, **options
    )  # fmt: skip
    link.run(seconds=SECONDS)
    samples, report = link.master_samples(), link.report()
    kilobytes = (report.forward_wire_bytes + report.feedback_wire_bytes) / SECONDS / 1e3
    return Felt(samples["t_us"], samples["position_m"], samples["held_n"], kilobytes)


class Tcp:
    """One direction of a connection: late by `delay_s`, in order, with retransmissions."""

    def __init__(self, delay_s: float, loss: float, period_s: float, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._delay_s, self._loss = delay_s, loss
        self._again_s = 2.0 * delay_s + min(3.0 * period_s, 0.2)
        self._last_s = 0.0
        self._flying: list[tuple[float, int, float]] = []
        self.bytes = 0

    def send(self, now_s: float, value: float, keys: dict[str, float]) -> None:
        """Send a message of these keys, which carries a value."""
        size = len(json.dumps(keys)) + FRAMING + TCP_HEADERS
        arrives_s = now_s + self._delay_s
        self.bytes += size + TCP_HEADERS
        while self._random.random() < self._loss:
            arrives_s += self._again_s
            self.bytes += size
        self._last_s = max(arrives_s, self._last_s)  # in order
        heapq.heappush(self._flying, (self._last_s, self.bytes, value))

    def newest(self, now_s: float) -> float | None:
        """Return the newest value that has arrived; None if nothing new has."""
        found = None
        while self._flying and self._flying[0][0] <= now_s:
            _, _, found = heapq.heappop(self._flying)
        return found


def json_over_tcp(kind: str, delay_s: float, loss: float, hz: float) -> Felt:
    """Return the figures of a loop at this rate, at both ends."""
    there, back = (Tcp(delay_s, loss, 1.0 / hz, seed) for seed in (5, 6))
    far, operator = robot(), hand(kind)
    now_s = felt_n = 0.0
    far.clock = lambda: now_s
    positions, forces = [], []
    due_s, far_due_s = 0.0, 0.5 / hz
    for tick in range(round(SECONDS * 1000)):
        now_s = tick / 1e3
        if hasattr(operator, "feel"):
            operator.feel(1000 * tick, (felt_n,))
        (at_m,) = operator.sample(1000 * tick).position_m
        positions.append(at_m)
        forces.append(felt_n)
        if now_s >= due_s:
            due_s += 1.0 / hz
            if (news := back.newest(now_s)) is not None:
                felt_n = news
            there.send(now_s, 1e3 * at_m, {"x.pos": 1e3 * at_m})
        if now_s >= far_due_s:
            far_due_s += 1.0 / hz
            if (arrived := there.newest(now_s)) is not None:
                far.send_action({"x.pos": arrived})
            observed = far.get_observation()
            seen = {key: observed[key] for key in ("x.pos", "x.force")}  # what a session of one axis carries
            back.send(now_s, seen["x.force"], seen)
    kilobytes = (there.bytes + back.bytes) / SECONDS / 1e3
    times = 1000 * np.arange(len(positions))
    return Felt(times, np.array(positions), np.array(forces), kilobytes)


def row(name: str, way: "Callable[..., Felt]", delay_s: float, loss: float, **options: Any) -> str:
    """Return a row of the table."""
    steps, scripted, arm = (way(kind, delay_s, loss, **options) for kind in ("steps", "scripted", "arm"))
    return (
        f"| {name} | {steps.late_ms():.0f} ms | {scripted.kilobytes_per_s:.1f} kB/s | {scripted.rmse_n():.2f} N"
        f" | {arm.rmse_n():.2f} N, up to {arm.force_n.max():.1f} N |"
    )


def main() -> None:
    """Print the tables."""
    for delay_s, loss in ((0.0, 0.0), (0.05, 0.05)):
        print(f"{1e3 * delay_s:g} ms each way, {loss:.0%} loss")
        for hz in (30.0, 60.0):
            print(row(f"JSON over TCP, {hz:g} Hz", json_over_tcp, delay_s, loss, hz=hz))
        for rate_hz in (500.0, 250.0):
            for codec in ("deadband", "motion-predictive"):
                for coupling in ("direct", "energy-bounded"):
                    name = f"`{codec}`, `{coupling}`, {rate_hz:g} Hz"
                    print(row(name, session, delay_s, loss, codec=codec, coupling=coupling, rate_hz=rate_hz))


if __name__ == "__main__":
    main()
