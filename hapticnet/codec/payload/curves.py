"""A stimulus and its travel: a parabola that both sides follow until it is level at the horizon.

The payload is a value as in `payload.values`, then the travel: float16 an axis, in thresholds around the value.
"""

import struct
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, Protocol

from hapticnet.codec.payload.values import LawNumbers, ValueForm, threshold_around
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import as_half
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector
from hapticnet.vectors import along, in_range, largest_component, magnitude, plus, times, within

TRAVEL: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}e") for axes in range(1, MAX_AXES + 1)}
TRAVEL_BYTES: Final = 2

LARGEST_TRAVEL: Final = 1024.0
"""Largest travel of an axis in thresholds. Far above any force of a hand; it bounds the effect of a lost update."""


class CurveNumbers(LawNumbers, Protocol):
    """The numbers of a rule that curves depend on."""

    @property
    def horizon_us(self) -> float:
        """Time after which a curve is level [µs]."""
        ...


class Curve(NamedTuple):
    """A stimulus whose rate of change falls linearly to zero at the horizon: from `value` by `travel` [N]."""

    t_us: int
    value: Vector
    travel: Vector


class CurveMessage(NamedTuple):
    """A curve as it is transmitted; `form` is that of the value, the travel is in thresholds around it."""

    form: int
    value: Vector
    thresholds: Vector


def share_at(rule: CurveNumbers, begun_us: int, t_us: int) -> float:
    """Return the share of its travel that a curve which began at `begun_us` has completed at a time, 0 to 1."""
    s = (t_us - begun_us) / rule.horizon_us
    if s >= 1.0:
        return 1.0
    return s * (2.0 - s) if s > 0.0 else 0.0


def curve_at(rule: CurveNumbers, curve: Curve, t_us: int) -> Vector:
    """Return the stimulus at a time; before the curve starts it is its value."""
    return along(curve.value, share_at(rule, curve.t_us, t_us), curve.travel)


def curve_of(rule: LawNumbers, t_us: int, message: CurveMessage) -> Curve:
    """Return the curve of a message."""
    return Curve(t_us, message.value, times(message.thresholds, threshold_around(rule, message.value)))


def in_halves(travel: Vector, threshold: float) -> Vector:
    """Return a travel in thresholds, rounded to float16; zeros without a threshold."""
    if len(travel) == 1:
        return (_half(travel[0], threshold),)
    if len(travel) == 2:
        return _half(travel[0], threshold), _half(travel[1], threshold)
    return _half(travel[0], threshold), _half(travel[1], threshold), _half(travel[2], threshold)


def _half(travel: float, threshold: float) -> float:
    return as_half(within(travel / threshold, LARGEST_TRAVEL)) if threshold > 0.0 else 0.0


def ends_in_range(value: Vector, thresholds: Vector, threshold: float) -> bool:
    """Tell whether a curve ends in range."""
    return in_range(plus(value, times(thresholds, threshold)))


def curve_bytes(rule: Any, message: CurveMessage) -> int:
    """Return the size of the payload of a curve."""
    return (message.form + TRAVEL_BYTES) * len(message.value)


class CurveForm:
    """Curves as bytes. Satisfies `Form`."""

    __slots__ = ("_law", "_travel", "_values")

    def __init__(self, axes: int, law: WeberLaw, *, step_n: float) -> None:
        self._law = law
        self._values = ValueForm(axes, step_n=step_n)
        self._travel = TRAVEL[axes]

    def pack(self, message: CurveMessage) -> bytes:
        """Return the payload of a curve."""
        return self._values.pack((message.form, message.value)) + self._travel.pack(*message.thresholds)

    def unpack(self, payload: bytes, receiver: object = None) -> CurveMessage:  # noqa: ARG002
        """Return the curve in a payload.

        Raises
        ------
        PeerError
            If the length fits no form, or where it starts or ends is not finite or out of range.
        """
        form, value = self._values.unpack(payload[: -self._travel.size])
        thresholds: Vector = self._travel.unpack(payload[-self._travel.size :])
        threshold = self._law.threshold_n(magnitude(value))
        if not (largest_component(thresholds) <= LARGEST_TRAVEL and ends_in_range(value, thresholds, threshold)):
            raise PeerError(
                f"payload holds a travel of {thresholds} thresholds; it must be within ±{LARGEST_TRAVEL:g} and end"
                f" within ±{LARGEST_COMPONENT:g}"
            )
        return CurveMessage(form, value, thresholds)
