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

    # The needed stiffness rises above the resonance, so the first crossing above it is the last that counts.
    resonance = math.sqrt(max(stiffness / mass_kg - 0.5 * (damping / mass_kg) ** 2, 0.0))
    omega = _softest(phase, size, resonance + 2.0 * math.pi / delay_s)
    return Onset(size(omega), omega / (2.0 * math.pi))


def sampled_onset(mass_kg: float, damping: float, stiffness: float, step_s: float, late_ticks: int) -> Onset:
    """Return the same for the sampled loop, exactly, with forces that are held from tick to tick (`step_s` [s]).

    The force of the position of tick k acts from tick ``k + late_ticks`` on.
    """
    xx, xv, xf, vx, vv, vf = exact_step(mass_kg, damping, stiffness, step_s)
    total, product = xx + vv, xx * vv - xv * vx
    zero = vv - xv * vf / xf

    def phase(theta: float) -> float:
        poles = theta + math.atan2((1.0 - product) * math.sin(theta), (1.0 + product) * math.cos(theta) - total)
        return late_ticks * theta + poles - math.atan2(math.sin(theta), math.cos(theta) - zero)

    def size(theta: float) -> float:
        z = complex(math.cos(theta), math.sin(theta))
        return abs((z - total) * z + product) / (xf * abs(z - zero))

    theta = _softest(phase, size, math.pi)
    return Onset(size(theta), theta / (2.0 * math.pi * step_s))


def _softest(phase: Callable[[float], float], size: Callable[[float], float], highest: float) -> float:
    """Return the frequency up to `highest` at which the loop needs the least stiffness to swing.

    There its phase, which rises from 0, is an odd multiple of π.
    """
    found = []
    for number in range(max(1, math.floor(0.5 * phase(highest) / math.pi + 0.5 + _TINY))):
        wanted, low, high = (2 * number + 1) * math.pi, 0.0, highest
        while high - low > _TINY * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if phase(middle) < wanted else (low, middle)
        found.append(high)
    return min(found, key=size)


def display_limits(
    *, damping: float, period_s: float, friction_n: float = 0.0, resolution_m: float = 0.0,
    max_force_n: float = math.inf, depth_m: float = 1e-3,
) -> list[tuple[float, str]]:  # fmt: skip
    """Return the stiffest springs [N/m] that can be displayed and what limits each, the softest first, without a delay.

    A spring that is sampled every `period_s` [s] and held creates energy that the damping [N·s/m] of hand and device
    must absorb (Colgate and Schenkel 1997): ``b > K·T/2``. A position that is known in steps creates energy that
    friction, if it is known, must absorb (Abbott and Okamura 2005; Diolaiti et al. 2006): ``f ≥ K·q/2``. No force
    exceeds the largest. And over a delay nothing of a surface is felt before the hand is its speed times a round trip
    inside.
    """
    limits = [(2.0 * damping / period_s, "damping and rate"), (max_force_n / depth_m, "largest force")]
    if resolution_m and friction_n:
        limits.append((2.0 * friction_n / resolution_m, "friction and resolution"))
    return sorted(limits)
