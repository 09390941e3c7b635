"""Intervals, exact tests and equivalence, against closed forms, scipy and complete enumeration."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from hapticnet_experiment.statistics import (
    chance_variance,
    equivalence,
    holm,
    mean_interval,
    share_interval,
    sign_flip,
    standard_error,
    two_sided,
    wilson,
)


@pytest.mark.parametrize("trials", [1, 7, 80])
def test_wilson_is_that_of_scipy_and_covers_the_share_within_0_and_1(trials):
    for successes in range(trials + 1):
        low, high = wilson(successes / trials, trials)
        expected = stats.binomtest(successes, trials).proportion_ci(method="wilson")
        assert (low, high) == pytest.approx(tuple(expected), abs=1e-12)
        assert 0.0 <= low <= successes / trials <= high <= 1.0


def test_the_standard_error_is_the_paper_s():
    scores = [10, 10, 10, 9, 7, 7, 5, 4]  # 62 of 80
    assert standard_error(np.array(scores) / 10) == pytest.approx(np.std(scores, ddof=1) / 10 / math.sqrt(8))
    assert standard_error([0.5]) is None


def enumerated(differences, shift=0.0):
    values = np.asarray(differences) - shift
    sums = np.array(list(product((-1, 1), repeat=len(values)))) @ np.abs(values)
    return (sums <= values.sum() + 1e-9).mean(), (sums >= values.sum() - 1e-9).mean()


@given(scores=st.lists(st.integers(-10, 10), min_size=1, max_size=8), margin=st.sampled_from([0.0, 0.05, 0.1, -0.15]))
@settings(max_examples=60, deadline=None)
def test_the_sign_flip_test_is_exact_for_scores(scores, margin):
    differences = np.array(scores) / 10
    assert sign_flip(differences, shift=margin) == pytest.approx(enumerated(differences, margin), abs=1e-12)


@given(values=st.lists(st.floats(-1, 1), min_size=1, max_size=8))
@settings(max_examples=60, deadline=None)
def test_the_sign_flip_test_never_finds_less_than_the_exact_probability(values):
    for found, exact in zip(sign_flip(values), enumerated(values), strict=True):
        assert found >= exact - 1e-9


def test_the_sign_flip_test_of_any_differences_is_close_to_the_exact_probability():
    assert two_sided(sign_flip([0.1] * 8)) == 2 / 256
    assert two_sided(sign_flip([0.0] * 8)) == 1.0
    rng = np.random.default_rng(1)
    for _ in range(20):
        values = rng.normal(0.1, 0.2, 10)
        assert sign_flip(values) == pytest.approx(enumerated(values), abs=0.005)


def test_the_interval_of_the_mean_is_student_s_and_needs_two_participants():
    differences = [0.3, 0.1, 0.2, 0.4, 0.0, 0.2, 0.3, 0.1]
    half = 2.3646 * np.std(differences, ddof=1) / math.sqrt(8)
    assert mean_interval(differences) == pytest.approx((0.2 - half, 0.2 + half), abs=1e-4)
    assert mean_interval([0.1]) == (-math.inf, math.inf)


def test_ties_make_no_interval_narrower_than_chance():
    least = 2 * chance_variance(62, 80, 8)
    assert mean_interval([0.1] * 8) == (-math.inf, math.inf)
    for ties in ([0.1] * 8, [0.0] * 7 + [0.1]):
        low, high = mean_interval(ties, least_variance=least)
        assert high - low > 0.25
    assert chance_variance(80, 80, 8) > 0.0


def test_the_interval_of_differences_covers_the_true_one_for_scores_near_1():
    rng, covered = np.random.default_rng(4), 0
    for _ in range(300):
        right = rng.binomial(10, [[0.97], [0.87]], size=(2, 8))
        least = sum(chance_variance(int(each), 80, 8) for each in right.sum(axis=1))
        low, high = mean_interval((right[1] - right[0]) / 10, least_variance=least)
        covered += low <= -0.1 <= high
    assert covered >= 0.93 * 300


@pytest.mark.parametrize("share", [0.54, 0.775, 0.97])
def test_the_interval_of_a_share_covers_it_where_participants_differ(share):
    rng = np.random.default_rng(5)
    own = rng.normal(math.log(share / (1.0 - share)), 0.7, (300, 16))
    chances = 1.0 / (1.0 + np.exp(-own))
    inside = over_trials = 0
    for scores in rng.binomial(20, chances) / 20:
        right = round(20 * scores.sum())
        low, high = share_interval(right, 320, scores)
        inside += low <= chances.mean() <= high
        over_trials += wilson(right / 320, 320)[0] <= chances.mean() <= wilson(right / 320, 320)[1]
    assert inside >= 0.92 * 300
    assert over_trials < inside


def test_the_interval_of_a_share_is_that_over_trials_at_least_and_everything_for_one_participant():
    low, high = share_interval(62, 80, [0.775] * 8)
    assert low < wilson(62 / 80, 80)[0]
    assert high > wilson(62 / 80, 80)[1]
    assert share_interval(80, 80, [1.0] * 8)[1] == 1.0
    assert share_interval(8, 10, [0.8]) == share_interval(0, 0, []) == (0.0, 1.0)


def test_equivalence_needs_every_participant_near_zero():
    near, far = [0.0, 0.1, -0.1, 0.0, 0.05, -0.05, 0.0, 0.1, -0.1, 0.0], [-0.3, 0.1, -0.2, 0.0, -0.4, 0.2, -0.1, 0.0]
    assert equivalence(near, 0.15)[0] < 0.05
    assert equivalence(far, 0.15)[0] > 0.05
    low, high = equivalence(near, 0.15)[1]
    assert -0.15 < low < high < 0.15


def test_equivalence_is_shown_only_if_the_interval_agrees_with_the_tests():
    ties = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # of eight people with ten trials, mostly right
    least = chance_variance(65, 80, 8) + chance_variance(66, 80, 8)
    within, _, shown = equivalence(ties, 0.1, least_variance=least)
    assert within < 0.05
    assert not shown
    assert equivalence(ties, 0.1)[2]


def test_holm_multiplies_the_smallest_most():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
