"""What is compiled for receivers that hold is what streams, to the bit, whatever time and hand do."""

import math
import sys

import numpy as np
import pytest
from codec_cases import anything, assert_same, haptic, laws, only_compiled, steps
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec import merging, passive, probabilistic, velocity_adaptive
from hapticnet.codec.merging import Merging
from hapticnet.codec.passive import PassiveExtrapolative, PassiveInterpolative
from hapticnet.codec.probabilistic import Probabilistic
from hapticnet.codec.recording import encode_streamed
from hapticnet.codec.velocity_adaptive import VelocityAdaptive
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw

CODECS = [Merging, Probabilistic, VelocityAdaptive, PassiveExtrapolative, PassiveInterpolative]
LONGEST = 60

codecs = st.one_of(
    st.builds(Merging, law=laws, window_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e4)), step_n=steps),
    st.builds(
        Probabilistic,
        law=laws,
        loss_probability=st.floats(0.0, 0.9),
        deviation_limit=st.one_of(st.just(0.001), st.floats(0.001, 1.0)),
        step_n=steps,
    ),
    st.builds(
        VelocityAdaptive,
        law=laws,
        speed_gain_s_m=st.one_of(st.floats(0.0, 1.0), st.floats(0.0, 1e3)),
        largest_fraction=st.floats(0.0, 1.0),
        time_constant_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e4)),
        step_n=steps,
    ),
    st.builds(PassiveExtrapolative, law=laws, step_n=steps),
    st.builds(PassiveInterpolative, law=laws, interval_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e3)), step_n=steps),
)
# A few values again and again, so that forces come back to what was sent, and hands rest.
forces = st.one_of(haptic, anything, st.sampled_from([0.0, -0.0, 1.0, 1.04, 1.06, 1.12, 1e15, 1e-300, -1e-12]))
places = st.one_of(st.floats(-0.1, 0.1), anything, st.sampled_from([0.0, -0.0, 0.01, 5e-324, 1e-160]))
millisecond = st.just(1000)
any_time = st.one_of(st.integers(-(2**63), 2**63 - 1), st.sampled_from([-(2**63), 1 - 2**63, 2**63 - 1]))


@st.composite
def moving(draw):
    """Return times, a recording, and positions or none: at a steady rate, with repeats and gaps, or any at all."""
    samples = draw(st.integers(0, LONGEST))
    lists = {"min_size": samples, "max_size": samples}
    gaps = st.one_of(millisecond, st.just(0), st.integers(-3000, 30_000), st.integers(0, 2**50))
    walks = st.one_of(st.lists(millisecond, **lists), st.lists(gaps, **lists)).map(np.cumsum)
    t_us = draw(st.one_of(walks, st.lists(any_time, **lists)))
    stimuli = draw(npst.arrays(np.float64, (samples, 1), elements=forces))
    positions = draw(st.one_of(st.none(), npst.arrays(np.float64, (samples, 1), elements=places)))
    return np.array(t_us, dtype=np.int64), stimuli, positions


@pytest.fixture(autouse=True, scope="module")
def _compiled():
    with only_compiled(merging, probabilistic, velocity_adaptive, passive):
        yield


def assert_streams_alike(codec, t_us, stimuli, positions):
    assert_same(encode_streamed(codec, t_us, stimuli, positions), codec.encode_array(t_us, stimuli, positions))


def walk(samples, seed=1):
    """Return times that go back at times, forces with impacts, and positions with rests of a long recording."""
    rng = np.random.default_rng(seed)
    moves = rng.normal(0.0, 0.05, (samples, 1))
    moves[rng.random(samples) < 0.001] *= 1e6
    speeds = rng.normal(0.0, 1e-4, (samples, 1)) * (rng.random((samples, 1)) < 0.8)
    return np.cumsum(rng.integers(-500, 2000, samples)), np.cumsum(moves, axis=0), np.cumsum(speeds, axis=0)


@given(codecs, moving())
@settings(deadline=None, max_examples=400)
def test_compiled_holds_agree_with_their_streams_on_any_force_at_any_time_anywhere(codec, recording):
    assert_streams_alike(codec, *recording)


@pytest.mark.parametrize("law", [WeberLaw(), WeberLaw(multiplier=0.0), WeberLaw(weber_fraction=0.0, floor_n=1e-12)])
@pytest.mark.parametrize("step_n", [0.0, 0.001])
@pytest.mark.parametrize("codec", CODECS)
def test_compiled_holds_agree_with_their_streams_over_a_long_walk_with_impacts(codec, step_n, law):
    assert_streams_alike(codec(law=law, step_n=step_n), *walk(20_000))


@pytest.mark.parametrize("scale", [1e-300, 1e-12, 1e12])
@pytest.mark.parametrize("codec", CODECS)
def test_compiled_holds_agree_with_their_streams_at_extreme_scales(codec, scale):
    t_us, stimuli, positions = walk(5000)
    stimuli = stimuli / np.abs(stimuli).max() * scale
    assert_streams_alike(codec(law=WeberLaw(floor_n=0.0)), t_us, stimuli, positions / np.abs(positions).max() * scale)


@pytest.mark.parametrize("codec", CODECS)
def test_compiled_holds_agree_with_their_streams_across_all_the_time_there_is(codec):
    t_us = np.array([-(2**63), *(2**63 - 1 - np.arange(6, dtype=np.int64)[::-1] * 1000)])
    stimuli, positions = np.array([[1.0, 2.0, 2.01, 2.02, 2.2, 2.2, 2.2]]).T, np.arange(7.0)[:, np.newaxis]
    assert_streams_alike(codec(), t_us, stimuli, positions)


@pytest.mark.parametrize("codec", CODECS)
def test_compiled_holds_keep_the_sign_of_zero_before_any_motion(codec):
    assert_streams_alike(codec(), np.arange(3), np.full((3, 1), -0.0), np.array([[1.0], [1.0], [2.0]]))


@given(st.floats(0.0, 0.9), st.floats(0.001, 1.0))
@settings(deadline=None)
def test_compiled_updates_are_said_again_as_often_as_streamed_ones(loss, limit):
    t_us, stimuli, _ = walk(500)
    assert_streams_alike(Probabilistic(loss_probability=loss, deviation_limit=limit), t_us, stimuli, None)


@pytest.mark.parametrize("bad", [math.nan, -math.inf, 1.1e15])
@pytest.mark.parametrize("codec", CODECS)
def test_compiled_holds_refuse_a_stimulus_out_of_range_wherever_it_is(codec, bad):
    t_us, stimuli, positions = walk(1000)
    for sample in (0, 1, 7, 999):
        spoilt = stimuli.copy()
        spoilt[sample] = bad
        with pytest.raises(SampleError, match=rf"^sample {sample}: stimulus is .* finite and within"):
            codec().encode_array(t_us, spoilt, positions)


def test_compiled_merging_refuses_a_stimulus_out_of_range_within_a_window_though_near_the_one_held():
    stimuli, just_beyond = np.full(3, 1e15), np.nextafter(1e15, math.inf)
    stimuli[1] = just_beyond
    with pytest.raises(SampleError, match="sample 1"):
        Merging().encode_array(np.array([0, 1000, 2000]), stimuli)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e300])
@pytest.mark.parametrize("sample", [0, 7, 999])
def test_compiled_velocity_refuses_a_position_out_of_range_in_the_words_of_the_stream(sample, bad):
    t_us, stimuli, positions = walk(1000)
    positions[sample] = bad
    stimuli[sample] = math.nan
    messages = []
    for encode in (lambda *recording: encode_streamed(VelocityAdaptive(), *recording), VelocityAdaptive().encode_array):
        with pytest.raises(SampleError, match=f"sample {sample}: position is") as refusal:
            encode(t_us, stimuli, positions)
        messages.append(str(refusal.value))
    assert messages[0] == messages[1]


@pytest.mark.parametrize("codec", [PassiveExtrapolative, PassiveInterpolative])
def test_compiled_passive_codecs_take_a_lost_position_as_their_streams_do(codec):
    t_us, stimuli, positions = walk(1000)
    positions[[0, 3, 4, 500]] = math.nan
    assert_streams_alike(codec(), t_us, stimuli, positions)


@pytest.mark.parametrize("codec", [Merging, Probabilistic, VelocityAdaptive, PassiveInterpolative])
def test_a_recording_whose_times_are_not_as_many_is_refused_as_its_stream_does(codec, monkeypatch):
    monkeypatch.setattr(sys.modules[codec.__module__], "encode_streamed", encode_streamed)
    t_us, stimuli, positions = walk(10)
    with pytest.raises(ValueError, match="zip"):
        codec().encode_array(t_us[:-1], stimuli, positions)
