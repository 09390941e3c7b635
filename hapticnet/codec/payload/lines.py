"""A stimulus and its slope: a line that both sides follow for a limited time.

======= ======= ===================================================
B/axis  value   slope
======= ======= ===================================================
4       int16   int16, counts of ``step_n / horizon``, limited
8       float32 float32
12      float64 float32
======= ======= ===================================================
"""

from typing import Any, NamedTuple, Protocol

from hapticnet.codec.payload.values import (
    COUNT,
    COUNT_BYTES,
    LARGEST_COUNT,
    SINGLE,
    SINGLE_BYTES,
    ValueForm,
    ValueNumbers,
    rounded,
)
from hapticnet.errors import PeerError
from hapticnet.rounding import nearest
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import along, largest_component, limited, single, times, within


class LineNumbers(ValueNumbers, Protocol):
    """The numbers of a rule that lines depend on."""

    @property
    def horizon_us(self) -> float:
        """Time after which the end of a line is held [µs]."""
        ...

    @property
    def slope_step(self) -> float:
        """Size of a count of the slope [N/s]."""
        ...


class Line(NamedTuple):
    """A stimulus that changes at a constant rate until the horizon.

    Attributes
    ----------
    t_us, value
        Where it starts [µs, N].
    rate
        How fast it changes [N/µs].
    is_bounded
        Whether it stays in range up to the horizon.
    """

    t_us: int
    value: Vector
    rate: Vector
    is_bounded: bool


class LineMessage(NamedTuple):
    """A line as it is transmitted; `form` is that of the value, the slope is in N/s."""

    form: int
    value: Vector
    slope: Vector


def line_from(rule: LineNumbers, t_us: int, value: Vector, slope: Vector) -> Line:
    """Return the line of a value and a slope [N/s]."""
    rate = times(slope, 1e-6)
    largest = largest_component(value) + rule.horizon_us * largest_component(rate)
    return Line(t_us, value, rate, largest < LARGEST_COMPONENT)


def line_at(rule: LineNumbers, line: Line, t_us: int) -> Vector:
    """Return the stimulus at a time; before the line starts it is its value."""
    elapsed_us = t_us - line.t_us
    if elapsed_us <= 0:
        return line.value
    point = along(line.value, elapsed_us if elapsed_us < rule.horizon_us else rule.horizon_us, line.rate)
    return point if line.is_bounded else limited(point, LARGEST_COMPONENT)


def rounded_line(rule: LineNumbers, x: Vector, slope: Vector) -> LineMessage:
    """Return the message of a stimulus and the slope [N/s] from there on."""
    form, value, _ = rounded(rule, x)
    if form == COUNT_BYTES:
        return LineMessage(form, value, counted_slope(slope, rule.slope_step))
    return LineMessage(form, value, single(slope))


def counted_slope(slope: Vector, step: float) -> Vector:
    """Return the nearest multiples of a step, limited to ±`LARGEST_COUNT` steps."""
    if len(slope) == 1:
        return (_counted(slope[0], step),)
    if len(slope) == 2:
        return _counted(slope[0], step), _counted(slope[1], step)
    return _counted(slope[0], step), _counted(slope[1], step), _counted(slope[2], step)


def _counted(slope: float, step: float) -> float:
    return within(nearest(slope / step), float(LARGEST_COUNT)) * step + 0.0


def line_bytes(rule: Any, message: LineMessage) -> int:
    """Return the size of the payload of a line."""
    slope_bytes = COUNT_BYTES if message.form == COUNT_BYTES else SINGLE_BYTES
    return (message.form + slope_bytes) * len(message.value)


class LineForm:
    """Lines as bytes. Satisfies `Form`."""

    __slots__ = ("_axes", "_slope_step", "_values")

    def __init__(self, axes: int, *, step_n: float, slope_step: float) -> None:
        self._axes = axes
        self._values = ValueForm(axes, step_n=step_n)
        self._slope_step = slope_step

    def pack(self, message: LineMessage) -> bytes:
        """Return the payload of a line."""
        value = self._values.pack((message.form, message.value))
        if message.form == COUNT_BYTES:
            return value + COUNT[self._axes].pack(*[round(slope / self._slope_step) for slope in message.slope])
        return value + SINGLE[self._axes].pack(*message.slope)

    def unpack(self, payload: bytes, receiver: object = None) -> LineMessage:  # noqa: ARG002
        """Return the line in a payload.

        Raises
        ------
        PeerError
            If the length fits no form, or a component is not finite or out of range.
        """
        has_counts = len(payload) == 2 * COUNT_BYTES * self._axes
        form = COUNT[self._axes] if has_counts else SINGLE[self._axes]
        value_form, value = self._values.unpack(payload[: -form.size])
        slope: Vector = form.unpack(payload[-form.size :])
        if has_counts:
            slope = times(slope, self._slope_step)
        for component in slope:
            if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                raise PeerError(f"payload holds a slope of {component} N/s; it must be within ±{LARGEST_COMPONENT:g}")
        return LineMessage(value_form, value, slope)
