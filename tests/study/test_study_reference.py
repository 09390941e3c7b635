"""Statistics beside those of scipy, which hapticnet does not need for them."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import isotonic_regression

from hapticnet.study.statistics import falling, sign_flip, two_sided, wilson


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (1, 7), (43, 80), (80, 80)])
def test_wilson_is_that_of_scipy(successes, trials):
    expected = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson(successes / trials, trials) == pytest.approx(tuple(expected), abs=1e-12)


def test_the_sign_flip_test_is_scipy_s_exact_permutation_test():
    rng = np.random.default_rng(2)
    for _ in range(10):
        differences = rng.integers(-10, 11, 8) / 10
        expected = stats.permutation_test(
            (differences,), np.mean, permutation_type="samples", vectorized=True, n_resamples=np.inf
        )
        assert two_sided(sign_flip(differences)) == pytest.approx(min(expected.pvalue, 1.0))


def test_the_falling_curve_is_scipy_s_isotonic_regression():
    rng = np.random.default_rng(4)
    for _ in range(20):
        means = rng.uniform(size=7)
        assert falling(means) == pytest.approx(isotonic_regression(means, increasing=False).x)
