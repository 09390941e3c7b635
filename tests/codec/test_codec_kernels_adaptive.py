"""What is compiled of the adaptive-predictive deadband is what streams, to the bit."""

import math

import numpy as np
import pytest
from codec_cases import anything, assert_same, haptic, laws, only_compiled, steps
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec import adaptive_predictive
from hapticnet.codec.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

SAMPLES = 300

codecs = st.builds(
    AdaptivePredictive,
    law=st.one_of(laws, st.sampled_from([WeberLaw(weber_fraction=0.0, floor_n=0.02), WeberLaw(floor_n=0.0)])),
    horizon_ms=st.one_of(st.just(200.0), st.floats(1.0, 10_000.0)),
    window_ms=st.one_of(st.sampled_from([2.0, 20.0]), st.floats(1.0, 1000.0)),
    jump_thresholds=st.one_of(st.just(0.0), st.floats(0.1, 10.0)),
    step_n=steps,
)
forces = npst.arrays(np.float64, st.tuples(st.integers(0, 60), st.just(1)), elements=st.one_of(haptic, anything))
gaps = st.lists(
    st.one_of(st.just(1000), st.just(0), st.integers(-10_000, 30_000), st.integers(-(2**60), 2**60)), min_size=60
)


@st.composite
def movements(draw):
    """Return times, most often those of a loop, and a force of one kind or several at once, at any scale."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shortest_us, longest_us = draw(st.sampled_from([(1000, 1000), (1000, 1000), (0, 2000), (-1000, 3000), (0, 40_000)]))
    t_us = np.cumsum(rng.integers(shortest_us, longest_us, SAMPLES, endpoint=True))
    kinds = {
        "walk": np.cumsum(rng.normal(0.0, 0.05, SAMPLES)),
        "noise": rng.normal(0.0, 0.05, SAMPLES),
        "steps": np.cumsum(np.where(rng.random(SAMPLES) < 0.03, rng.normal(size=SAMPLES), 0.0)),
        "coarse": rng.integers(-1, 2, SAMPLES).astype(float),
        "smooth": np.sin(1e-5 * t_us),
        "ramp": 2e-6 * t_us,
    }
    chosen = draw(st.lists(st.sampled_from(list(kinds)), min_size=1, max_size=3, unique=True))
    scale = draw(st.sampled_from([1.0, 1.0, 0.01, 1e-100, 1e-160, 1e-310, 1e6, 5e14]))
    stimuli = scale * (draw(st.sampled_from([0.0, 2.0, 1e6])) + sum(kinds[kind] for kind in chosen))
    return t_us, np.clip(stimuli, -LARGEST_COMPONENT, LARGEST_COMPONENT)[:, np.newaxis]


@pytest.fixture(autouse=True, scope="module")
def _compiled():
    with only_compiled(adaptive_predictive):
        yield


def assert_streams_alike(codec, t_us, stimuli):
    assert_same(encode_streamed(codec, t_us, stimuli), codec.encode_array(t_us, stimuli))


@given(codecs, movements())
def test_it_agrees_with_its_stream_on_every_kind_of_movement(codec, movement):
    assert_streams_alike(codec, *movement)


@given(codecs, forces, gaps)
@example(AdaptivePredictive(), np.ones((3, 1)), [-(2**62), 2**62, 2**62])  # too far apart for 64 bits
@example(AdaptivePredictive(), np.full((3, 1), -1e-60), [0] * 3)  # less than a float32 can hold
@example(AdaptivePredictive(), np.array([[1e15], [1e15], [-1e15], [1e15]]), [1000] * 4)
def test_it_agrees_with_its_stream_on_any_force_at_any_time(codec, stimuli, gaps):
    assert_streams_alike(codec, np.cumsum(np.array(gaps, dtype=np.int64))[: len(stimuli)], stimuli)


@pytest.mark.parametrize("law", [WeberLaw(), WeberLaw(multiplier=0.0), WeberLaw(weber_fraction=0.0, floor_n=1e-12)])
@pytest.mark.parametrize("parameters", [{}, {"jump_thresholds": 0.5, "step_n": 0.001}, {"window_ms": 1000.0}])
def test_it_agrees_with_its_stream_over_a_long_walk_with_impacts(law, parameters):
    rng = np.random.default_rng(1)
    moves = rng.normal(0.0, 0.05, (5000, 1))
    moves[rng.random(5000) < 0.001] *= 1e6
    assert_streams_alike(
        AdaptivePredictive(law=law, **parameters), np.cumsum(rng.integers(0, 2000, 5000)), np.cumsum(moves, axis=0)
    )


def test_it_agrees_where_curves_would_start_out_of_range():
    noise = 0.02 * np.random.default_rng(2).normal(size=(SAMPLES, 1))
    codec = AdaptivePredictive(law=WeberLaw(weber_fraction=0.01))
    assert_streams_alike(codec, 1000 * np.arange(SAMPLES), LARGEST_COMPONENT * np.minimum(1.0 + noise, 1.0))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, 1.2e15])
def test_what_is_not_finite_or_out_of_range_is_refused(bad):
    stimuli = np.full((9, 1), 2.0)
    stimuli[7] = bad
    for encode in (AdaptivePredictive.encode_array, encode_streamed):
        with pytest.raises(SampleError, match=r"sample 7.*finite and within"):
            encode(AdaptivePredictive(), 1000 * np.arange(9), stimuli)


def test_a_recording_with_too_few_times_is_refused(monkeypatch):
    monkeypatch.setattr(adaptive_predictive, "encode_streamed", encode_streamed)
    for encode in (AdaptivePredictive.encode_array, encode_streamed):
        with pytest.raises(ValueError, match="shorter"):
            encode(AdaptivePredictive(), 1000 * np.arange(8), np.ones((9, 1)))
