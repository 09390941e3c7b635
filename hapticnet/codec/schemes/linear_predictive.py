"""The linear-predictive deadband: both sides extrapolate a line, and only a stimulus that leaves it is transmitted.

First-order prediction within the deadband: Hinterseer, Hirche, Chaudhuri, Steinbach & Buss 2008, "Perception-based data
reduction and transmission of haptic data in telepresence and teleaction systems" (IEEE Trans. Signal Processing). Here
the payload carries the slope beside the value, so that a decoder needs no earlier update.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple, Protocol

from hapticnet.checks import check_integer, check_parameter
from hapticnet.codec.steps import MakeTable, Past, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import (
    COUNT,
    COUNT_BYTES,
    LARGEST_COUNT,
    SINGLE,
    SINGLE_BYTES,
    LawNumbers,
    ValueForm,
    ValueNumbers,
    check_step,
    is_within,
    law_numbers,
    rounded,
    threshold_around,
)
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import nearest
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import along, distance, largest_component, limited, single, times, within


class LineNumbers(ValueNumbers, Protocol):
    """Numbers of a rule that affect lines."""

    @property
    def horizon_us(self) -> float:
        """Time after which the end of a line is held [µs]."""

    @property
    def slope_step(self) -> float:
        """Size of a count of the slope [N/s]."""


class Line(NamedTuple):
    """A stimulus that changes at a constant rate until the horizon."""

    # Where it starts [µs, N]
    t_us: int
    value: Vector
    rate: Vector  # how fast it changes [N/µs]
    is_bounded: bool  # whether it stays in range up to the horizon


class LineMessage(NamedTuple):
    """A transmitted line; `form` is the form of its value, the slope is in N/s."""

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
    """Return the message of a stimulus and the slope [N/s] after it."""
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
        """Return the line in a payload; PeerError if its length fits no form, or a component is out of range."""
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


IMPACT_THRESHOLDS: Final = 3.0
"""A stimulus further than this from the prediction is an impact or a breach.

An assumption. On the paper's scene, whose breaches take one sample, it saves at least a quarter of the packets; on
recorded forces it rarely matters. Any value from 2 to 4 has the same effect.
"""


class LineRule(NamedTuple):
    """The numbers of the rule. Satisfies `LineNumbers`."""

    weber: float
    floor: float
    step: float
    horizon_us: float
    slope_step: float
    slope_samples: int


class Sender(NamedTuple):
    """The line sent last, and whether the receiver is known to follow it; False after a loss."""

    is_known: bool
    line: Line


def start(rule: LineRule, axes: int) -> Sender:
    """Return a sender whose receiver follows no line yet."""
    return Sender(False, start_line(rule, axes))


def start_line(rule: Any, axes: int) -> Line:
    """Return a line of zeros."""
    return Line(0, (0.0,) * axes, (0.0,) * axes, True)


def is_silent(rule: LineRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Return whether a stimulus is within the threshold around the line."""
    return sender.is_known and is_within(rule, x, line_at(rule, sender.line, t_us))


def ends_past(rule: LineRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Return whether there is an impact; a slope must not use samples from before it."""
    return sender.is_known and is_impact(rule, x, line_at(rule, sender.line, t_us))


def is_impact(rule: LawNumbers, x: Vector, predicted: Vector) -> bool:
    """Return whether a stimulus is far from the predicted one."""
    return distance(x, predicted) > IMPACT_THRESHOLDS * threshold_around(rule, predicted)


def send(rule: LineRule, sender: Sender, t_us: int, x: Vector, past: Past) -> tuple[LineMessage, Sender]:
    """Send value and slope."""
    first = max(past.first, past.newest + 1 - rule.slope_samples)
    message = rounded_line(rule, x, least_squares_slope(past, first, x))
    return message, Sender(True, receive(rule, sender.line, t_us, message))


def refreshed(sender: Sender) -> Sender:
    """Mark the receiver's state as unknown."""
    return sender._replace(is_known=False)


def mirror(sender: Sender) -> Line:
    """Return the line that the receiver follows."""
    return sender.line


def receive(rule: LineRule, line: Line, t_us: int, message: LineMessage) -> Line:
    """Return the line of a message."""
    return line_from(rule, t_us, message.value, message.slope)


def least_squares_slope(past: Past, first: int, x: Vector) -> Vector:
    """Return the slope [N/s] of the least-squares line through samples from `first` to the newest, x, axis by axis.

    Computed in float64 from differences of times in µs and of stimuli, from the oldest sample to the newest; 0 if all
    samples have the same time.
    """
    newest_us = past.times_us[past.newest]
    count = float(past.newest + 1 - first)
    total = squares = 0.0
    for k in range(first, past.newest + 1):
        apart = float(past.times_us[k] - newest_us)
        total += apart
        squares += apart * apart
    spread = count * squares - total * total
    if len(x) == 1:
        return (_slope(past, first, 0, count, total, spread),)
    if len(x) == 2:
        return _slope(past, first, 0, count, total, spread), _slope(past, first, 1, count, total, spread)
    return (
        _slope(past, first, 0, count, total, spread),
        _slope(past, first, 1, count, total, spread),
        _slope(past, first, 2, count, total, spread),
    )


def _slope(past: Past, first: int, axis: int, count: float, total: float, spread: float) -> float:
    if spread == 0.0:
        return 0.0
    newest_us = past.times_us[past.newest]
    newest = past.samples[past.newest][axis]
    product = 0.0
    for k in range(first, past.newest + 1):
        apart = float(past.times_us[k] - newest_us)
        product += (count * apart - total) * (past.samples[k][axis] - newest)
    return within(1e6 * product / spread, LARGEST_COMPONENT)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPredictive(Scheme):
    """Transmit value and slope when the stimulus leaves the line that was transmitted last.

    Rule: both sides predict ``p = value + slope · min(t - t_sent, horizon)``; send when ``|x - p| > threshold(|p|)``,
    strictly. `slope` is the slope of the least-squares line through the newest samples, without those before an impact.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input.
    Between two samples, or while an update is late, it overshoots by ``|slope| · time`` more, until the horizon.

    Attributes
    ----------
    slope_samples
        Number of newest samples that the slope is fitted to: 2 to 64.
    horizon_ms
        Time for which a line is followed before its end is held [ms]: 1 to 10 000.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold, and of
        ``step_n / horizon`` [N/s] for the slope; 0: never.
    """

    name: ClassVar[str] = "linear-predictive"
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        ends_past=ends_past,
        start_receiver=start_line,
        receive=receive,
        mirror=mirror,
        apply=line_at,
        payload_bytes=line_bytes,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    slope_samples: float = 5
    horizon_ms: float = 100.0
    step_n: float = 0.0

    def __post_init__(self: Any) -> None:
        check_integer("slope_samples", self.slope_samples, 2, 64)
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_step(self.step_n)

    def rule(self: Any, axes: int, table: MakeTable) -> LineRule:  # noqa: ARG002
        """Return law, step of counts, and the numbers of the lines."""
        horizon_us, slope_step = self.horizon_ms * 1e3, slope_count(self.step_n, self.horizon_ms)
        return LineRule(*law_numbers(self.law), self.step_n, horizon_us, slope_step, int(self.slope_samples))

    def form(self: Any, axes: int) -> LineForm:
        """Return the form of its messages."""
        return LineForm(axes, step_n=self.step_n, slope_step=slope_count(self.step_n, self.horizon_ms))

    def past_samples(self: Any) -> int:
        """Return how many samples a slope is fitted to."""
        return int(self.slope_samples)


def slope_count(step_n: float, horizon_ms: float) -> float:
    """Return the size of a count of the slope [N/s]: it moves the end of the line by one count of the value."""
    return step_n * 1e3 / horizon_ms
