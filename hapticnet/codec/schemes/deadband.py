"""The perceptual deadband with zero-order hold: the codec of the paper.

Hinterseer et al. 2005 for one axis; Hinterseer & Steinbach 2006 for several, where the dead zone is a ball whose
radius follows the norm of the last transmitted stimulus (isotropic dead zone).
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import ValueForm, ValueNumbers, ValueRule, check_step, law_numbers, rounded, value_bytes
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance

EMPTY: Final = -1.0  # threshold of a dead zone that contains no stimulus, so that the next one is sent

MARGIN: Final = 2.0**-50
"""How much narrower `silent_interval` is than its dead zone, as a share of both: more than any rounding error."""


class DeadZone(NamedTuple):
    """State of the sender: the held stimulus, and the distance [N] from it within which no stimulus is sent."""

    reference: Vector
    threshold: float


def empty_zone(rule: Any, axes: int) -> DeadZone:
    """Return a dead zone that contains no stimulus."""
    return DeadZone((0.0,) * axes, EMPTY)


def is_silent(rule: Any, zone: DeadZone, t_us: int, x: Vector) -> bool:
    """Return whether a stimulus is inside the dead zone."""
    return distance(x, zone.reference) <= zone.threshold


def send(rule: ValueNumbers, zone: DeadZone, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], DeadZone]:
    """Send the stimulus, and centre the dead zone on its rounded value."""
    form, reference, threshold = rounded(rule, x)
    return (form, reference), DeadZone(reference, threshold)


def mirror(zone: DeadZone) -> Vector:
    """Return the stimulus that the receiver holds."""
    return zone.reference


def silent_interval(rule: Any, zone: DeadZone) -> tuple[float, float]:
    """Return an interval that nearly fills the dead zone of one axis."""
    (reference,), threshold = zone
    half = threshold - MARGIN * (abs(reference) + threshold)
    return reference - half, reference + half


def emptied(zone: DeadZone) -> DeadZone:
    """Return a dead zone that contains no stimulus."""
    return zone._replace(threshold=EMPTY)


class ValueScheme(Scheme):
    """A scheme whose messages are values in the form that `step_n` chooses."""

    __slots__ = ()
    step_n: float

    def form(self: Any, axes: int) -> ValueForm:
        """Return the form of its messages."""
        return ValueForm(axes, step_n=self.step_n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadband(ValueScheme):
    """Transmit a stimulus only when it can be distinguished from the held one.

    Rule: send when ``|x - ref| > multiplier · max(weber_fraction · |ref|, floor_n)``, strictly, with `ref` the last
    transmitted stimulus, rounded for the wire. The first stimulus is always sent.
    Payload: float32 an axis, or float64 where rounding to float32 would move the stimulus by more than the
    threshold, so that the held stimulus is within the threshold of the true one at every sample, whatever the input.

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "deadband"
    steps: ClassVar[Steps] = Steps(
        start_sender=empty_zone,
        is_silent=is_silent,
        send=send,
        refreshed=emptied,
        silent_interval=silent_interval,
        mirror=mirror,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self: Any) -> None:
        check_step(self.step_n)

    def rule(self: Any, axes: int, table: MakeTable) -> ValueRule:  # noqa: ARG002
        """Return the law and the step of counts."""
        return ValueRule(*law_numbers(self.law), self.step_n)
