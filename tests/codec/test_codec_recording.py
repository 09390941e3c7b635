"""Whole recordings: compiled steps give what the stream gives, to the bit, and refuse what it refuses."""

import itertools

import numpy as np
import pytest
from codec_cases import anything, assert_same, assert_within_threshold, haptic, laws, steps, stream
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec import recording
from hapticnet.codec.recording import encode_array, encode_streamed
from hapticnet.codec.registry import every_codec
from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.schemes.linear_predictive import LinearPredictive
from hapticnet.codec.schemes.motion_predictive import MotionPredictive
from hapticnet.codec.schemes.raw import Raw
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet_literature.least_squares import LeastSquares
from hapticnet_literature.level_crossing import LevelCrossing
from hapticnet_literature.merging import Merging
from hapticnet_literature.model_mediated import ModelMediated
from hapticnet_literature.passive import PassiveExtrapolative, PassiveInterpolative
from hapticnet_literature.probabilistic import Probabilistic
from hapticnet_literature.velocity_adaptive import VelocityAdaptive

CODECS = every_codec()

ms = st.floats(1.0, 1000.0)
made = {
    Raw: st.builds(Raw, step_n=steps),
    Deadband: st.builds(Deadband, law=laws, step_n=steps),
    AdaptivePredictive: st.builds(
        AdaptivePredictive,
        law=laws,
        horizon_ms=ms,
        window_ms=ms,
        jump_thresholds=st.one_of(st.just(0.0), st.floats(0.1, 10.0)),
        step_n=steps,
    ),
    MotionPredictive: st.builds(
        MotionPredictive, law=laws, horizon_ms=ms, window_ms=ms, stiffest_n_per_m=st.floats(1.0, 6e4)
    ),
    LinearPredictive: st.builds(
        LinearPredictive, law=laws, slope_samples=st.integers(2, 64), horizon_ms=ms, step_n=steps
    ),
    LeastSquares: st.builds(
        LeastSquares,
        law=laws,
        updates=st.integers(2, 16),
        horizon_ms=ms,
        step_fraction=st.one_of(st.just(0.5), st.floats(0.01, 1.0)),
        absolute_every=st.integers(1, 127),
        step_n=steps,
    ),
    LevelCrossing: st.builds(LevelCrossing, law=laws, hysteresis=st.floats(0.0, 0.5)),
    Merging: st.builds(Merging, law=laws, window_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e4)), step_n=steps),
    ModelMediated: st.builds(
        ModelMediated,
        law=laws,
        gain=st.floats(0.0, 1e4),
        first_n_per_m=st.floats(1.0, 1e6),
        deadband=st.floats(0.0, 1.0),
        blend_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e4)),
    ),
    Probabilistic: st.builds(
        Probabilistic,
        law=laws,
        loss_probability=st.floats(0.0, 0.9),
        deviation_limit=st.one_of(st.just(0.001), st.floats(0.001, 1.0)),
        step_n=steps,
    ),
    VelocityAdaptive: st.builds(
        VelocityAdaptive,
        law=laws,
        speed_gain_s_m=st.one_of(st.floats(0.0, 1.0), st.floats(0.0, 1e3)),
        largest_fraction=st.floats(0.0, 1.0),
        time_constant_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e4)),
        step_n=steps,
    ),
    PassiveExtrapolative: st.builds(PassiveExtrapolative, law=laws, step_n=steps),
    PassiveInterpolative: st.builds(
        PassiveInterpolative, law=laws, interval_ms=st.one_of(st.just(0.0), st.floats(0.0, 1e3)), step_n=steps
    ),
}
# A few values again and again, so that forces return to what was sent, and hands rest.
forces = st.one_of(haptic, anything, st.sampled_from([0.0, -0.0, 1.0, 1.04, 1.06, 1.12, 1e15, 1e-300, -1e-12]))
places = st.one_of(st.floats(-0.1, 0.1), anything, st.sampled_from([0.0, -0.0, 0.01, 5e-324, 1e-160]))
any_time = st.one_of(st.integers(-(2**50), 2**50), st.sampled_from([-(2**61), 0, 2**61]))


@pytest.fixture
def compiled(tool_is_missing):
    """Compile recordings of any length."""
    if not recording.fast_extra_installed():
        tool_is_missing("numba")

    def stream_instead(*_):
        raise AssertionError("streamed, not compiled")

    def encode(*arguments):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(recording, "COMPILE_ABOVE_SAMPLES", -1)
            patch.setattr(recording, "encode_streamed", stream_instead)
            return encode_array(*arguments)

    return encode


@st.composite
def moving(draw, axes):
    """Return times, a recording, and positions or None: at a steady rate, with repeats and gaps, or any at all."""
    samples = draw(st.integers(0, 50))
    lists = {"min_size": samples, "max_size": samples}
    gaps = st.one_of(st.just(1000), st.just(0), st.integers(-3000, 30_000), st.integers(0, 2**40))
    walks = st.one_of(st.lists(st.just(1000), **lists), st.lists(gaps, **lists)).map(np.cumsum)
    t_us = draw(st.one_of(walks, st.lists(any_time, **lists)))
    stimuli = draw(npst.arrays(np.float64, (samples, axes), elements=forces))
    if draw(st.booleans()):  # so that lines and curves hold for a while, with a jump now and then
        stimuli = np.cumsum(0.01 * np.clip(stimuli, -20.0, 20.0), axis=0)
        stimuli[samples // 2 :] += draw(st.sampled_from([0.0, 3.0, -1e5]))
    positions = draw(st.one_of(st.none(), npst.arrays(np.float64, (samples, axes), elements=places)))
    return np.array(t_us, dtype=np.int64), stimuli, positions


def test_every_registered_codec_is_tried():
    assert {codec.name for codec in made} == set(CODECS)


def column(*forces_n):
    return 1000 * np.arange(len(forces_n)), np.array(forces_n)[:, np.newaxis], None


@pytest.mark.parametrize("codec", [codec for codec in made if codec not in (Raw, Merging, ModelMediated)])
def test_the_applied_force_is_within_the_threshold_at_every_sample_whatever_the_clocks(codec):
    @settings(max_examples=60)
    @given(codec=made[codec], given=st.integers(1, 3).flatmap(moving))
    @example(codec(), (np.arange(4), np.array([[1e15], [1e15], [-1e15], [1e15]]), np.full((4, 1), -1e15)))
    @example(codec(law=WeberLaw(floor_n=0)), column(1e-310, 5e-324, 0.0, 1e-310, -1e15))
    @example(codec(), column(0.1, 0.1 + 1e-17, 0.025, 0.0250000001, -0.025, 1.0, 1.0255, 1.06, 1e15))
    @example(codec(law=WeberLaw(weber_fraction=0.25, floor_n=0.0, multiplier=2.0)), column(0.0, 9e14, 0.0, 5e-278))
    def check(codec, given):
        t_us, stimuli, positions = given
        encoding = encode_array(codec, t_us, stimuli)
        assert_within_threshold(codec.law, stimuli, encoding.decoded)
        assert np.abs(encoding.decoded).max(initial=0.0) <= 1e15
        assert_same(encoding, stream(codec, stimuli, t_us, apart_us=2**40))
        if codec.name == "motion-predictive":
            assert_within_threshold(codec.law, stimuli, encode_array(codec, t_us, stimuli, positions).decoded)

    check()


@pytest.mark.parametrize(
    ("codec", "axes"), [*itertools.product(made, (1, 3)), *itertools.product((Deadband, AdaptivePredictive), (2,))]
)
def test_compiled_steps_give_what_the_stream_gives(codec, axes, compiled):
    @settings(max_examples=60)
    @given(codec=made[codec], given=moving(axes))
    def check(codec, given):
        assert_same(encode_streamed(codec, *given), compiled(codec, *given))

    check()


@pytest.mark.parametrize("codec", made)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -2e15])
def test_both_refuse_the_same_sample(codec, bad, compiled):
    t_us, stimuli = np.arange(5) * 1000, np.array([1.0, 1.01, 2.0, bad, 3.0])
    for encode in (encode_streamed, compiled):
        with pytest.raises(SampleError, match="sample 3: stimulus is"):
            encode(codec(), t_us, stimuli, np.zeros(5))


@pytest.mark.parametrize("codec", [codec for codec in made if codec.needs_position])
def test_a_position_out_of_range_is_refused(codec, compiled):
    t_us, stimuli = np.arange(3) * 1000, np.ones(3)
    for encode in (encode_streamed, compiled):
        with pytest.raises(SampleError, match="sample 1: position is"):
            encode(codec(), t_us, stimuli, np.array([0.0, np.nan, 0.0]))


def test_times_and_positions_must_fit_the_samples():
    with pytest.raises(SampleError, match="9 time stamps for 10 samples; the counts must match"):
        encode_array(Deadband(), np.arange(9), np.ones(10))
    with pytest.raises(SampleError, match="positions of shape"):
        encode_array(VelocityAdaptive(), np.arange(10), np.ones(10), np.ones((10, 2)))
    with pytest.raises(SampleError, match="they must be within"):
        encode_array(Deadband(), np.array([0, 2**62]), np.ones(2))


@pytest.mark.parametrize("name", CODECS)
def test_every_codec_by_name_runs_compiled_over_a_long_recording_even_if_it_is_a_plug_in(name):
    assert recording.is_made_of_steps(CODECS[name]())
