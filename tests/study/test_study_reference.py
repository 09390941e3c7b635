"""Statistics beside those of scipy and statsmodels, which hapticnet does not need for them."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import isotonic_regression
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from hapticnet.study.analysis import analyse
from hapticnet.study.models import fit_models
from hapticnet.study.statistics import falling, holm, kendall_distance, sign_flip, two_sided, wilson
from tests.study.made import rows

NAMES = ["none", "1 JND", "2 JND", "4 JND"]


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (1, 7), (43, 80), (80, 80)])
def test_wilson_is_that_of_statsmodels(successes, trials):
    expected = proportion_confint(successes, trials, method="wilson")
    assert wilson(successes, trials) == pytest.approx(expected, abs=1e-12)


def test_holm_is_that_of_statsmodels():
    rng = np.random.default_rng(1)
    for size in (1, 3, 8):
        probabilities = rng.uniform(0.0, 0.2, size)
        expected = multipletests(probabilities, method="holm")[1]
        assert holm(probabilities.tolist()) == pytest.approx(expected.tolist())


def test_the_sign_flip_test_is_scipy_s_exact_permutation_test():
    rng = np.random.default_rng(2)
    for _ in range(10):
        differences = rng.integers(-10, 11, 8) / 10
        expected = stats.permutation_test(
            (differences,), np.mean, permutation_type="samples", vectorized=True, n_resamples=np.inf
        )
        assert two_sided(sign_flip(differences)) == pytest.approx(min(expected.pvalue, 1.0))


def test_kendall_s_distance_is_that_of_scipy_s_tau():
    rng = np.random.default_rng(3)
    for _ in range(20):
        order, other = rng.permutation(6), rng.permutation(6)
        tau = stats.kendalltau(np.argsort(order), np.argsort(other)).statistic
        assert kendall_distance(order.tolist(), other.tolist()) == pytest.approx(15 * (1.0 - tau) / 2.0)


def test_the_falling_curve_is_scipy_s_isotonic_regression():
    rng = np.random.default_rng(4)
    for _ in range(20):
        means = rng.uniform(size=7)
        assert falling(means) == pytest.approx(isotonic_regression(means, increasing=False).x)


def test_the_log_odds_of_the_gee_are_those_of_the_totals():
    # With as many trials of each person in each condition, the estimates of the GEE are those of the pooled table.
    made = [row for row in rows(people=9) if row.event == "trial"]
    share = {each.name: each.share for each in analyse(made).conditions}
    odds = {name: np.log(value / (1.0 - value)) for name, value in share.items()}
    found = {each.condition: each for each in fit_models(made, NAMES) if each.model == "GEE"}
    for name in NAMES[1:]:
        assert found[name].log_odds == pytest.approx(odds[name] - odds["none"], abs=1e-3)
        assert found[name].low < found[name].log_odds < found[name].high


def test_intervals_and_probabilities_of_the_gee_are_student_s_over_participants():
    made = [row for row in rows(people=8) if row.event == "trial"]
    for effect in fit_models(made, NAMES):
        if effect.model == "GEE":
            error = abs(effect.log_odds) / stats.t.isf(effect.probability / 2.0, 7)
            assert (effect.high - effect.low) / 2.0 == pytest.approx(stats.t.ppf(0.975, 7) * error, rel=1e-6)
