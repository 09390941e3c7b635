import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.trend import BELIEVED, LARGEST_TRUST, Trust, trend


def samples(values, period_us=1000):
    return [(period_us * index, (value,)) for index, value in enumerate(values)]


@given(st.floats(-10, 10), st.floats(-1e-3, 1e-3), st.integers(3, 30))
def test_on_a_line_both_slopes_are_its_own_and_the_level_is_the_newest_sample(start, slope, count):
    values = [start + slope * 1000 * index for index in range(count)]
    (short,), (long,), (level,) = trend(samples(values), band_n=1.0, window_us=20_000.0)
    assert short == pytest.approx(slope, abs=1e-9)
    assert long == pytest.approx(slope, abs=1e-9)
    assert level == pytest.approx(0.0, abs=1e-9)


def test_the_level_of_noise_is_near_its_mean_wherever_the_newest_sample_is():
    values = [1.0, 1.1] * 10 + [1.5]
    (level,) = trend(samples(values), band_n=1e9, window_us=20_000.0)[2]
    assert 1.0 < 1.5 + level < 1.3


@pytest.mark.parametrize("values", [[1.0], [1.0, 2.0], [0.0] * 20 + [5.0, 5.1]])
def test_fewer_than_three_samples_since_an_impact_say_nothing(values):
    assert trend(samples(values), band_n=0.1, window_us=20_000.0) == ((0.0,), (0.0,), (0.0,))


def test_samples_of_the_same_time_or_too_old_say_nothing():
    for period_us in (0, 20_000, -1000):
        assert trend(samples([1.0, 2.0, 3.0], period_us), band_n=9.0, window_us=20_000.0) == ((0.0,), (0.0,), (0.0,))


def test_axes_are_independent():
    both = [(1000 * index, (float(index), -3.0)) for index in range(10)]
    short, long, level = trend(both, band_n=1.0, window_us=20_000.0)
    assert short == pytest.approx((0.001, 0.0))
    assert long == pytest.approx((0.001, 0.0))
    assert level == pytest.approx((0.0, 0.0))


def learned(rng, truth, noise, rounds=300):
    trust = Trust()
    for _ in range(rounds):
        causes = tuple((each,) for each in rng.normal(0.0, 2.0, 3).tolist())
        moved = sum(weight * each for weight, (each,) in zip(truth, causes, strict=True)) + noise * rng.normal()
        trust.learn(causes, (moved,), 1.0, 1.0)
    return trust


def trusted(trust):
    slopes = [trust.foretell(unit)[0][0] for unit in (((1.0,), (0.0,), (0.0,)), ((0.0,), (1.0,), (0.0,)))]
    return (*slopes, trust.foretell(((0.0,), (0.0,), (1.0,)))[1][0])


@pytest.mark.parametrize("truth", [(1.0, 0.0, 0.0), (0.2, 0.7, 0.5), (0.0, 0.0, 1.0), (1.4, -0.6, -0.3)])
def test_trust_becomes_what_has_been_true(truth):
    assert trusted(learned(np.random.default_rng(1), truth, 0.1)) == pytest.approx(truth, abs=0.1)


def test_trust_in_slopes_stays_between_nothing_and_its_limit():
    for truth, sum_ in (((3.0, 3.0, 0.0), LARGEST_TRUST), ((-1.0, -1.0, 0.0), 0.0)):
        short, long, _ = trusted(learned(np.random.default_rng(2), truth, 0.1))
        assert short + long == pytest.approx(sum_)


wild = st.tuples(*[st.floats(-1e15, 1e15)] * 3).map(lambda each: tuple((x,) for x in each))


@given(
    st.lists(st.tuples(wild, st.floats(-1e15, 1e15), st.floats(0, 1), st.sampled_from([0.0, 5e-324, 1e-9, 1, 1e15])))
)
def test_trust_is_finite_whatever_it_is_told(rounds):
    trust = Trust()
    for causes, moved, share, threshold in rounds:
        trust.learn(causes, (moved,), share, float(threshold))
        assert all(abs(each) < 1e10 for each in trusted(trust))


def test_before_anything_is_learned_the_slopes_are_believed_in_equal_shares():
    assert trusted(Trust()) == BELIEVED
