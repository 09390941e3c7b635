"""The adaptive-predictive deadband: a curve whose slope and start are what has predicted the stimulus best so far.

Our own codec. It is a predictive deadband (see `schemes.linear_predictive`) that learns, from the errors of its own
predictions, how far to trust two slopes and a smoothed level. Where the stimulus is smooth it extrapolates; where it is
noise it holds the level; where it wanders without a trend it becomes a plain deadband. The receiver learns nothing:
each payload is a whole curve. The slope that dies away is the damped trend of Gardner & McKenzie 1985, "Forecasting
trends in time series" (Management Science), with a parabola instead of their exponential, so that it ends.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.payload.curves import (
    Curve,
    CurveForm,
    CurveMessage,
    curve_at,
    curve_bytes,
    curve_of,
    ends_in_range,
    in_halves,
    share_at,
)
from hapticnet.codec.payload.values import (
    check_step,
    is_within,
    law_numbers,
    rounded,
    threshold_around,
)
from hapticnet.codec.schemes.linear_predictive import is_impact
from hapticnet.codec.schemes.trend import MOST_SAMPLES, UNTAUGHT, Causes, Trust, expected, taught, trend
from hapticnet.codec.steps import MakeTable, Past, Scheme, Steps
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import distance, limited, minus, moved, plus, times

LARGEST_OFFSET: Final = 0.9
"""How far from the stimulus a curve may start, as a share of what the threshold allows. The rest is for rounding."""

BAND: Final = 2.0
"""A sample further than this from the line through the newer ones, in thresholds, is from before an impact."""

SMALLEST_JUMP: Final = 0.1
"""The least bound on jumps, in thresholds. Below it most updates would have to start at the edge of the threshold."""


class CurveRule(NamedTuple):
    """The numbers of the rule. Satisfies `CurveNumbers`."""

    weber: float
    floor: float
    step: float
    horizon_us: float
    window_us: float
    jump: float


class Learner(NamedTuple):
    """What the receiver follows, and what the sender has learned.

    Attributes
    ----------
    is_known
        Whether the receiver is known to follow the curve.
    curve
        The curve.
    sent, causes
        The stimulus that it was sent for, and what was thought to move that.
    trust
        What has been learned.
    """

    is_known: bool
    curve: Curve
    sent: Vector
    causes: Causes
    trust: Trust


def start(rule: Any, axes: int) -> Learner:
    """Return a sender that has learned nothing."""
    zeros = (0.0,) * axes
    return Learner(False, start_curve(rule, axes), zeros, Causes(zeros, zeros, zeros), UNTAUGHT)


def start_curve(rule: Any, axes: int) -> Curve:
    """Return a curve of zeros."""
    return Curve(0, (0.0,) * axes, (0.0,) * axes)


def is_silent(rule: CurveRule, learner: Learner, t_us: int, x: Vector) -> bool:
    """Tell whether a stimulus is within the threshold around the curve."""
    return learner.is_known and is_within(rule, x, curve_at(rule, learner.curve, t_us))


def send(rule: CurveRule, learner: Learner, t_us: int, x: Vector, past: Past) -> tuple[CurveMessage, Learner]:
    """Learn from how the last curve ended, and send the next one."""
    trust = learner.trust
    applied = curve_at(rule, learner.curve, t_us)
    if learner.is_known and not is_impact(rule, x, applied):
        share = share_at(rule, learner.curve, t_us)
        threshold = threshold_around(rule, learner.sent)
        trust = taught(trust, learner.causes, minus(x, learner.sent), share, threshold)
    threshold = threshold_around(rule, x)
    causes = trend(past, x, 0.5 * rule.horizon_us, rule.window_us, BAND * threshold)
    travel = expected(trust, causes, threshold)
    # At a start nearer to zero the threshold is smaller, by at most the Weber fraction of the offset.
    room = LARGEST_OFFSET * threshold / (1.0 + rule.weber)
    wanted = moved(x, times(causes.level, trust.trusted[2]), room)
    begin = wanted
    if learner.is_known and rule.jump > 0.0:
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
    return message, Learner(True, curve_of(rule, t_us, message), x, causes, trust)


def refreshed(learner: Learner) -> Learner:
    """Return a receiver that is not known to follow the curve."""
    return learner._replace(is_known=False)


def mirror(learner: Learner) -> Curve:
    """Return what the receiver follows."""
    return learner.curve


def receive(rule: CurveRule, curve: Curve, t_us: int, message: CurveMessage) -> Curve:
    """Return the curve of a message."""
    return curve_of(rule, t_us, message)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptivePredictive(Scheme):
    """Transmit a curve that foretells the stimulus, as learned from how earlier curves ended.

    Rule: both sides apply ``p = value + travel · s · (2 - s)``, ``s = min((t - t_sent) / horizon, 1)``: a slope that
    dies away and ends in a hold. Send when ``|x - p| > threshold(|p|)``, strictly. The first stimulus is always sent.
    The curve sent has ``travel = horizon / 2 · (c1 · short slope + c2 · long slope)`` and ``value = x + c3 · level``;
    the slopes are those of the newest samples (`schemes.trend`), the level is how far their line passes from x, and the
    c are learned by least squares (`schemes.trend`), such that a slope that goes on, and on
    which both agree, is led by 0.3 thresholds at most. A curve never starts further from x than the threshold.
    Payload: the value as in the deadband, then an axis at a time float16, the travel in thresholds around the value.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input.
    After a loss, and for as long as an update comes late, the curve is followed to its end: by then it is at most
    ``|travel|`` from its start.

    Attributes
    ----------
    horizon_ms
        For how long the slope takes to die away [ms]: 1 to 10 000.
    window_ms
        How old the samples are that the long slope is taken from [ms]: 1 to 1000, and no less than three sampling
        periods; the short one, 0.3 of that.
    jump_thresholds
        How far the applied stimulus may jump when an update arrives, in thresholds: 0.1 to 10; further only as far as
        the threshold around the stimulus demands. The rest of the way is made up for along the curve. 0: as far as
        saves most.
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

    def __post_init__(self) -> None:
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("window_ms", self.window_ms, 1.0, 1000.0)
        if self.jump_thresholds:
            check_parameter("jump_thresholds", self.jump_thresholds, SMALLEST_JUMP, 10.0)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> CurveRule:  # noqa: ARG002
        """Return law, step of counts, and what curves depend on."""
        horizon_us, window_us = self.horizon_ms * 1e3, self.window_ms * 1e3
        return CurveRule(*law_numbers(self.law), self.step_n, horizon_us, window_us, self.jump_thresholds)

    def form(self, axes: int) -> CurveForm:
        """Return the form of its messages."""
        return CurveForm(axes, self.law, step_n=self.step_n)

    def past_samples(self) -> int:
        """Return the length of the past that trends are taken from."""
        return MOST_SAMPLES
