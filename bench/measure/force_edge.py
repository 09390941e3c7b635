"""How far the force loop is from oscillating: margins of its linear model beside the observed edge.

The edge is always measured on the simulated device in Python.
"""

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
from force_scenarios import FROM_N, TICK_US, TO_N, Row, Simulated, played

from hapticnet.control.finger import FingerSettings, compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.margins import Actuator, loop_margins
from hapticnet.device.servos import Linkage, Servo
from hapticnet.device.simulated import Finger, PlantSettings, Sensor

HUNT_N, SWING_N = 0.1, 0.5
"""True forces [N], peak to peak, that count as hunting and as swinging. Through the sensor's hysteresis, 10 % of 2 N,
and the gears' play the force may oscillate by 0.3 N without being unstable in the linear sense."""

RATIOS = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
BISECTIONS = 4


def frozen(stiffness_n_m: float) -> ForceControlSettings:
    """Return a loop that knows its finger's stiffness and does not learn."""
    finger = FingerSettings(stiffness_n_m=stiffness_n_m, uncertainty=0.0, largest_uncertainty=0.0, change_m_n=0.0)
    return ForceControlSettings(finger=finger)


def swing_on_a_step(stiffness_n_m: float, ratio: float, delay_ms: int, seed: int) -> float:
    """Return how far [N] the force swings, or misses the target, on a finger `ratio` times as stiff as assumed."""
    settings = PlantSettings(finger=Finger(stiffness_n_m=ratio * stiffness_n_m))
    true_n, fault = played(settings, frozen(stiffness_n_m), lambda s: FROM_N if s < 2.5 else TO_N, 9, delay_ms, seed)
    steady_n = true_n[-2000:]
    return math.inf if fault else max(float(np.ptp(steady_n)), abs(float(steady_n.mean()) - TO_N) - SWING_N)


def swing_when_linear(stiffness_n_m: float, ratio: float, delay_ms: int, seed: int) -> float:
    """Return how far [N] the force swings when the target moves by 0.1 N, in the loop that the margins describe.

    Without play, deadbands, noise and speed limit; the finger stiffens at rest, around where the platform stands.
    """
    settings = PlantSettings(
        linkage=Linkage(deadband_us=0.0, timer_step_us=0.01),
        servo=Servo(deadband_us=0.0, backlash_deg=0.0, rate_deg_s=1e5),
        sensor=Sensor(hysteresis=0.0, noise_counts=0.0, adc_bits=16),
        finger=Finger(stiffness_n_m=stiffness_n_m),
    )
    control = replace(
        frozen(stiffness_n_m),
        deadband_n=0.0, deadband_fraction=0.0, yield_n=4.0, yield_fraction=1.0, press_speed_m_s=1.0, lead_s=0.0,
    )  # fmt: skip

    def stiffen(device: Simulated, _: Finger) -> None:
        stood_m = device.plant.displacement_m
        stiffer_n_m = ratio * stiffness_n_m
        contact_m = stood_m - compressed(device.plant.contact_force_n) / stiffer_n_m
        device.plant.exchange_finger(Finger(stiffness_n_m=stiffer_n_m, contact_m=contact_m))

    true_n, fault = played(
        settings, control, lambda s: TO_N if s < 4.0 else TO_N + 0.1, 10, delay_ms, seed, events=((3.5, stiffen),)
    )
    return math.inf if fault else float(np.ptp(true_n[4000:]))


def edge(swing: Callable[[float], float], largest_n: float) -> float | None:
    """Return the smallest ratio of stiffnesses at which the force swings by more than `largest_n` [N]."""
    for low, high in itertools.pairwise(RATIOS):
        if swing(high) > largest_n:
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if swing(middle) > largest_n else (middle, high)
            return high
    return None


def edge_rows(stiffnesses_n_m: tuple[float, ...], delays_ms: tuple[int, ...], seeds: range) -> list[Row]:
    """Return computed margins beside the observed edges, the smallest over all seeds."""
    rows = []
    for stiffness_n_m, delay_ms in itertools.product(stiffnesses_n_m, delays_ms):
        # A reading is a tick old when it is used.
        actuator = Actuator(transport_s=1e-6 * TICK_US + 1e-3 * delay_ms)
        learning = ForceControlSettings(finger=FingerSettings(stiffness_n_m=stiffness_n_m))

        def worst(
            swing: Callable[[float, float, int, int], float], k: float = stiffness_n_m, ms: int = delay_ms
        ) -> Callable[[float], float]:
            return functools.cache(lambda ratio: max(swing(k, ratio, ms, seed) for seed in seeds))

        on_a_step = worst(swing_on_a_step)
        rows.append(
            {
                "stiffness_n_m": stiffness_n_m,
                "delay_ms": delay_ms,
                "frozen": asdict(loop_margins(frozen(stiffness_n_m), actuator, force_n=TO_N, stiffness=1.0)),
                "learning": asdict(loop_margins(learning, actuator, force_n=TO_N, stiffness=1.0)),
                "linear_edge": edge(worst(swing_when_linear), SWING_N),
                "hunts_from": edge(on_a_step, HUNT_N),
                "swings_from": edge(on_a_step, SWING_N),
            }
        )
    return rows
