"""The offline optima: valid, and no valid reconstruction needs fewer pieces."""

import math
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.errors import SampleError
from hapticnet.measure import bound
from hapticnet.measure.bound import fewest_holds, fewest_lines, hold_starts, line_starts, tube
from hapticnet.perception import WeberLaw

SLACK = 1e-12
"""Relative rounding granted to a held value or line, and to the thresholds between which an optimum must lie."""

normal = st.floats(-1e15, 1e15, allow_subnormal=False)
forces = st.one_of(st.floats(-6.0, 6.0, allow_subnormal=False), st.integers(-8, 8).map(float), st.just(0.0), normal)
laws = st.builds(
    WeberLaw,
    weber_fraction=st.sampled_from([0.0, 0.05, 0.1, 0.25, 0.9]),
    floor_n=st.sampled_from([0.0, 0.025, 0.5, 1.0]),
    multiplier=st.sampled_from([0.0, 0.5, 1.0, 2.0, 4.0]),
)
steps_us = st.lists(st.sampled_from([0, 1, 1000, 1000, 2500]), min_size=12, max_size=12)


def recordings(axes, most=30):
    return npst.arrays(np.float64, st.tuples(st.integers(0, most), st.just(axes)), elements=forces)


def admits(law: WeberLaw, x: float, r: Fraction, slack: float = 0.0) -> bool:
    """The rule in exact arithmetic, with thresholds wider by a share of themselves."""
    weber, floor = Fraction(law.multiplier * law.weber_fraction), Fraction(law.multiplier * law.floor_n)
    return abs(Fraction(x) - r) <= max(weber * abs(r), floor) * (1 + Fraction(slack))


def ends(law: WeberLaw, x: float, slack: float) -> list[Fraction]:
    """Where |x − r| equals the threshold of either kind: all r at which what is admitted can begin or end."""
    weber = Fraction(law.multiplier * law.weber_fraction) * (1 + Fraction(slack))
    floor = Fraction(law.multiplier * law.floor_n) * (1 + Fraction(slack))
    x = Fraction(x)
    weber_ends = [x / divisor for divisor in (1 + weber, 1 - weber) if divisor]
    return [r for r in (x, x - floor, x + floor, *weber_ends) if admits(law, float(x), r, slack)]


def interval(law: WeberLaw, x: float, slack: float) -> tuple[Fraction, Fraction]:
    candidates = ends(law, x, slack)
    return min(candidates), max(candidates)


def dynamic_programme(n: int, fits) -> int:
    """The fewest pieces of n samples, by trying all last pieces of all beginnings."""
    best = [0] + [n + 1] * n
    for end in range(1, n + 1):
        best[end] = min(best[start] + 1 for start in range(end) if fits(start, end))
    return best[n]


def one_value_fits(law, values, slack):
    def fits(start, end):
        piece = values[start:end]
        # What is admitted in common begins where what one sample admits begins, so no other r need be tried.
        return any(all(admits(law, y, r, slack) for y in piece) for x in piece for r in ends(law, x, slack))

    return fits


def one_line_fits(law, times, values, slack):
    ranges = [interval(law, x, slack) for x in values]

    def pierces(line, samples):
        slope, offset = line
        return all(ranges[i][0] <= slope * times[i] + offset <= ranges[i][1] for i in samples)

    def fits(start, end):
        samples = range(start, end)
        # A line through all ranges can be moved until it touches the ends of two, or is level.
        lines = [(Fraction(0), end_of) for i in samples for end_of in ranges[i]]
        for i, j in combinations(samples, 2):
            if times[i] != times[j]:
                for a in ranges[i]:
                    slopes = [(b - a) / (times[j] - times[i]) for b in ranges[j]]
                    lines += [(slope, a - slope * times[i]) for slope in slopes]
        return any(pierces(line, samples) for line in lines)

    return fits


@given(recordings(1), laws)
@example(np.array([[1.0], [1.25], [0.75], [1.2500000001]]), WeberLaw(weber_fraction=0.25, floor_n=0.0))
@example(np.array([[-3.0], [3.0]]), WeberLaw(weber_fraction=0.5, floor_n=0.0, multiplier=2.0))
def test_each_hold_has_a_value_that_all_its_samples_admit(stimuli, law):
    starts = hold_starts(law, stimuli)
    low, high = tube(law, stimuli[:, 0])
    if len(stimuli):
        assert (np.maximum.reduceat(low, starts) <= np.minimum.reduceat(high, starts)).all()
    assert fewest_holds(law, stimuli) == len(starts)


@given(recordings(1, most=7), laws.filter(lambda law: law.multiplier * law.weber_fraction < 1.0))
def test_no_holds_are_fewer_than_the_fewest(stimuli, law):
    values = stimuli[:, 0].tolist()
    fewest = fewest_holds(law, stimuli)
    assert fewest <= dynamic_programme(len(values), one_value_fits(law, values, 0.0))
    assert fewest >= dynamic_programme(len(values), one_value_fits(law, values, SLACK))


@given(st.integers(1, 3).flatmap(recordings), laws)
def test_plain_deadband_never_sends_less_than_the_bound_and_lines_are_never_more_than_holds(stimuli, law):
    t_us = np.arange(len(stimuli)) * 1000
    lines, holds = fewest_lines(law, t_us, stimuli), fewest_holds(law, stimuli)
    sent = len(encode_array(Deadband(law=law), t_us, stimuli).sent)
    assert max(lines, holds) <= sent
    assert lines <= holds or stimuli.shape[1] > 1


@pytest.mark.parametrize(
    ("x", "low", "high"),
    [(1.0, 0.8, 4 / 3), (-1.0, -4 / 3, -0.8), (0.1, 0.0, 0.2), (0.0, -0.1, 0.1), (0.35, 0.25, 0.35 / 0.75)],
)
def test_what_a_stimulus_admits_is_the_union_of_weber_and_floor(x, low, high):
    ends_of_tube = tube(WeberLaw(weber_fraction=0.25, floor_n=0.1), np.array([x]))
    assert np.concatenate(ends_of_tube) == pytest.approx([low, high])


@given(forces, laws.filter(lambda law: law.multiplier * law.weber_fraction < 1.0), st.floats(-2.0, 2.0))
def test_the_tube_is_what_the_rule_admits_and_nothing_else(x, law, share):
    (low,), (high,) = tube(law, np.array([x]))
    exact_low, exact_high = interval(law, x, 0.0)
    # No double that is admitted is left out.
    least, most = float(exact_low), float(exact_high)
    assert low <= (least if least >= exact_low else math.nextafter(least, math.inf))
    assert high >= (most if most <= exact_high else math.nextafter(most, -math.inf))
    assert low == pytest.approx(float(exact_low), rel=1e-13, abs=1e-14 * (abs(x) + 1.0))
    assert high == pytest.approx(float(exact_high), rel=1e-13, abs=1e-14 * (abs(x) + 1.0))
    r = exact_low + (exact_high - exact_low) * Fraction(share)
    assert admits(law, x, r) == (0.0 <= share <= 1.0 or exact_low == exact_high)


def test_a_threshold_as_large_as_the_stimulus_needs_one_packet():
    stimuli = np.array([[5.0], [-3.0], [0.0], [1e15]])
    law = WeberLaw(weber_fraction=0.5, multiplier=2.0)
    assert fewest_lines(law, np.arange(4), stimuli) == fewest_holds(law, np.hstack([stimuli, stimuli])) == 1


@given(
    st.lists(st.one_of(st.integers(-8, 8).map(float), st.integers(-400, 400).map(lambda n: n / 64)), max_size=6),
    laws.filter(lambda law: law.multiplier * law.weber_fraction < 1.0),
    steps_us,
)
@example([1.0, 1.0, 5.0, -2.0, 5.0, 0.0], WeberLaw(weber_fraction=0.25, floor_n=0.5), [0, 0, 1000, 0, 1, 1] * 2)
def test_no_lines_are_fewer_than_the_fewest(values, law, steps):
    t_us = np.cumsum(steps[: len(values)]).astype(np.int64)
    fewest = fewest_lines(law, t_us, np.array(values)[:, np.newaxis])
    assert fewest <= dynamic_programme(len(values), one_line_fits(law, t_us.tolist(), values, -SLACK))
    assert fewest >= dynamic_programme(len(values), one_line_fits(law, t_us.tolist(), values, SLACK))


@pytest.mark.parametrize("half", [0, 1, 3, 10, 40])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_longest_lines_of_whole_numbers_equal_those_of_all_pairs(order, half):
    """Longer pieces, so that the hulls turn: noise, its sum and the sum of that."""
    values = np.random.default_rng(order + half).integers(-3, 4, 4000)
    for _ in range(order):
        values = np.cumsum(values)
    starts, steepest, flattest = [0], math.inf, -math.inf
    for i in range(1, len(values)):
        # A line pierces all ranges when no pair of them asks for a slope that another one forbids. Quotients of whole
        # numbers this small are equal as doubles only where they are equal.
        j = np.arange(starts[-1], i)
        steepest = min(steepest, ((values[i] - values[j] + 2 * half) / (i - j)).min())
        flattest = max(flattest, ((values[i] - values[j] - 2 * half) / (i - j)).max())
        if flattest > steepest:
            starts.append(i)
            steepest, flattest = math.inf, -math.inf
    stimuli = values.astype(np.float64)[:, np.newaxis]
    law = WeberLaw(weber_fraction=0.0, floor_n=float(half))
    assert line_starts(law, np.arange(len(values)), stimuli).tolist() == starts


def test_a_ramp_is_one_line_and_a_corner_a_second_one():
    t_us = np.arange(2000, dtype=np.int64) * 1000
    corner = np.minimum(np.arange(2000), 1000)[:, np.newaxis] * 1e-2
    assert line_starts(WeberLaw(weber_fraction=0.0, floor_n=1e-6), t_us, corner).tolist() == [0, 1001]
    assert fewest_holds(WeberLaw(), corner) > 20


@pytest.mark.parametrize("axes", [1, 2])
def test_compiled_sweeps_agree_with_plain_python(monkeypatch, axes):
    rng = np.random.default_rng(7)
    stimuli = np.cumsum(rng.normal(0.0, 0.02, (20_000, axes)), axis=0)
    t_us = np.cumsum(rng.integers(0, 3, 20_000)) * 1000
    law = WeberLaw()
    plain = fewest_holds(law, stimuli), fewest_lines(law, t_us, stimuli)
    lines = line_starts(law, t_us, stimuli[:, :1])
    monkeypatch.setattr(bound, "COMPILE_HOLDS_ABOVE", 0)
    monkeypatch.setattr(bound, "COMPILE_LINES_ABOVE", 0)
    assert (fewest_holds(law, stimuli), fewest_lines(law, t_us, stimuli)) == plain
    assert line_starts(law, t_us, stimuli[:, :1]).tolist() == lines.tolist()


def test_what_cannot_be_used_is_refused():
    with pytest.raises(SampleError, match="sample 1: stimulus is"):
        fewest_holds(WeberLaw(), np.array([[1.0], [math.nan]]))
    with pytest.raises(SampleError, match="sample 2 is at 4 µs, after 5 µs"):
        fewest_lines(WeberLaw(), np.array([0, 5, 4]), np.zeros((3, 1)))
    with pytest.raises(SampleError, match="2 axes"):
        hold_starts(WeberLaw(), np.zeros((3, 2)))
