"""Where a hand begins to swing against a delayed spring, and the stiffest spring that a device can display at all.

A hand with mass M, damping B and stiffness K holds the device; its position goes out, and the force of a spring K_e
comes back one round trip T late: ``M s² + B s + K + K_e e^(−sT) = 0``. Above some K_e the hand swings for ever.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.oscillator import exact_step

NOTICED_S: Final = {"a damper": 0.015, "a spring": 0.036, "a mass": 0.072}
"""Delays [s] of the force from which on people notice them, by what they move: Rank, Shi, Müller and Hirche, "The
influence of different haptic environments on time delay discrimination in force feedback" (EuroHaptics 2010), of which
only the abstract was read."""

STIFFNESS_JND: Final = 0.225
"""Share by which a stiffness must differ to be told apart; the usual measure of a transparent spring."""

_TINY: Final = 1e-12
MOST_CROSSINGS: Final = 100


class Onset(NamedTuple):
    """The softest spring against which a hand swings for ever, and how fast it then swings."""

    stiffness_n_per_m: float
    frequency_hz: float


NEVER: Final = Onset(math.inf, math.nan)


def onset(mass_kg: float, damping: float, stiffness: float, delay_s: float) -> Onset:
    """Return where a hand (M [kg], B [N·s/m], K [N/m]) begins to swing against a spring whose force is late."""
    check_parameter("delay", delay_s, 0, 100, "s")
    if delay_s == 0.0:
        return NEVER

    def phase(omega: float) -> float:
        return omega * delay_s + math.atan2(damping * omega, stiffness - mass_kg * omega * omega)

    def size(omega: float) -> float:
        return math.hypot(stiffness - mass_kg * omega * omega, damping * omega)

    omega = _softest(phase, size, _resonance(mass_kg, damping, stiffness) + 2.0 * math.pi / delay_s)
    return Onset(size(omega), omega / (2.0 * math.pi))


def sampled_onset(mass_kg: float, damping: float, stiffness: float, step_s: float, late_ticks: int) -> Onset:
    """Return the same for the sampled loop, exactly, with forces that are held from tick to tick (`step_s` [s]).

    The force of the position of tick k acts from tick ``k + late_ticks`` on.
    """
    xx, xv, xf, vx, vv, vf = exact_step(mass_kg, damping, stiffness, step_s)
    total, product = xx + vv, min(xx * vv - xv * vx, 1.0)  # above 1 only by rounding
    zero = vv - xv * vf / xf

    def phase(theta: float) -> float:
        poles = theta + math.atan2((1.0 - product) * math.sin(theta), (1.0 + product) * math.cos(theta) - total)
        return late_ticks * theta + poles - math.atan2(math.sin(theta), math.cos(theta) - zero)

    def size(theta: float) -> float:
        z = complex(math.cos(theta), math.sin(theta))
        return abs((z - total) * z + product) / (xf * abs(z - zero))

    above = _resonance(mass_kg, damping, stiffness) * step_s + 4.0 * math.pi / (late_ticks + 1)
    theta = _softest(phase, size, min(above, math.pi))
    return Onset(size(theta), theta / (2.0 * math.pi * step_s))


def _resonance(mass_kg: float, damping: float, stiffness: float) -> float:
    """Return the frequency [rad/s] above which the needed stiffness rises: the first crossing above it is the last."""
    return math.sqrt(max(stiffness / mass_kg - 0.5 * (damping / mass_kg) ** 2, 0.0))


def _softest(phase: Callable[[float], float], size: Callable[[float], float], highest: float) -> float:
    """Return the frequency up to `highest` at which the loop needs the least stiffness to swing.

    There its phase, which rises from 0, is an odd multiple of π.
    """
    found = []
    crossings = max(1, math.floor(0.5 * phase(highest) / math.pi + 0.5 + _TINY))
    for number in range(max(0, crossings - MOST_CROSSINGS), crossings):  # the last are nearest to the resonance
        wanted, low, high = (2 * number + 1) * math.pi, 0.0, highest
        while high - low > _TINY * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if phase(middle) < wanted else (low, middle)
        found.append(high)
    return min(found, key=size)
