"""The least-squares predictor: both sides predict from earlier updates, and residuals take a few bits.

Sakr, Zhou, Georganas, Zhao & Shen 2008, "Prediction-based haptic data reduction and compression in tele-mentoring
systems" (IMTC): least-squares prediction, uniform quantisation, adaptive Golomb-Rice codes. Sakr, Zhou, Georganas, Zhao
& Petriu 2009, "Robust perception-based data reduction and transmission in telehaptic systems" (World Haptics): a
median filter before it. The numbering of updates and the restart at impacts are our own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from hapticnet.checks import check_integer, check_parameter
from hapticnet.codec.schemes.linear_predictive import (
    IMPACT_THRESHOLDS,
    Line,
    is_impact,
    least_squares_slope,
    line_at,
    line_from,
    rounded_line,
    slope_count,
)
from hapticnet.codec.steps import MakeTable, Past, Steps, Table
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import (
    check_step,
    counted,
    is_within,
    law_numbers,
    threshold_around,
)
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import (
    along,
    in_range,
    largest_component,
    limited,
    magnitude,
    minus,
    over,
    put,
    row,
    times,
)
from hapticnet_literature.residuals import (
    ABSOLUTE_EVERY,
    COUNTS,
    LARGEST_STEPS,
    RESIDUAL,
    Rice,
    Update,
    UpdateForm,
    first_rice,
    fits,
    next_rice,
    update_bytes,
)


class LeastSquaresRule(NamedTuple):
    """The numbers of the rule, and tables of the last updates. Satisfies `LineNumbers`.

    Attributes
    ----------
    times_us, values
        Times [µs] and values of the last updates since the line was restarted, the oldest first.
    filtered
        The values after the median filter.
    """

    weber: float
    floor: float
    step: float
    horizon_us: float
    slope_step: float
    updates: int
    fraction: float
    absolute_every: int
    first_mean: int
    times_us: list[float]
    values: Table
    filtered: Table


class Predictor(NamedTuple):
    """State that both sides share.

    Attributes
    ----------
    number
        That of the last update, 0 to 127; -1 before the first.
    line
        The line from the last update on.
    rice
        The state of the Golomb-Rice codes.
    known
        How many updates are in the tables of the rule.
    """

    number: int
    line: Line
    rice: Rice
    known: int


class Sender(NamedTuple):
    """The shared state, and the number of updates since the last absolute one; -1: the next one must be absolute."""

    predictor: Predictor
    since_absolute: int


def start(rule: LeastSquaresRule, axes: int) -> Sender:
    """Return a sender whose next update is absolute."""
    return Sender(start_predictor(rule, axes), -1)


def start_predictor(rule: LeastSquaresRule, axes: int) -> Predictor:
    """Return a predictor without updates."""
    line = Line(0, (0.0,) * axes, (0.0,) * axes, True)
    return Predictor(-1, line, first_rice(rule.first_mean), 0)


def is_silent(rule: LeastSquaresRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Tell whether a stimulus is within the threshold around the prediction."""
    return sender.since_absolute >= 0 and is_within(rule, x, line_at(rule, sender.predictor.line, t_us))


def send(rule: LeastSquaresRule, sender: Sender, t_us: int, x: Vector, past: Any) -> tuple[Update, Sender]:
    """Send a residual if it is close and short enough, else an absolute update."""
    predictor = sender.predictor
    predicted = line_at(rule, predictor.line, t_us)
    step = rule.fraction * threshold_around(rule, predicted)
    if 0 <= sender.since_absolute < rule.absolute_every - 1 and step > 0.0:
        steps = over(minus(x, predicted), step)
        if largest_component(steps) < LARGEST_STEPS:
            residual = counted(steps, 1.0)
            value = along(predicted, step, residual)
            parameter = predictor.rice.parameter
            if fits(residual, parameter) and in_range(value) and is_within(rule, x, value):
                update = Update(RESIDUAL, predictor.number, residual, residual, parameter)
                return update, Sender(advanced(rule, predictor, t_us, residual, value), sender.since_absolute + 1)
    known = remember(rule, predictor.known, t_us, x, is_impact(rule, x, predicted))
    line = rounded_line(rule, x, filtered_slope(rule, known, x))
    update = Update(line.form, (predictor.number + 1) % COUNTS, line.value, line.slope, 0)
    return update, Sender(receive(rule, predictor, t_us, update), 0)


def refreshed(sender: Sender) -> Sender:
    """Return a sender whose next update is absolute."""
    return sender._replace(since_absolute=-1)


def mirror(sender: Sender) -> Predictor:
    """Return the shared state."""
    return sender.predictor


def receive(rule: LeastSquaresRule, predictor: Predictor, t_us: int, update: Update) -> Predictor:
    """Return the shared state after an update; PeerError if a residual leads out of range."""
    if update.form != RESIDUAL:
        known = remember(rule, 0, t_us, update.value, True)
        line = line_from(rule, t_us, update.value, update.slope)
        return Predictor(update.number, line, first_rice(rule.first_mean), known)
    predicted = line_at(rule, predictor.line, t_us)
    step = rule.fraction * threshold_around(rule, predicted)
    value = along(predicted, step, update.value)
    if not in_range(value):
        raise PeerError("residual leads beyond ±1e15 N")
    return advanced(rule, predictor, t_us, update.value, value)


def advanced(rule: LeastSquaresRule, predictor: Predictor, t_us: int, residual: Vector, value: Vector) -> Predictor:
    """Return the shared state after a residual that leads to a value."""
    # Compared as steps, not as forces: both sides must agree to the bit.
    impact = magnitude(residual) * rule.fraction > IMPACT_THRESHOLDS
    known = remember(rule, predictor.known, t_us, value, impact)
    line = line_from(rule, t_us, value, filtered_slope(rule, known, value))
    return Predictor((predictor.number + 1) % COUNTS, line, next_rice(predictor.rice, residual), known)


def apply(rule: LeastSquaresRule, predictor: Predictor, t_us: int) -> Vector:
    """Return the prediction for a time."""
    return line_at(rule, predictor.line, t_us)


def remember(rule: LeastSquaresRule, known: int, t_us: int, value: Vector, alone: bool) -> int:
    """Append an update to the tables, or replace all updates by it (`alone`); return their number."""
    times_us, values = rule.times_us, rule.values
    place = 0 if alone else known
    if place == rule.updates:
        place -= 1
        for k in range(place):
            times_us[k] = times_us[k + 1]
            put(values, k, row(values, k + 1, value))
    times_us[place] = t_us
    put(values, place, value)
    return place + 1


def filtered_slope(rule: LeastSquaresRule, known: int, newest: Vector) -> Vector:
    """Return the slope [N/s] through the updates, each but the first and last replaced by the median of three."""
    values, filtered = rule.values, rule.filtered
    if known < 3:
        return slope_between(rule.times_us, values, newest) if known == 2 else minus(newest, newest)
    put(filtered, 0, row(values, 0, newest))
    put(filtered, known - 1, newest)
    for k in range(1, known - 1):
        for axis in range(len(newest)):
            filtered[k][axis] = median(values, k, axis)
    return least_squares_slope(Past(rule.times_us, filtered, 0, known - 1), 0, newest)


def slope_between(times_us: Sequence[float], values: Table, newest: Vector) -> Vector:
    """Return `least_squares_slope` of two updates, the same to the bit; 0 if they have the same time."""
    apart, zeros = float(times_us[0] - times_us[1]), minus(newest, newest)
    if apart == 0.0:
        return zeros
    product = along(zeros, apart, minus(row(values, 0, newest), newest))
    return limited(over(times(product, 1e6), apart * apart), LARGEST_COMPONENT)


def median(values: Sequence[Sequence[float]], k: int, axis: int) -> float:
    """Return the median of a value and its two neighbours."""
    a, b, c = values[k - 1][axis], values[k][axis], values[k + 1][axis]
    return max(min(a, b), min(max(a, b), c))


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastSquares(Scheme):
    """Transmit, in a few bits, the difference between the stimulus and its prediction from earlier updates.

    Rule: both sides predict ``p = value + slope · min(t - t_sent, horizon)`` from the last update. The slope is that of
    the least-squares line through the last `updates` transmitted values, each but the first and the last replaced by
    the median of itself and its neighbours; after an impact, earlier updates are not used. Send when
    ``|x - p| > threshold(|p|)``, strictly.
    Payload: a byte, and the residual in steps of ``step_fraction · threshold(|p|)``, an axis at a time, Golomb-Rice
    coded. The byte names the update that it builds on; a decoder whose last update is another one refuses the payload,
    and the session repairs the loss. An absolute payload has value and slope, as in the linear-predictive codec, and
    restarts both sides. It is sent first, after a refresh, as every `absolute_every`-th update, and wherever a residual
    would be too inaccurate or longer than float32.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input.
    After a loss the receiver follows the last line to the horizon and holds its end until the next absolute payload. (A
    run of exactly 128 n lost updates is not noticed until then.)

    Attributes
    ----------
    updates
        Number of transmitted values that the slope is fitted to: 2 (the line through them) to 16. More values and their
        median help on pure noise; on recorded forces and the paper's scene each costs packets.
    horizon_ms
        Time for which a line is followed before its end is held [ms]: 1 to 10 000.
    step_fraction
        Quantisation step of a residual, in thresholds: 0.01 to 1. Above 0.5, rounding leaves several axes near the edge
        of the dead zone, which takes many more packets.
    absolute_every
        Updates from one absolute payload to the next, at most: 1 to 127.
    step_n
        Absolute payloads of int16 multiples of this [N], as in the linear-predictive codec; 0: never.
    """

    name: ClassVar[str] = "least-squares"
    builds_on_earlier: ClassVar[bool] = True
    receiver_has_tables: ClassVar[bool] = True
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        start_receiver=start_predictor,
        receive=receive,
        mirror=mirror,
        apply=apply,
        payload_bytes=update_bytes,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    updates: float = 2
    horizon_ms: float = 100.0
    step_fraction: float = 0.5
    absolute_every: float = 16
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_integer("updates", self.updates, 2, 16)
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("step_fraction", self.step_fraction, 0.01, 1.0)
        check_integer("absolute_every", self.absolute_every, 1, ABSOLUTE_EVERY)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> LeastSquaresRule:
        """Return law, step of counts, what predictions and residuals depend on, and empty tables."""
        updates = int(self.updates)
        return LeastSquaresRule(
            *law_numbers(self.law),
            step=self.step_n,
            horizon_us=self.horizon_ms * 1e3,
            slope_step=slope_count(self.step_n, self.horizon_ms),
            updates=updates,
            fraction=self.step_fraction,
            absolute_every=int(self.absolute_every),
            # A residual is above the threshold: folded, it is at least twice the steps that make up a threshold.
            first_mean=math.floor(2.0 / self.step_fraction + 0.5),
            times_us=table(1, updates)[0],
            values=table(updates, axes),
            filtered=table(updates, axes),
        )

    def form(self, axes: int) -> UpdateForm:
        """Return the form of its messages."""
        return UpdateForm(axes, step_n=self.step_n, slope_step=slope_count(self.step_n, self.horizon_ms))
