"""The deadband law, for every input, in a stream and over a whole recording."""

import math

import numpy as np
import pytest
from codec_cases import laws, recordings, stream
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import codec_parameters, every_codec, make_codec
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.streams import IntervalEncoder, StepEncoder
from hapticnet.errors import SampleError, SettingsError
from hapticnet.perception import WeberLaw
from hapticnet_literature.level_crossing import LevelCrossing

CODECS = every_codec()


@given(recordings.filter(lambda stimuli: stimuli.shape[1] == 1), laws, st.sampled_from([Deadband, LevelCrossing]))
def test_the_quiet_interval_changes_no_payload(stimuli, law, made):
    codec = made(law=law)
    quick, plain = codec.encoder(1), StepEncoder(codec, 1)
    assert isinstance(quick, IntervalEncoder)
    for index, x in enumerate(stimuli.tolist()):
        assert quick.encode(index, tuple(x)) == plain.encode(index, tuple(x))


def test_weber_worked_example_of_the_paper():
    law = WeberLaw(weber_fraction=0.05, floor_n=0.0)
    assert law.threshold_n(1.0) == 0.05
    stimuli = np.array([[1.0], [1.049], [0.951], [1.051], [1.10], [1.104], [0.99]])
    encoding = stream(Deadband(law=law), stimuli)
    assert encoding.sent.tolist() == [0, 3, 5, 6]


def test_a_difference_of_exactly_the_threshold_is_not_transmitted():
    law = WeberLaw(weber_fraction=0.25, floor_n=0.0)
    encoding = stream(Deadband(law=law), np.array([[1.0], [1.25], [0.75], [math.nextafter(1.25, 2)]]))
    assert encoding.sent.tolist() == [0, 3]


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("name", sorted(CODECS))
def test_refresh_makes_the_next_stimulus_a_transmitted_one(name, axes):
    encoder = make_codec(name, WeberLaw(floor_n=1.0)).encoder(axes)
    assert encoder.encode(0, (0.0,) * axes) is not None, "the first sample is always sent"
    encoder.refresh()
    assert encoder.encode(1, (0.0,) * axes) is not None


def test_an_unknown_codec_or_parameter_is_refused_with_what_there_is():
    with pytest.raises(SettingsError, match=r"unknown codec 'mp3'; there are: raw, deadband"):
        make_codec("mp3", WeberLaw())
    with pytest.raises(SettingsError, match="has no parameter 'bitrate'"):
        make_codec("deadband", WeberLaw(), {"bitrate": 1.0})
    assert codec_parameters(make_codec("deadband", WeberLaw())) == {"step_n": 0.0}


@pytest.mark.parametrize("shape", [(2, 4), (2, 0), (2, 2, 2)])
def test_a_recording_of_a_shape_that_cannot_be_is_refused(shape):
    with pytest.raises(SampleError, match="recording of shape"):
        encode_array(Deadband(), np.arange(2, dtype=np.int64), np.zeros(shape))
