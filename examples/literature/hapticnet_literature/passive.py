"""Passive reduction: what is applied never gives the hand more energy than the true force would.

After Kuschel, Kremer, Hirche & Buss 2006, "Lossy data reduction methods for haptic telepresence systems" (ICRA), and
Kuschel, Kremer & Buss 2009, "Passive haptic data-compression methods with perceptual coding for bilateral presence
systems" (IEEE Trans. SMC-A 39(6)): the reconstruction is shifted by the deadband against the motion. The rule below is
derived for the convention here (positions x grow into the tissue, a positive force F pushes out of it).

The hand puts the work ``F · dx`` into the scene. Applying F̂ instead asks it for ``F̂ · dx``, so that
``(F - F̂) · dx`` is the energy created in that sample, with dx the motion since the sample before. Let v be the value
transmitted last, Δ the threshold around it, and u the direction of dx. The deadband ensures ``|F - v| ≤ Δ``, hence

    F · u  ≤  v · u + Δ                                  (Cauchy-Schwarz; for one axis, u = ±1)

and any F̂ with ``F̂ · u ≥ v · u + Δ`` has ``(F - F̂) · dx ≤ 0``: no sample creates energy, whatever force and motion do.
Pushing in, the applied force is the highest that the true one could be; pulling out, the lowest.

What this guarantees, and what it does not
- Every term ``(F - F̂) · dx`` is at most 0, and so is their running sum, if nothing is lost and the receiver knows the
  position of each sample. Shifts exceed Δ by more than the rounding error, so this also holds in floating point.
  (Except for differences below 1e-154 N, which count as zero in a norm.)
- A force that is held until the next sample acts along the *next* motion dx', which is not known yet. Counted that way,
  a term can be positive only where the direction changes: by ``(Δ + |F - v|) · |dx'| ≤ 2 Δ |dx'|`` at a reversal.
- A lost or late update leaves v behind the force: nothing is guaranteed until the next update arrives.
- The error is up to 2 Δ, felt as dry friction of Δ, also in free motion, and every reversal is a step of 2 Δ, so the
  error exceeds the JND at times. With a multiplier of 0.5 it is at most one JND of v.
- A hand at rest keeps the shift of its last direction: rest creates no energy, and removing the shift would be a step
  that can be felt. Before any motion, or if positions are not known, v is applied, as in the plain deadband.
"""

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.deadband import Deadband, ValueScheme
from hapticnet.codec.steps import MakeTable, Steps, not_mirrored
from hapticnet.codec.values import (
    LawNumbers,
    check_step,
    law_numbers,
    threshold_around,
)
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import along, dot, largest_component, magnitude, minus, over

MARGIN: Final = 2.0**-50
"""How much wider a shift is than the threshold, as a share of both: more than rounding can amount to."""

SMALLEST_SQUARE: Final = 1e-280
"""Below it, squares lose digits to underflow."""


class PassiveRule(NamedTuple):
    """The numbers of the rule; interval_us: the longest ramp [µs]."""

    weber: float
    floor: float
    step: float
    interval_us: float


class Shifted(NamedTuple):
    """The value received last, shifted against the motion.

    Attributes
    ----------
    value, shift, applied
        The value, how far it is shifted, and their sum [N].
    is_placed, position
        Whether a position of the tool is known, and the last one [m].
    direction
        The unit vector of the last motion; zeros before any.
    """

    value: Vector
    shift: float
    applied: Vector
    is_placed: bool
    position: Vector
    direction: Vector


class Ramp(NamedTuple):
    """The shifted value, and the ramp to it: time of the last update, start of the ramp [N] and its length [µs]."""

    shifted: Shifted
    t_us: int
    origin: Vector
    length_us: float


NEVER_US: Final = 2**62
"""Later than any time, so that the first update starts no ramp."""


def start_shifted(rule: Any, axes: int) -> Shifted:
    """Return a receiver that knows neither value nor position."""
    zeros = (0.0,) * axes
    return Shifted(zeros, 0.0, zeros, False, zeros, zeros)


def start_ramp(rule: Any, axes: int) -> Ramp:
    """Return a receiver that knows neither value nor position."""
    return Ramp(start_shifted(rule, axes), NEVER_US, (0.0,) * axes, 0.0)


def shifted_from(rule: LawNumbers, value: Vector, origin: Vector, before: Shifted) -> Shifted:
    """Return a value shifted against the motion; the margin covers the rounding of a ramp from the origin."""
    threshold = threshold_around(rule, value)
    shift = threshold + MARGIN * (threshold + 2.0 * magnitude(value) + magnitude(origin))
    has_moved = largest_component(before.direction) > 0.0
    applied = along(value, shift, before.direction) if has_moved else value
    return Shifted(value, shift, applied, before.is_placed, before.position, before.direction)


def receive_value(rule: PassiveRule, receiver: Shifted, t_us: int, message: tuple[int, Vector]) -> Shifted:
    """Shift the value of a message."""
    return shifted_from(rule, message[1], message[1], receiver)


def receive_ramp(rule: PassiveRule, ramp: Ramp, t_us: int, message: tuple[int, Vector]) -> Ramp:
    """Start a ramp from the present value of the last one to the value of a message."""
    origin, length_us = message[1], 0.0  # no ramp if time does not advance
    if t_us > ramp.t_us and rule.interval_us > 0.0:
        origin, length_us = interpolated(ramp, t_us), min(float(t_us - ramp.t_us), rule.interval_us)
    return Ramp(shifted_from(rule, message[1], origin, ramp.shifted), t_us, origin, length_us)


def interpolated(ramp: Ramp, t_us: int) -> Vector:
    """Return the value of the ramp at a time."""
    elapsed_us = t_us - ramp.t_us
    if 0 <= elapsed_us < ramp.length_us:
        return along(ramp.origin, elapsed_us / ramp.length_us, minus(ramp.shifted.value, ramp.origin))
    return ramp.shifted.value


def move_shifted(rule: PassiveRule, receiver: Shifted, t_us: int, position: Vector) -> Shifted:
    """Follow the tool to its position."""
    value, shift, applied, is_placed, before, direction = receiver
    if is_placed and position != before:
        direction = direction_of(minus(position, before))
        applied = along(value, shift, direction)
    return Shifted(value, shift, applied, True, position, direction)


def move_ramp(rule: PassiveRule, ramp: Ramp, t_us: int, position: Vector) -> Ramp:
    """Follow the tool to its position."""
    return Ramp(move_shifted(rule, ramp.shifted, t_us, position), ramp.t_us, ramp.origin, ramp.length_us)


def apply_shifted(rule: PassiveRule, receiver: Shifted, t_us: int) -> Vector:
    """Return the value, shifted against the motion."""
    return receiver.applied


def apply_ramp(rule: PassiveRule, ramp: Ramp, t_us: int) -> Vector:
    """Return the ramp towards the value, shifted against the motion."""
    value, shift, applied, _, _, direction = ramp.shifted
    if not 0 <= t_us - ramp.t_us < ramp.length_us or largest_component(direction) == 0.0:
        return applied
    base = interpolated(ramp, t_us)
    ahead = dot(minus(value, base), direction)
    return along(base, shift + ahead if ahead > 0.0 else shift, direction)


def direction_of(motion: Vector) -> Vector:
    """Return the unit vector of a motion other than zero."""
    if len(motion) == 1:
        return (1.0,) if motion[0] > 0.0 else (-1.0,)
    scaled = over(motion, largest_component(motion) if dot(motion, motion) < SMALLEST_SQUARE else 1.0)
    return over(scaled, math.sqrt(dot(scaled, scaled)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PassiveExtrapolative(ValueScheme):
    """The deadband, with the held force shifted by the threshold against the motion.

    Rule: send as the deadband does; apply ``v + Δ · u``. Payload: the deadband's. Error: 2 Δ at most. No delay.

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N], as in the deadband; 0: never.
    """

    name: ClassVar[str] = "passive-extrapolative"
    needs_position: ClassVar[bool] = True
    steps: ClassVar[Steps] = Deadband.steps._replace(
        mirror=not_mirrored,
        start_receiver=start_shifted,
        receive=receive_value,
        move=move_shifted,
        apply=apply_shifted,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> PassiveRule:  # noqa: ARG002
        """Return law, step of counts and the longest ramp."""
        return PassiveRule(*law_numbers(self.law), self.step_n, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PassiveInterpolative(ValueScheme):
    """The deadband, shifted as in passive-extrapolative, with a ramp between values where that removes energy.

    Rule: send as the deadband does. For the time between the last two updates, at most `interval_ms`, the receiver
    interpolates b from its present value to v, and applies ``b + (max((v - b) · u, 0) + Δ) · u``. For one axis
    that is ``max(b, v) + Δ`` pushing in and ``min(b, v) - Δ`` pulling out: a change in favour of the hand, such as
    a breach on the way in, comes as a ramp; one against it comes at once.
    Payload: the deadband's. Delay: up to `interval_ms` for changes in favour of the hand, none for the others.
    Error: up to 2 Δ, plus the rest of the ramp; on several axes the force during a ramp may be up to √2 times the
    larger of its ends, plus Δ.

    Attributes
    ----------
    interval_ms
        Longest ramp [ms]: 0 to 1000.
    step_n
        Payload of int16 multiples of this [N], as in the deadband; 0: never.
    """

    name: ClassVar[str] = "passive-interpolative"
    needs_position: ClassVar[bool] = True
    steps: ClassVar[Steps] = Deadband.steps._replace(
        mirror=not_mirrored,
        start_receiver=start_ramp,
        receive=receive_ramp,
        move=move_ramp,
        apply=apply_ramp,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    interval_ms: float = 20.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("interval_ms", self.interval_ms, 0.0, 1000.0)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> PassiveRule:  # noqa: ARG002
        """Return law, step of counts and the longest ramp."""
        return PassiveRule(*law_numbers(self.law), self.step_n, self.interval_ms * 1e3)
