"""How well the platform could follow the demo's force, and how well it does: the share of each cause in the error.

The limit knows the whole future. It is the cheapest sequence of setpoints, one for each servo frame, by dynamic
programming over the position of the platform (Bellman): exact up to its grid of 20 µm. Its idealisations make it a
lower bound: the finger, its position and the servos are known exactly, the gears have no play and the servos no
deadband, the sensor has no part in it, and the platform may retract beyond its end. It keeps what no software can
change: frames of 20 ms, lag, speed, the finger's stiffness, clamp and slew limit of the target.

Beside it, on the same ideal device: what can be done without the future. The same search is made at each frame for the
next 20 ms, as if the force continued along its present slope. Nothing causal can foresee a breach, so this is close to
the best of any loop without announcements.

The loop's rows are the whole chain in virtual time: session, codec, hold, limits, force loop, simulated device.
"""

import argparse
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import record
from finger_chain import CHAINS, chain, demo_target
from numpy.typing import NDArray

from hapticnet.control.finger import compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger
from hapticnet.hardware import MAX_FORCE_N, STIFFNESS_N_M

Numbers = NDArray[np.float64]

FRAME_MS: Final = 20
ARM_M: Final = 0.012
GRID_M: Final = 20e-6
AWAY_M: Final = 3e-3
"""Distance [m] before the finger at which the grid of positions begins: the platform covers half of it in a frame."""

PHASES_MS: Final = (0, 7)
FINGERS_N_M: Final = (300.0, 1000.0, 3000.0)
QUICK_CHAINS: Final = ("as it was", "deadband", "announced")
FALL_N: Final = 0.3
FALL_MS: Final = 100
"""Fall of the target [N] within a tick that counts as a breach, and the time [ms] after it that counts as its error."""


class IdealDevice:
    """Servos and finger without play, deadband and sensor; three servos move as one. Positions in m, one per ms."""

    def __init__(self, finger: Finger, servo: Servo) -> None:
        self.finger = finger
        self._speed_m_s = math.radians(servo.rate_deg_s) * ARM_M
        self._lag_s = servo.lag_s
        highest_m = finger.contact_m + 1.4 * compressed(MAX_FORCE_N) / finger.stiffness_n_m
        self.start_m = finger.contact_m - ForceControlSettings().clearance_m
        self.positions_m = np.arange(finger.contact_m - AWAY_M, highest_m, GRID_M)
        self.setpoints_m = np.arange(finger.contact_m - 2.0 * AWAY_M, highest_m + AWAY_M, GRID_M)

    def path_m(self, from_m: Any, setpoint_m: Any, ms: Any) -> Numbers:
        """Return where the platform is `ms` after a frame."""
        distance_m = np.abs(setpoint_m - from_m)
        slow_m = self._speed_m_s * self._lag_s
        fast_s = np.maximum(distance_m - slow_m, 0.0) / self._speed_m_s
        decayed_m = np.minimum(distance_m, slow_m) * np.exp(-np.maximum(1e-3 * ms - fast_s, 0.0) / self._lag_s)
        left_m = np.where(1e-3 * ms <= fast_s, distance_m - self._speed_m_s * 1e-3 * ms, decayed_m)
        return np.asarray(setpoint_m - np.sign(setpoint_m - from_m) * left_m)

    def force_n(self, position_m: Any) -> Numbers:
        """Return the force at positions, as `Finger.force_n`."""
        finger = self.finger
        compression_m = np.maximum(position_m - finger.contact_m, 0.0)
        growth = finger.stiffening * finger.stiffness_n_m
        return np.asarray((1.0 - finger.stiffening) / finger.stiffening * np.expm1(growth * compression_m))

    def follow(self, target_n: Numbers, phase_ms: int, setpoint_of: Callable[[int, float], float]) -> Numbers:
        """Return the force in each ms for a rule that chooses the setpoint of each frame."""
        position_m, setpoint_m = self.start_m, self.start_m
        force_n = np.zeros(len(target_n))
        steps = np.arange(1, FRAME_MS + 1)
        for start in range(phase_ms, len(target_n), FRAME_MS):
            setpoint_m = setpoint_of(start, position_m)
            path_m = self.path_m(position_m, setpoint_m, steps)
            here = force_n[start + 1 : start + 1 + FRAME_MS]
            here[:] = self.force_n(path_m[: len(here)])
            position_m = float(path_m[-1])
        return force_n


def with_the_future(device: IdealDevice, target_n: Numbers, phase_ms: int) -> Numbers:
    """Return the force of the best sequence of setpoints."""
    x_m, u_m = device.positions_m, device.setpoints_m
    steps = np.arange(1, FRAME_MS + 1)
    force_n = device.force_n(device.path_m(x_m[:, None, None], u_m[None, :, None], steps)).astype(np.float32)
    squares = (force_n**2).sum(-1)
    end_m = device.path_m(x_m[:, None], u_m[None, :], FRAME_MS)
    at = np.clip((end_m - x_m[0]) / GRID_M, 0.0, len(x_m) - 1.001)
    below = at.astype(int)
    share = (at - below).astype(np.float32)
    outside = (end_m < x_m[0] - 1e-9) | (end_m > x_m[-1] + 1e-9)
    padded_n = np.concatenate([target_n, np.zeros(2 * FRAME_MS)]).astype(np.float32)
    to_go = np.zeros(len(x_m), dtype=np.float32)
    best: dict[int, NDArray[np.int64]] = {}
    for start in range(phase_ms, len(target_n), FRAME_MS)[::-1]:
        wanted_n = padded_n[start + 1 : start + 1 + FRAME_MS]
        cost = squares - 2.0 * (force_n @ wanted_n) + (wanted_n**2).sum()
        cost += (1.0 - share) * to_go[below] + share * to_go[below + 1]
        cost[outside] = np.inf
        best[start] = cost.argmin(1)
        to_go = cost.min(1)
    return device.follow(target_n, phase_ms, lambda start, at_m: float(np.interp(at_m, x_m, u_m[best[start]])))


def without_the_future(device: IdealDevice, target_n: Numbers, phase_ms: int) -> Numbers:
    """Return the force when each setpoint is best for a force that continues its slope of the last 3 ms."""
    slope = np.zeros(len(target_n))
    slope[3:] = (target_n[3:] - target_n[:-3]) / 3.0
    slope[np.abs(slope) > FALL_N / 3.0] = 0.0
    steps = np.arange(1, FRAME_MS + 1)

    def setpoint_m(start: int, at_m: float) -> float:
        wanted_n = np.maximum(target_n[start] + slope[start] * steps, 0.0)
        paths_m = device.path_m(at_m, device.setpoints_m[:, None], steps)
        cost = ((device.force_n(paths_m) - wanted_n) ** 2).sum(1)
        # Among equals, the one that stops nearest to where the platform waits.
        equals = np.flatnonzero(cost <= cost.min() + 1e-6)
        return float(device.setpoints_m[equals[np.abs(paths_m[equals, -1] - device.start_m).argmin()]])

    return device.follow(target_n, phase_ms, setpoint_m)


def parts(target_n: Numbers, force_n: Numbers, touched: int) -> dict[str, float]:
    """Return the share of the squared error in each part of the run; a tick belongs to the first part that fits."""
    error = (force_n - target_n) ** 2
    falls = np.flatnonzero(np.diff(target_n) < -FALL_N) + 1
    free = np.ones(len(error), dtype=bool)
    shares = {}
    after_fall = np.zeros(len(error), dtype=bool)
    for fall in falls:
        after_fall[fall : fall + FALL_MS] = True
    masks = {
        "until_first_touch": np.arange(len(error)) < touched,
        "after_a_breach": after_fall,
        "force_below_the_sensors_threshold": force_n < 0.2,
        "rising": np.gradient(target_n) > 0.0,
        "else": np.ones(len(error), dtype=bool),
    }
    for name, mask in masks.items():
        shares[name] = float(error[mask & free].sum() / error.sum())
        free &= ~mask
    return shares


def rms(error_n: Any) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(error_n))))


def limit_rows(fingers_n_m: tuple[float, ...], seeds: range, phases_ms: tuple[int, ...]) -> list[dict[str, Any]]:
    """Return the errors on the ideal device, with and without the future."""
    rows = []
    for stiffness_n_m in fingers_n_m:
        device = IdealDevice(Finger(stiffness_n_m=stiffness_n_m), Servo())
        errors: dict[str, list[float]] = {"limit": [], "without_the_future": []}
        for seed in seeds:
            target_n = demo_target(seed)
            for phase_ms in phases_ms:
                errors["limit"].append(rms(with_the_future(device, target_n, phase_ms) - target_n))
                errors["without_the_future"].append(rms(without_the_future(device, target_n, phase_ms) - target_n))
        rows.append({"stiffness_n_m": stiffness_n_m, **{name: rms(each) for name, each in errors.items()}})
    return rows


def loop_rows(
    kind: str, chains: tuple[str, ...], seeds: range, phases_ms: tuple[int, ...], limits: dict[float, float]
) -> list[dict[str, Any]]:
    """Return the errors of the whole chain, and where they come from."""
    rows = []
    for name in chains:
        settings = CHAINS[name]
        for stiffness_n_m in limits if settings.on_all_fingers else (STIFFNESS_N_M,):
            finger = Finger(stiffness_n_m=stiffness_n_m)
            runs = [chain(kind, seed, phase_ms, finger, settings) for seed in seeds for phase_ms in phases_ms]
            true_n = rms([rms(run.true_n - run.target_n) for run in runs])
            shares = [parts(run.target_n, run.true_n, run.touched) for run in runs]
            weights = [np.sum((run.true_n - run.target_n) ** 2) for run in runs]
            rows.append(
                {
                    "chain": name,
                    "stiffness_n_m": stiffness_n_m,
                    "rmse_n": true_n,
                    "sensed_rmse_n": rms([rms(run.sensed_n - run.target_n) for run in runs]),
                    "of_limit": true_n / limits[stiffness_n_m],
                    "largest_n": max(float(run.true_n.max()) for run in runs),
                    "shares": {
                        key: float(np.average([share[key] for share in shares], weights=weights)) for key in shares[0]
                    },
                }
            )
    return rows


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    phases_ms = PHASES_MS[:1] if arguments.quick else PHASES_MS
    limits = limit_rows((STIFFNESS_N_M,) if arguments.quick else FINGERS_N_M, seeds, phases_ms)
    by_finger = {row["stiffness_n_m"]: row["limit"] for row in limits}
    chains = QUICK_CHAINS if arguments.quick else tuple(CHAINS)
    loop = loop_rows(arguments.device, chains, seeds, phases_ms, by_finger)
    return {"device": arguments.device, "ideal": limits, "loop": loop}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=3, help="how many hands")
    parser.add_argument("--device", choices=("sim", "simavr"), default="sim")
    parser.add_argument("--quick", action="store_true", help="one finger, one phase of the frames, fewer chains")
    record.run(parser, measure, unit="N, as root mean square over hands and phases; ratios and shares are fractions")


if __name__ == "__main__":
    main()
