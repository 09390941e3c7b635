import numpy as np
import pytest
from codec_cases import assert_same, assert_within_threshold, laws, steps, timed, wandering
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.measure.metrics import worst_window_packets
from hapticnet_literature.merging import Merging

MS = 1000


@given(timed(), laws, st.sampled_from([0.5, 10.0, 2000.0]), steps)
def test_no_window_holds_two_packets_and_outside_the_windows_the_held_force_is_within_the_threshold(
    case, law, window_ms, step_n
):
    t_us, stimuli, _ = case
    encoding = encode_array(Merging(law=law, window_ms=window_ms, step_n=step_n), t_us, stimuli)
    sent_us = t_us[encoding.sent]
    assert (np.diff(sent_us) >= window_ms * MS).all()
    newest_us = np.array([sent_us[sent_us <= at_us].max() for at_us in t_us], dtype=np.int64)
    free = (t_us - newest_us >= window_ms * MS) | np.isin(np.arange(len(t_us)), encoding.sent)
    assert_within_threshold(law, stimuli[free], encoding.decoded[free])


@given(timed(), laws, steps)
def test_a_window_of_nothing_is_the_deadband(case, law, step_n):
    t_us, stimuli, _ = case
    deadband = encode_array(Deadband(law=law, step_n=step_n), t_us, stimuli)
    assert_same(deadband, encode_array(Merging(law=law, step_n=step_n, window_ms=0.0), t_us, stimuli))


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("window_ms", [5.0, 20.0])
def test_the_rate_is_bounded_in_every_100_ms_where_the_deadbands_is_not(axes, window_ms):
    t_us = np.arange(3000, dtype=np.int64) * MS
    stimuli = wandering(3000, seed=axes, axes=axes)
    stimuli[1000:1300] += np.random.default_rng(axes).normal(0.0, 1.0, (300, axes))
    merged, plain = (encode_array(codec, t_us, stimuli).sent for codec in (Merging(window_ms=window_ms), Deadband()))
    assert worst_window_packets(t_us[merged]) <= 100 / window_ms
    assert worst_window_packets(t_us[plain]) > 80


def test_a_change_after_a_pause_is_sent_at_once_and_the_next_when_the_window_ends():
    encoder = Merging(window_ms=10.0).encoder(1)
    assert encoder.encode(0, (1.0,)) is not None
    assert encoder.encode(50 * MS, (2.0,)) is not None
    for millisecond in range(51, 60):
        assert encoder.encode(millisecond * MS, (3.0,)) is None
    assert encoder.encode(60 * MS, (3.5,)) == Deadband().encoder(1).encode(0, (3.5,))


def test_what_leaves_the_dead_zone_and_comes_back_within_a_window_is_merged_away():
    stimuli = np.array([[1.0]] * 3 + [[5.0]] * 4 + [[1.01]] * 20)
    t_us = np.arange(27, dtype=np.int64) * MS
    assert encode_array(Merging(window_ms=10.0), t_us, stimuli).sent.tolist() == [0]


def test_a_time_stamp_that_goes_back_ends_the_window():
    encoder = Merging(window_ms=10.0).encoder(1)
    encoder.encode(10**12, (1.0,))
    assert encoder.encode(0, (2.0,)) is not None
    assert encoder.encode(MS, (3.0,)) is None
