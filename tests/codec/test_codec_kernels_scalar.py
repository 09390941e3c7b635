"""What is compiled is what streams, to the bit."""

import os

import numpy as np
import pytest
from codec_cases import anything, assert_same, haptic, laws, only_compiled, steps
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.codec import kernels, level_crossing
from hapticnet.codec.level_crossing import LevelCrossing
from hapticnet.codec.predictive import LinearPredictive
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw

forces = npst.arrays(np.float64, st.tuples(st.integers(0, 60), st.just(1)), elements=st.one_of(haptic, anything))
codecs = st.one_of(
    st.builds(LevelCrossing, law=laws, hysteresis=st.floats(0.0, 0.5)),
    st.builds(
        LinearPredictive, law=laws, slope_samples=st.integers(2, 9), horizon_ms=st.floats(1.0, 10_000.0), step_n=steps
    ),
)
gaps = st.lists(st.one_of(st.just(1000), st.just(0), st.integers(-10, 30_000), st.integers(0, 2**50)), min_size=60)


@pytest.fixture(autouse=True, scope="module")
def _compiled():
    with only_compiled(level_crossing):
        yield


def assert_streams_alike(codec, t_us, stimuli):
    assert_same(encode_streamed(codec, t_us, stimuli), codec.encode_array(t_us, stimuli))


@given(codecs, forces, st.one_of(st.just([1000] * 60), gaps))
@settings(deadline=None)
def test_compiled_codecs_agree_with_their_streams_on_any_force_at_any_time(codec, stimuli, gaps):
    assert_streams_alike(codec, np.cumsum(np.array(gaps, dtype=np.int64))[: len(stimuli)], stimuli)


@pytest.mark.parametrize("law", [WeberLaw(), WeberLaw(multiplier=0.0), WeberLaw(weber_fraction=0.0, floor_n=1e-12)])
@pytest.mark.parametrize(
    "make", [LevelCrossing, LinearPredictive, lambda law: LinearPredictive(law=law, step_n=0.001, slope_samples=64)]
)
def test_compiled_codecs_agree_with_their_streams_over_a_long_walk_with_impacts(make, law):
    rng = np.random.default_rng(1)
    moves = rng.normal(0.0, 0.05, (20_000, 1))
    moves[rng.random(20_000) < 0.001] *= 1e6
    stimuli, t_us = np.cumsum(moves, axis=0), np.cumsum(rng.integers(0, 2000, 20_000))
    assert_streams_alike(make(law=law), t_us, stimuli)
    stimuli[7] = np.nan
    with pytest.raises(SampleError, match="sample 7"):
        make(law=law).encode_array(t_us, stimuli)


def test_a_recording_whose_times_are_not_as_many_is_refused_as_its_stream_does():
    with pytest.raises(ValueError, match="zip"):
        LinearPredictive().encode_array(np.arange(9), np.ones((10, 1)))


def test_kernels_older_than_any_file_they_may_build_on_are_forgotten(tmp_path, monkeypatch):
    (tmp_path / "__pycache__").mkdir()
    stale, fresh = (tmp_path / "__pycache__" / f"kernels_{name}.nbi" for name in ("stale", "fresh"))
    for at_s, file in enumerate((stale, tmp_path / "trend.py", fresh)):
        file.touch()
        os.utime(file, (at_s, at_s))
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "kernels.py"))
    kernels._forget_stale_kernels()
    assert not stale.exists()
    assert fresh.exists()
