import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.schemes.trend import LEAD, NOTHING_LEARNED, Trend, measured_trend, predicted_travel, updated
from hapticnet.codec.steps import Past


def samples(values, period_us=1000):
    return [(period_us * index, (value,)) for index, value in enumerate(values)]


def trend_of(given, band_n, window_us):
    """Return both slopes [N/µs] and the level [N]."""
    times_us, values = zip(*given, strict=True)
    return measured_trend(Past(times_us, values, 0, len(values) - 1), values[-1], 1.0, window_us, band_n)


@given(st.floats(-10, 10), st.floats(-1e-3, 1e-3), st.integers(3, 30))
def test_on_a_line_both_slopes_are_its_own_and_the_level_is_the_newest_sample(start, slope, count):
    values = [start + slope * 1000 * index for index in range(count)]
    (short,), (long,), (level,) = trend_of(samples(values), band_n=1.0, window_us=20_000.0)
    assert short == pytest.approx(slope, abs=1e-9)
    assert long == pytest.approx(slope, abs=1e-9)
    assert level == pytest.approx(0.0, abs=1e-9)


def learned(rng, truth, noise, rounds=300):
    trust = NOTHING_LEARNED
    for _ in range(rounds):
        causes = Trend(*[(each,) for each in rng.normal(0.0, 2.0, 3).tolist()])
        moved = sum(weight * each for weight, (each,) in zip(truth, causes, strict=True)) + noise * rng.normal()
        trust = updated(trust, causes, (moved,), 1.0, 1.0)
    return trust


@pytest.mark.parametrize("truth", [(1.0, 0.0, 0.0), (0.2, 0.7, 0.5), (0.0, 0.0, 1.0), (1.4, -0.6, -0.3)])
def test_trust_becomes_what_has_been_true(truth):
    assert learned(np.random.default_rng(1), truth, 0.1).coefficients == pytest.approx(truth, abs=0.1)


@pytest.mark.parametrize("travel", [0.1, 1.0, 10.0, 1000.0])
@pytest.mark.parametrize("along", [(1.0,), (0.6, -0.8)])
def test_a_curve_gets_ahead_of_a_steady_slope_by_no_more_than_its_lead(travel, along):
    threshold_n = 0.05
    trust = learned(np.random.default_rng(3), (3.0, 3.0, 0.0), 0.1)
    slope = tuple(travel * threshold_n * each for each in along)
    curve = predicted_travel(trust, Trend(slope, slope, (0.0,) * len(along)), threshold_n)
    made = np.dot(curve, along) / threshold_n
    s = np.linspace(0.0, 1.0, 10_001)
    ahead = np.max(made * s * (2.0 - s) - 2.0 * travel * s)
    assert ahead == pytest.approx(LEAD**2 / (1.0 + LEAD / math.sqrt(travel)), rel=1e-3)
    assert ahead < LEAD**2


wild = st.tuples(*[st.floats(-1e15, 1e15)] * 3).map(lambda each: tuple((x,) for x in each))


@given(
    st.lists(st.tuples(wild, st.floats(-1e15, 1e15), st.floats(0, 1), st.sampled_from([0.0, 5e-324, 1e-9, 1, 1e15])))
)
def test_trust_is_finite_whatever_it_is_told(rounds):
    trust = NOTHING_LEARNED
    for causes, moved, share, threshold in rounds:
        trust = updated(trust, Trend(*causes), (moved,), share, float(threshold))
        assert all(abs(each) < 1e10 for each in trust.coefficients)
