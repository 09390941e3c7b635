"""Codecs that extrapolate: the deadband law for every input, and what holds at impacts, after losses, over any time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.linear_predictive import (
    LinearPredictive,
    Sender,
    is_silent,
    least_squares_slope,
    line_at,
    line_from,
)
from hapticnet.codec.steps import Past
from hapticnet.codec.streams import table_of_rows
from hapticnet.perception import WeberLaw
from hapticnet_literature.least_squares import LeastSquares

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
BOTH = [LinearPredictive(law=LAW), LeastSquares(law=LAW), LinearPredictive(law=LAW, step_n=0.001)]


@pytest.mark.parametrize("codec", BOTH)
def test_a_ramp_of_any_slope_is_a_few_updates_where_a_deadband_sends_hundreds(codec):
    times_us = np.arange(2000) * 1000
    for slope_n_per_s in (1e-9, 1e-3, 0.5, 10.0):
        sent = encode_array(codec, times_us, slope_n_per_s * times_us[:, np.newaxis] * 1e-6).sent
        assert len(sent) <= 2000 / codec.horizon_ms + 25


@pytest.mark.parametrize("codec", BOTH)
@pytest.mark.parametrize("jump_n", [0.03, 1.0, 5.0, -5.0, 1e5])
def test_an_impact_is_overshot_by_no_more_than_the_threshold_and_is_soon_over(codec, jump_n):
    stimuli = np.where(np.arange(400) < 200, 0.0, jump_n)[:, np.newaxis]
    encoding = encode_array(codec, np.arange(400) * 1000, stimuli)
    over = np.abs(encoding.decoded - stimuli)
    assert over.max() <= codec.law.threshold_n(np.abs(encoding.decoded).max())
    after = encoding.sent[encoding.sent >= 200]
    assert after[0] == 200
    assert len(after) <= 8


@pytest.mark.parametrize("codec", BOTH)
def test_a_spike_of_one_sample_leaves_nothing_behind(codec):
    stimuli = np.ones((1000, 2))
    stimuli[100] = 1e15
    encoding = encode_array(codec, np.arange(1000) * 1000, stimuli)
    assert encoding.sent[-1] < 110
    assert np.abs(encoding.decoded[200:] - 1.0).max() <= codec.law.threshold_n(2.0)


@pytest.mark.parametrize("codec", BOTH)
def test_the_line_ends_at_the_horizon_when_nothing_more_arrives(codec):
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for t_us in range(0, 100_000, 1000):
        payload = encoder.encode(t_us, (0.5 + 2e-6 * t_us,))
        if payload is not None:
            decoder.decode(t_us, payload)
            last_us = t_us
    at_horizon = decoder.reconstruct(last_us + round(codec.horizon_ms * 1000))
    assert at_horizon == decoder.reconstruct(last_us + 3_600_000_000) == decoder.reconstruct(10**18)
    assert abs(at_horizon[0]) < 2.0


def test_the_slope_sent_is_that_of_the_newest_samples_sent_or_not():
    encoder = LinearPredictive(law=LAW).encoder(1)
    forces = (1.0, 1.01, 1.0, 1.02, 1.03, 1.1)
    made = [encoder.encode(1000 * index, (force_n,)) for index, force_n in enumerate(forces)]
    assert [payload is not None for payload in made] == [True, False, False, False, False, True]
    (_, slope) = np.frombuffer(made[-1], dtype=">f4").tolist()
    assert slope == pytest.approx(np.polyfit(np.arange(5) * 1e-3, forces[1:], 1)[0], rel=1e-6)


def test_slopes_in_counts_are_limited_not_wrapped():
    codec = LinearPredictive(law=LAW, step_n=0.001)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for index, force_n in enumerate((20.0, 22.9, 25.9, 29.0)):  # 3000 N/s; 327.67 N/s is the steepest
        payload = encoder.encode(1000 * index, (force_n,))
        assert payload is not None
        assert len(payload) == 4
        decoder.decode(1000 * index, payload)
    (rise,) = decoder.reconstruct(4000)
    assert rise - 29.0 == pytest.approx(0.32767)


def slope_of(times_us, values) -> tuple[float, ...]:
    return least_squares_slope(Past(times_us, values, 0, len(values) - 1), 0, values[-1])


@pytest.mark.plain
@given(
    st.lists(st.tuples(st.integers(-(10**15), 10**15), st.floats(-1e15, 1e15)), min_size=1, max_size=9),
    st.integers(-(10**17), 10**17),
)
def test_the_slope_is_finite_for_all_times_and_depends_on_their_differences_only(samples, shift_us):
    times_us, values = [t_us for t_us, _ in samples], [(x,) for _, x in samples]
    (slope,) = slope_of(times_us, values)
    assert abs(slope) <= 1e15
    assert slope_of([t_us + shift_us for t_us in times_us], values) == (slope,)
    if len(set(times_us)) == 1:
        assert slope == 0.0


@given(st.floats(-1e15, 1e15), st.floats(-1e15, 1e15), st.integers(-(10**18), 10**18))
def test_a_line_stays_in_range(value, slope, at_us):
    rule = LinearPredictive(law=LAW, horizon_ms=10_000.0).rule(1, table_of_rows)
    sender = Sender(True, line_from(rule, 0, (value,), (slope,)))
    (point,) = line_at(rule, sender.line, at_us)
    assert abs(point) <= 1e15
    assert is_silent(rule, sender, at_us, (point,))
    assert not is_silent(rule, sender, at_us, (point + 1.01 * LAW.threshold_n(abs(point)),))
    assert not is_silent(rule, sender, at_us, (math.nan,))
