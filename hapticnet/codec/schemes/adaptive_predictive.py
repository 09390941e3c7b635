"""The adaptive-predictive deadband: transmit a curve whose start and slope are learned from earlier curves.

Our own codec (docs/build/decisions.md, 0007). It is a predictive deadband (see `schemes.linear_predictive`) that learns
from its own prediction errors how much of two slopes and of a smoothed level to use (`schemes.trend`). It extrapolates
a smooth stimulus, holds the level of noise, and is a plain deadband on a stimulus without a trend. Only the sender
learns: each payload is a complete curve. The decaying slope is the damped trend of Gardner & McKenzie 1985,
"Forecasting trends in time series" (Management Science), with a parabola instead of their exponential, so that it ends.

The payload is a value as in `codec.values`, then the travel: float16 an axis, in thresholds around the value.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple, Protocol

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.linear_predictive import is_impact
from hapticnet.codec.schemes.trend import (
    MOST_SAMPLES,
    NOTHING_LEARNED,
    Regression,
    Trend,
    measured_trend,
    predicted_travel,
    updated,
)
from hapticnet.codec.steps import MakeTable, Past, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import (
    HALF,
    LawNumbers,
    ValueForm,
    check_step,
    is_within,
    law_numbers,
    rounded,
    threshold_around,
)
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import as_half
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import (
    along,
    distance,
    in_range,
    largest_component,
    limited,
    magnitude,
    minus,
    moved,
    plus,
    times,
    within,
)

TRAVEL_BYTES: Final = 2

LARGEST_TRAVEL: Final = 1024.0
"""Largest travel of an axis in thresholds. Far above any force of a hand; it bounds the effect of a lost update."""


class CurveNumbers(LawNumbers, Protocol):
    """Numbers of a rule that affect curves."""

    @property
    def horizon_us(self) -> float:
        """Time after which a curve is level [µs]."""


class Curve(NamedTuple):
    """A stimulus whose rate of change falls linearly to zero at the horizon: from `value` by `travel` [N]."""

    t_us: int
    value: Vector
    travel: Vector


class CurveMessage(NamedTuple):
    """A transmitted curve; `form` is the form of its value, the travel is in thresholds around it."""

    form: int
    value: Vector
    thresholds: Vector


def share_at(rule: CurveNumbers, begun_us: int, t_us: int) -> float:
    """Return the completed share (0 to 1), at a time, of the travel of a curve that began at `begun_us`."""
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
    """Return whether a curve ends in range."""
    return in_range(plus(value, times(thresholds, threshold)))


def curve_bytes(rule: Any, message: CurveMessage) -> int:
    """Return the size of the payload of a curve."""
    return (message.form + TRAVEL_BYTES) * len(message.value)


def check_travel(value: Vector, thresholds: Vector, law: WeberLaw) -> None:
    """Raise PeerError if a travel, in thresholds, is too large, or a curve with it does not end in range."""
    if not (
        largest_component(thresholds) <= LARGEST_TRAVEL
        and ends_in_range(value, thresholds, law.threshold_n(magnitude(value)))
    ):
        raise PeerError(
            f"payload holds a travel of {thresholds} thresholds; it must be within ±{LARGEST_TRAVEL:g} and end"
            f" within ±{LARGEST_COMPONENT:g}"
        )


class CurveForm:
    """Curves as bytes. Satisfies `Form`."""

    __slots__ = ("_law", "_travel", "_values")

    def __init__(self, axes: int, law: WeberLaw, *, step_n: float) -> None:
        self._law = law
        self._values = ValueForm(axes, step_n=step_n)
        self._travel = HALF[axes]

    def pack(self, message: CurveMessage) -> bytes:
        """Return the payload of a curve."""
        return self._values.pack((message.form, message.value)) + self._travel.pack(*message.thresholds)

    def unpack(self, payload: bytes, receiver: object = None) -> CurveMessage:  # noqa: ARG002
        """Return the curve in a payload; PeerError if its length fits no form, or an end is out of range."""
        form, value = self._values.unpack(payload[: -self._travel.size])
        thresholds: Vector = self._travel.unpack(payload[-self._travel.size :])
        check_travel(value, thresholds, self._law)
        return CurveMessage(form, value, thresholds)


LARGEST_OFFSET: Final = 0.9
"""Largest distance from the stimulus to the start of a curve, as a share of the threshold. The rest is for rounding."""

BAND: Final = 2.0
"""A sample further than this from the line through the newer ones, in thresholds, is from before an impact."""

SMALLEST_JUMP: Final = 0.1
"""Smallest bound on jumps, in thresholds. With a smaller one, most updates would start at the edge of the threshold."""


class CurveRule(NamedTuple):
    """The numbers of the rule. Satisfies `CurveNumbers`."""

    weber: float
    floor: float
    step: float
    horizon_us: float
    window_us: float
    jump: float


class Sender(NamedTuple):
    """The receiver's curve, and the sender's knowledge."""

    is_known: bool  # whether the receiver is known to follow the curve; False after a loss
    curve: Curve
    # The stimulus for which it was sent, and the trend at that time
    sent: Vector
    trend: Trend
    regression: Regression


def start(rule: Any, axes: int) -> Sender:
    """Return a sender that has learned nothing yet."""
    zeros = (0.0,) * axes
    return Sender(False, start_curve(rule, axes), zeros, Trend(zeros, zeros, zeros), NOTHING_LEARNED)


def start_curve(rule: Any, axes: int) -> Curve:
    """Return a curve of zeros."""
    return Curve(0, (0.0,) * axes, (0.0,) * axes)


def is_silent(rule: CurveRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Return whether a stimulus is within the threshold around the curve."""
    return sender.is_known and is_within(rule, x, curve_at(rule, sender.curve, t_us))


def send(rule: CurveRule, sender: Sender, t_us: int, x: Vector, past: Past) -> tuple[CurveMessage, Sender]:
    """Learn from how the last curve ended, and send the next one."""
    regression = sender.regression
    applied = curve_at(rule, sender.curve, t_us)
    if sender.is_known and not is_impact(rule, x, applied):
        share = share_at(rule, sender.curve.t_us, t_us)
        threshold = threshold_around(rule, sender.sent)
        regression = updated(regression, sender.trend, minus(x, sender.sent), share, threshold)
    threshold = threshold_around(rule, x)
    trend = measured_trend(past, x, 0.5 * rule.horizon_us, rule.window_us, BAND * threshold)
    travel = predicted_travel(regression, trend, threshold)
    # If the curve starts nearer to zero, the threshold is smaller, by at most the Weber fraction of the offset.
    room = LARGEST_OFFSET * threshold / (1.0 + rule.weber)
    wanted = moved(x, times(trend.level, regression.coefficients[2]), room)
    begin = wanted
    if sender.is_known and rule.jump > 0.0:
        begin = moved(applied, minus(wanted, applied), rule.jump * threshold)
        begin = moved(x, minus(begin, x), room)
        travel = minus(plus(travel, wanted), begin)
    form, value, threshold = rounded(rule, limited(begin, LARGEST_COMPONENT))
    if not distance(x, value) <= threshold:
        form, value, threshold = rounded(rule, x)
    thresholds = in_halves(travel, threshold)
    if not ends_in_range(value, thresholds, threshold):
        thresholds = minus(thresholds, thresholds)
    message = CurveMessage(form, value, thresholds)
    return message, Sender(True, curve_of(rule, t_us, message), x, trend, regression)


def refreshed(sender: Sender) -> Sender:
    """Mark the receiver's state as unknown."""
    return sender._replace(is_known=False)


def mirror(sender: Sender) -> Curve:
    """Return the curve that the receiver follows."""
    return sender.curve


def receive(rule: CurveRule, curve: Curve, t_us: int, message: CurveMessage) -> Curve:
    """Return the curve of a message."""
    return curve_of(rule, t_us, message)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptivePredictive(Scheme):
    """Transmit a curve that predicts the stimulus, with coefficients learned from earlier curves.

    Rule: both sides apply ``p = value + travel · s · (2 - s)``, ``s = min((t - t_sent) / horizon, 1)``. Send when ``|x
    - p| > threshold(|p|)``, strictly. A curve has ``travel = horizon / 2 · (c1 · short slope + c2 · long slope)`` and
    ``value = x + c3 · level``. Slopes and level come from the newest samples, the c are learned by least squares
    (both in `schemes.trend`). Where both slopes agree, a curve leads them by at most 0.3 thresholds.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input. After
    a loss, or while an update is late, the receiver follows the curve to its end, at most ``|travel|`` from its start.

    Attributes
    ----------
    horizon_ms
        Time in which the slope falls to zero [ms]: 1 to 10 000.
    window_ms
        Window of the long slope [ms]: 1 to 1000, lengthened to three sampling periods if necessary. The window of the
        short slope is 0.3 of it.
    jump_thresholds
        Largest jump of the applied stimulus at an update, in thresholds: 0.1 to 10. A larger one is made only if the
        rule demands it; the curve makes up the rest. 0: no limit, which sends the fewest packets.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "adaptive-predictive"
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        start_receiver=start_curve,
        receive=receive,
        mirror=mirror,
        apply=curve_at,
        payload_bytes=curve_bytes,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    horizon_ms: float = 200.0
    window_ms: float = 17.0
    jump_thresholds: float = 0.0
    step_n: float = 0.0

    def __post_init__(self: Any) -> None:
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("window_ms", self.window_ms, 1.0, 1000.0)
        if self.jump_thresholds:
            check_parameter("jump_thresholds", self.jump_thresholds, SMALLEST_JUMP, 10.0)
        check_step(self.step_n)

    def rule(self: Any, axes: int, table: MakeTable) -> CurveRule:  # noqa: ARG002
        """Return law, step of counts, and the numbers of the curves."""
        horizon_us, window_us = self.horizon_ms * 1e3, self.window_ms * 1e3
        return CurveRule(*law_numbers(self.law), self.step_n, horizon_us, window_us, self.jump_thresholds)

    def form(self: Any, axes: int) -> CurveForm:
        """Return the form of its messages."""
        return CurveForm(axes, self.law, step_n=self.step_n)

    def past_samples(self: Any) -> int:
        """Return the number of past samples that trends use."""
        return MOST_SAMPLES
