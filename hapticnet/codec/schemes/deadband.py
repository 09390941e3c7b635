"""The perceptual deadband with zero-order hold: the codec of the paper.

Hinterseer et al. 2005 for one axis; Hinterseer & Steinbach 2006 for several, where the dead zone is a ball whose
radius follows the norm of the last transmitted stimulus (isotropic dead zone).
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.codec.payload.values import (
    ValueForm,
    ValueNumbers,
    ValueRule,
    check_step,
    law_numbers,
    rounded,
    value_bytes,
)
from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Scheme, Steps
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance

EVERYTHING: Final = -1.0
"""A threshold that no difference is within: the next stimulus is sent."""


MARGIN: Final = 2.0**-50
"""By how much, of reference and threshold, an interval is narrower than its dead zone: more than it rounds."""


class DeadZone(NamedTuple):
    """What the receiver holds, and how far a stimulus may be from it in silence."""

    reference: Vector
    threshold: float


def nothing_held(rule: Any, axes: int) -> DeadZone:
    """Return a dead zone that contains nothing."""
    return DeadZone((0.0,) * axes, EVERYTHING)


def is_silent(rule: Any, zone: DeadZone, t_us: int, x: Vector) -> bool:
    """Tell whether a stimulus is inside the dead zone."""
    return distance(x, zone.reference) <= zone.threshold


def send(rule: ValueNumbers, zone: DeadZone, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], DeadZone]:
    """Send the stimulus; the dead zone is around what the receiver makes of it."""
    form, reference, threshold = rounded(rule, x)
    return (form, reference), DeadZone(reference, threshold)


def mirror(zone: DeadZone) -> Vector:
    """Return what the receiver holds."""
    return zone.reference


def quiet(rule: Any, zone: DeadZone) -> tuple[float, float]:
    """Return an interval that lies within the dead zone of one axis and all but fills it."""
    (reference,), threshold = zone
    half = threshold - MARGIN * (abs(reference) + threshold)
    return reference - half, reference + half


def everything_is_outside(zone: DeadZone) -> DeadZone:
    """Return a dead zone that contains nothing."""
    return zone._replace(threshold=EVERYTHING)


class ValueScheme(Scheme):
    """A scheme whose messages are values in the form that `step_n` chooses."""

    __slots__ = ()
    step_n: float

    def form(self, axes: int) -> ValueForm:
        """Return the form of its messages."""
        return ValueForm(axes, step_n=self.step_n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadband(ValueScheme):
    """Transmit a stimulus only when it can be told apart from the one being held.

    Rule: send when ``|x - ref| > multiplier · max(weber_fraction · |ref|, floor_n)``, strictly, with `ref` the last
    transmitted stimulus as it was rounded for the wire. The first stimulus is always sent.
    Payload: float32 an axis, or float64 where rounding to float32 would move the stimulus by more than the
    threshold, so that the held stimulus is within the threshold of the true one at every sample, whatever the input.

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "deadband"
    steps: ClassVar[Steps] = Steps(
        start_sender=nothing_held,
        is_silent=is_silent,
        send=send,
        refreshed=everything_is_outside,
        quiet=quiet,
        mirror=mirror,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> ValueRule:  # noqa: ARG002
        """Return the law and the step of counts."""
        return ValueRule(*law_numbers(self.law), self.step_n)
