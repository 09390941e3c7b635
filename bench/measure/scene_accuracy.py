"""Error and cost of the scene over its rate: forces, breaches and surfaces beside the exact solution.

The scene evaluates its laws in closed form at each sample. The rate therefore decides how long a force is held before
the next one, how late a breach is noticed, and how exactly two positions give a velocity.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import record

from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.scene.sources import paper_scene

Array = npt.NDArray[np.float64]
Row = dict[str, Any]

RATES_HZ: Final = (50, 100, 200, 500, 1000, 2000, 5000, 10_000)
FINE_US: Final = 5
"""Period of the exact force [µs]; a force held between samples is compared with all of them."""

REST_M: Final = 2e-3
STROKE_M: Final = 10e-3
PRESS_US: Final = 1_000_000
STIFFNESS_N_PER_M: Final = 400.0
STIFFENING_PER_M: Final = 100.0
VISCOSITY_N_S_PER_M: Final = 5.0
UNBREAKABLE_N: Final = 1e3

BREACH_N: Final = 2.0
BREACH_STIFFNESS_N_PER_M: Final = 200.0
RECOVERY_S: Final = 0.1
SPEEDS_M_PER_S: Final = (0.02, 0.1)


def tissue(**declared: float) -> Tissue:
    """Return the tissue that is pressed but not pierced."""
    return Tissue(
        name="pressed",
        rest_position_m=REST_M,
        stiffness_n_per_m=STIFFNESS_N_PER_M,
        breach_force_n=UNBREAKABLE_N,
        **declared,
    )


def pressed_m(t_us: Array) -> Array:
    """Return the position of the needle: one press and return in a second, from outside to the full stroke."""
    return STROKE_M * 0.5 * (1.0 - np.cos(2.0 * np.pi * t_us / PRESS_US))


def speed_m_per_s(t_us: Array) -> Array:
    """Return the speed of the needle."""
    return STROKE_M * np.pi * 1e6 / PRESS_US * np.sin(2.0 * np.pi * t_us / PRESS_US)


def spring_n(t_us: Array) -> Array:
    """Return the exact force of a linear spring."""
    return STIFFNESS_N_PER_M * np.maximum(pressed_m(t_us) - REST_M, 0.0)


def stiffening_n(t_us: Array) -> Array:
    """Return the exact force of a spring that stiffens."""
    depth_m = np.maximum(pressed_m(t_us) - REST_M, 0.0)
    return STIFFNESS_N_PER_M / STIFFENING_PER_M * np.expm1(STIFFENING_PER_M * depth_m)


def damped_n(t_us: Array) -> Array:
    """Return the exact force of a spring with a damper, which does not pull."""
    elastic_n = spring_n(t_us)
    whole_n = np.maximum(elastic_n + VISCOSITY_N_S_PER_M * speed_m_per_s(t_us), 0.0)
    return np.where(elastic_n > 0.0, whole_n, 0.0)


LAWS: Final[dict[str, tuple[Tissue, Callable[[Array], Array]]]] = {
    "linear spring": (tissue(), spring_n),
    "stiffening spring": (tissue(stiffening_per_m=STIFFENING_PER_M), stiffening_n),
    "spring and damper": (tissue(viscosity_n_s_per_m=VISCOSITY_N_S_PER_M), damped_n),
}


def press(name: str, rate_hz: int) -> Row:
    """Return the error of the force at the samples, and of the same force held between them."""
    law, exact_n = LAWS[name]
    period_us = 1_000_000 // rate_hz
    t_us = np.arange(0, PRESS_US, period_us)
    step = Scene([law]).step
    forces_n = np.array(
        [
            step(PositionSample(at_us, (position_m,))).force_n[0]
            for at_us, position_m in zip(t_us.tolist(), pressed_m(t_us.astype(np.float64)).tolist(), strict=True)
        ]
    )
    fine_us = np.arange(0, PRESS_US, FINE_US)
    held_n = forces_n[fine_us // period_us] - exact_n(fine_us.astype(np.float64))
    at_samples_n = forces_n - exact_n(t_us.astype(np.float64))
    return {
        "law": name,
        "rate_hz": rate_hz,
        "peak_n": float(exact_n(fine_us.astype(np.float64)).max()),
        "max_at_samples_n": float(np.abs(at_samples_n).max()),
        "rmse_held_n": float(np.sqrt(np.mean(held_n**2))),
        "max_held_n": float(np.abs(held_n).max()),
    }


def pierce(rate_hz: int, start_m: float, speed: float) -> tuple[float, float, float]:
    """Push through one layer at constant speed.

    Returns
    -------
    float
        Delay [s] until the scene notices the breach.
    float
        The largest force [N] it gave.
    float
        The largest error [m] of the surface that recovers, over the samples after the breach.
    """
    scene = Scene(
        [
            Tissue(
                name="pierced",
                rest_position_m=0.0,
                stiffness_n_per_m=BREACH_STIFFNESS_N_PER_M,
                breach_force_n=BREACH_N,
                recovery_time_s=RECOVERY_S,
            )
        ]
    )
    depth_m = BREACH_N / BREACH_STIFFNESS_N_PER_M
    exact_s = (depth_m - start_m) / speed
    period_us = 1_000_000 // rate_hz
    noticed_s, largest_n, worst_m = math.nan, 0.0, 0.0
    for at_us in range(0, round(1e6 * (exact_s + 2.0 * RECOVERY_S)), period_us):
        at_s = 1e-6 * at_us
        force_n = scene.step(PositionSample(at_us, (start_m + speed * at_s,))).force_n[0]
        largest_n = max(largest_n, force_n)
        if scene.breaches:
            if math.isnan(noticed_s):
                noticed_s = at_s
            exact_m = depth_m * math.exp(-(at_s - exact_s) / RECOVERY_S)
            worst_m = max(worst_m, abs(scene.surfaces_m()[0] - exact_m))
    return noticed_s - exact_s, largest_n, worst_m


def breaches(rate_hz: int, seed: int, trials: int) -> Row:
    """Return how late breaches are noticed, over drawn speeds and phases of the sampling."""
    rng = np.random.default_rng(seed)
    late_s, forces_n, surfaces_m = zip(
        *(pierce(rate_hz, -rng.uniform(0.0, 2e-3), rng.uniform(*SPEEDS_M_PER_S)) for _ in range(trials)), strict=True
    )
    return {
        "rate_hz": rate_hz,
        "late_mean_ms": 1e3 * statistics.fmean(late_s),
        "late_least_ms": 1e3 * min(late_s),
        "late_max_ms": 1e3 * max(late_s),
        "largest_force_n": max(forces_n),
        "surface_max_error_m": max(surfaces_m),
    }


def cost(rate_hz: int, seed: int, repetitions: int) -> Row:
    """Return the time that a second of the paper's scene takes, from the first surface to behind the last."""
    depths_m = np.linspace(0.0, 74e-3, rate_hz)
    samples = [
        PositionSample(index * (1_000_000 // rate_hz), (depth_m,)) for index, depth_m in enumerate(depths_m.tolist())
    ]
    # A slow rate is played more often, so that each timing spans as many steps as at the fastest.
    rounds = max(1, RATES_HZ[-1] // rate_hz)
    scene = Scene(paper_scene(seed).tissues)
    times_ns = []
    for _ in range(repetitions):
        taken_ns = 0
        for _ in range(rounds):
            scene.reset()
            step = scene.step
            started_ns = time.perf_counter_ns()
            for sample in samples:
                step(sample)
            taken_ns += time.perf_counter_ns() - started_ns
        times_ns.append(taken_ns / rounds)
    return {
        "rate_hz": rate_hz,
        "ns_per_second_best": min(times_ns),
        "ns_per_second_median": statistics.median(times_ns),
    }


def measure(arguments: argparse.Namespace) -> Row:
    """Return all results."""
    seed, rates_hz = arguments.seed, RATES_HZ
    if arguments.quick:
        rates_hz, arguments.trials, arguments.repetitions = RATES_HZ[::3], 5, 1
    return {
        "forces": [press(name, rate_hz) for name in LAWS for rate_hz in rates_hz],
        "steepest_n_per_s": STIFFNESS_N_PER_M * STROKE_M * math.pi * 1e6 / PRESS_US,
        "breach_force_n": BREACH_N,
        "breach_depth_m": BREACH_N / BREACH_STIFFNESS_N_PER_M,
        "recovery_s": RECOVERY_S,
        "trials": arguments.trials,
        "breaches": [breaches(rate_hz, seed, arguments.trials) for rate_hz in rates_hz],
        "cost": [cost(rate_hz, seed, arguments.repetitions) for rate_hz in rates_hz],
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--trials", type=record.within(1), default=100, help="breaches at each rate")
    parser.add_argument("--repetitions", type=record.within(1), default=7, help="timings at each rate")
    parser.add_argument("--quick", action="store_true", help="three rates, five breaches, one timing")
    record.run(parser, measure, unit="as in each name; ns_per_second is ns per second of scene")


if __name__ == "__main__":
    main()
