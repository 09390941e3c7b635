"""The predictors of the motion-predictive deadband: the message of each, given the newest samples."""

import math
from typing import Any, Final, NamedTuple

from hapticnet.codec.schemes.adaptive_predictive import BAND, LARGEST_OFFSET, ends_in_range, in_halves, share_at
from hapticnet.codec.schemes.contact import local_stiffness
from hapticnet.codec.schemes.linear_predictive import is_impact
from hapticnet.codec.schemes.motion import (
    COUPLED,
    CURVE,
    HOLD,
    LARGEST_VISCOSITY,
    SURFACE,
    UNSENT,
    Line,
    Message,
    Motion,
    line_at,
    line_of,
    line_on_one_axis,
    pressed,
)
from hapticnet.codec.schemes.trend import (
    MOST_SAMPLES,
    Regression,
    Trend,
    measured_trend,
    predicted_travel,
    updated,
    window_begin,
)
from hapticnet.codec.steps import Past
from hapticnet.codec.values import is_within, threshold_around
from hapticnet.rounding import as_half
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import along, dot, in_range, limited, minus, moved, put, row, single, times

KEPT: Final = 256  # capacity in samples. When it is full, the newest `MOST_SAMPLES` move to the front.


class Numbers(NamedTuple):
    """The numbers of the rule. Satisfies `MotionNumbers`."""

    weber: float
    floor: float
    horizon_us: float
    window_us: float
    stiffest: float


class MotionRule(NamedTuple):
    """The numbers of the rule, and the newest samples.

    Functions that need no samples are given the numbers alone: compiled, that saves counting references to tables.
    """

    numbers: Numbers
    # The newest samples: a row of times [µs], and a row each of stimuli [N], positions [m] and velocities [m/s]
    times_us: Any
    samples: Any
    positions: Any
    velocities: Any
    # Room for the part of the newest stimuli not explained by stiffness and viscosity
    residual_times_us: Any
    residuals: Any
    # The round trip [µs] as the only number, the samples of the last one, and what similar ones taught: `motion_felt`
    round_trip_us: Any
    remembered: Any
    cells: Any


class Predictor(NamedTuple):
    """A predictor that draws curves: its line, the sample it was drawn for, and its knowledge."""

    line: Line  # The line drawn last
    # Stimulus [N], position [m] and velocity [m/s] for which it was drawn
    sent: Vector
    position: Vector
    velocity: Vector
    trend: Trend  # The trend, at that time, of the part that the line's stiffness and viscosity do not explain
    regression: Regression  # How much of trends to use


def follows(numbers: Numbers, line: Line, motion: Motion, t_us: int, x: Vector) -> bool:
    """Return whether a stimulus is within the threshold around a line."""
    if line.kind == UNSENT:
        return False
    is_known, _, _, position, velocity = motion
    if len(x) == 1:  # inlined from below, because this runs several times at every sample
        applied = line_on_one_axis(numbers, line, is_known, position[0], velocity[0], t_us)
        width = numbers.weber * abs(applied)
        return abs(x[0] - applied) <= (width if width > numbers.floor else numbers.floor)
    return is_within(numbers, x, line_at(numbers, line, is_known, position, velocity, t_us))


def remember(rule: MotionRule, newest: int, t_us: int, x: Vector, motion: Motion) -> int:
    """Write a sample to the tables, and return its index."""
    _, _, _, position, velocity = motion
    newest += 1
    if newest == KEPT:
        first = KEPT - MOST_SAMPLES
        for k in range(MOST_SAMPLES):
            rule.times_us[0][k] = rule.times_us[0][first + k]
            put(rule.samples, k, row(rule.samples, first + k, x))
            put(rule.positions, k, row(rule.positions, first + k, x))
            put(rule.velocities, k, row(rule.velocities, first + k, x))
        newest = MOST_SAMPLES
    rule.times_us[0][newest] = t_us
    if len(x) == 1:  # inlined from below, because this runs at every sample
        rule.samples[newest][0] = x[0]
        rule.positions[newest][0] = position[0]
        rule.velocities[newest][0] = velocity[0]
        return newest
    put(rule.samples, newest, x)
    put(rule.positions, newest, position)
    put(rule.velocities, newest, velocity)
    return newest


def usable(numbers: Numbers, stiffness: float, viscosity: float, motion: Motion) -> tuple[float, float]:
    """Return stiffness and viscosity as transmitted; zeros without a position."""
    _, samples, _, _, _ = motion
    if samples == 0:
        return 0.0, 0.0
    return as_half(min(stiffness, numbers.stiffest)), as_half(min(viscosity, LARGEST_VISCOSITY))


def redrawn(
    rule: MotionRule,
    predictor: Predictor,
    motion: Motion,
    newest: int,
    t_us: int,
    x: Vector,
    stiffness: float,
    viscosity: float,
) -> Predictor:
    """Learn from how the last curve ended, and draw the next one."""
    numbers = rule.numbers
    line, sent, at, speed, trend, regression = predictor
    is_known, _, _, position, velocity = motion
    if line.kind != UNSENT and not is_impact(numbers, x, line_at(numbers, line, is_known, position, velocity, t_us)):
        change = along(minus(x, sent), -line.stiffness, minus(position, at))
        change = along(change, -line.viscosity, minus(velocity, speed))
        share = share_at(numbers, line.t_us, t_us)
        regression = updated(regression, trend, change, share, threshold_around(numbers, sent))
    trend = trend_beside(rule, motion, newest, x, stiffness, viscosity)
    message = drawn_curve(numbers, regression, trend, motion, x, stiffness, viscosity)
    return Predictor(line_of(numbers, t_us, message), x, position, velocity, trend, regression)


def trend_beside(rule: MotionRule, motion: Motion, newest: int, x: Vector, stiffness: float, viscosity: float) -> Trend:
    """Return the trend of the newest stimuli, without the part explained by stiffness and viscosity."""
    numbers = rule.numbers
    half_us, band_n = 0.5 * numbers.horizon_us, BAND * threshold_around(numbers, x)
    if stiffness == 0.0 and viscosity == 0.0:
        return measured_trend(Past(rule.times_us[0], rule.samples, 0, newest), x, half_us, numbers.window_us, band_n)
    times_us, samples, positions, velocities = rule.times_us[0], rule.samples, rule.positions, rule.velocities
    residual_times_us, residuals = rule.residual_times_us[0], rule.residuals
    _, known, _, position, velocity = motion
    first = max(newest + 1 - min(known, MOST_SAMPLES), 0)
    first = window_begin(times_us, first, newest, numbers.window_us)
    count = newest + 1 - first
    for k in range(count):
        index = first + k
        residual_times_us[k] = times_us[index]
        if len(x) == 1:  # inlined from below, because this runs for many samples
            left = samples[index][0] + stiffness * (position[0] - positions[index][0])
            residuals[k][0] = left + viscosity * (velocity[0] - velocities[index][0])
        else:
            without = along(row(samples, index, x), stiffness, minus(position, row(positions, index, x)))
            put(residuals, k, along(without, viscosity, minus(velocity, row(velocities, index, x))))
    past = Past(residual_times_us, residuals, 0, count - 1)
    return measured_trend(past, x, half_us, numbers.window_us, band_n)


def drawn_hold(numbers: Numbers, motion: Motion, value: Vector, x: Vector) -> Message:
    """Return a zero-order-hold message with a value near a stimulus x."""
    zeros = minus(x, x)
    return checked(numbers, Message(HOLD, False, value, zeros, zeros, 0.0, 0.0), motion, x)


def drawn_surface(rule: MotionRule, motion: Motion, newest: int, x: Vector, learned: float) -> Message:
    """Return the message of the recently touched surface; a hold if there is none."""
    numbers = rule.numbers
    _, known, _, position, _ = motion
    first = max(newest + 1 - known, 0)
    stiffness, across, normal = local_stiffness(
        rule.times_us[0], rule.samples, rule.positions, first, newest, BAND * threshold_around(numbers, x), learned, x
    )
    if stiffness > 0.0:
        root = math.sqrt(min(stiffness, numbers.stiffest))
        normal = halves(times(normal, root))
        if dot(normal, normal) > 0.0:
            across = as_half(min(across, numbers.stiffest))
            zeros = minus(x, x)
            flat = Line(SURFACE, 0, zeros, zeros, normal, across, 0.0)
            offset = minus(x, pressed(flat, position))
            return checked(numbers, Message(SURFACE, False, offset, zeros, normal, across, 0.0), motion, x)
    return drawn_hold(numbers, motion, x, x)


def drawn_curve(
    numbers: Numbers,
    regression: Regression,
    trend: Trend,
    motion: Motion,
    x: Vector,
    stiffness: float,
    viscosity: float,
) -> Message:
    """Return the message of a curve with the travel that a regression predicts, beside stiffness and viscosity."""
    zeros = minus(x, x)
    threshold = threshold_around(numbers, x)
    travel = predicted_travel(regression, trend, threshold)
    # If the curve starts nearer to zero, the threshold is smaller, by at most the Weber fraction of the offset.
    room = LARGEST_OFFSET * threshold / (1.0 + numbers.weber)
    begin = limited(moved(x, times(trend.level, regression.coefficients[2]), room), LARGEST_COMPONENT)
    if stiffness == 0.0 and viscosity == 0.0:
        return checked(numbers, Message(CURVE, False, begin, travel, zeros, 0.0, 0.0), motion, x)
    _, _, _, position, velocity = motion
    offset = along(along(begin, -stiffness, position), -viscosity, velocity)
    travel = single(limited(travel, LARGEST_COMPONENT))
    return checked(numbers, Message(COUPLED, False, offset, travel, zeros, stiffness, viscosity), motion, x)


def halves(x: Vector) -> Vector:
    """Return a vector whose components are rounded to float16."""
    if len(x) == 1:
        return (as_half(x[0]),)
    if len(x) == 2:
        return as_half(x[0]), as_half(x[1])
    return as_half(x[0]), as_half(x[1]), as_half(x[2])


def checked(numbers: Numbers, message: Message, motion: Motion, x: Vector) -> Message:
    """Return a message rounded for the wire: float32 if the stimulus is then within the threshold.

    If it is outside even with float64, hold the stimulus.
    """
    kind, _, value, travel, normal, stiffness, viscosity = message
    _, _, t_us, _, _ = motion  # any time, because no line depends on the time at its start
    if in_range(value):
        narrow = single(value)
        message = rounded_curve(numbers, Message(kind, False, narrow, travel, normal, stiffness, viscosity))
        if follows(numbers, line_of(numbers, t_us, message), motion, t_us, x):
            return message
        message = rounded_curve(numbers, Message(kind, True, value, travel, normal, stiffness, viscosity))
        if follows(numbers, line_of(numbers, t_us, message), motion, t_us, x):
            return message
    zeros = minus(x, x)
    return Message(HOLD, True, x, zeros, zeros, 0.0, 0.0)


def rounded_curve(numbers: Numbers, message: Message) -> Message:
    """Return a message with its travel as transmitted."""
    kind, is_wide, value, travel, normal, stiffness, viscosity = message
    if kind != CURVE:
        return message
    threshold = threshold_around(numbers, value)
    travel = in_halves(travel, threshold)
    if not ends_in_range(value, travel, threshold):
        travel = minus(travel, travel)
    return Message(kind, is_wide, value, travel, normal, stiffness, viscosity)
