import math
import struct

import numpy as np
import pytest
from codec_cases import stream, wandering
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet_literature.level_crossing import MOST_LEVELS, LevelCrossing, levels

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)


@given(st.floats(0.0, 0.5), st.floats(1e-9, 2.0))
def test_cells_are_as_wide_as_the_threshold_allows_and_leave_no_gap(weber, floor_n):
    at, ends = (np.array(each) for each in levels(weber, floor_n))
    allowed = np.maximum(weber * at, floor_n)
    lower = np.concatenate([[-ends[0]], ends[:-1]])
    assert len(at) <= MOST_LEVELS + 1
    assert (at - lower <= allowed).all()
    assert (ends - at <= allowed).all()
    assert (ends - lower >= 2 * allowed * (1 - 1e-6)).all()


def test_levels_are_uniform_below_the_floor_and_geometric_above():
    at, _ = (np.array(each) for each in levels(0.05, 0.025))
    assert at[:11] == pytest.approx(0.05 * np.arange(11), rel=1e-9)
    assert at[12:] / at[11:-1] == pytest.approx(1.05 / 0.95, rel=1e-9)
    assert at[-1] > 0.9e15
    assert len(at) < 370


@given(st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=3))
def test_every_force_has_a_level_of_the_same_sign_in_two_bytes_an_axis(forces_n):
    axes = len(forces_n)
    payload = LevelCrossing(law=LAW, hysteresis=0.0).encoder(axes).encode(0, tuple(forces_n))
    for index, force_n in zip(struct.unpack(f">{axes}h", payload), forces_n, strict=True):
        assert index * force_n >= 0.0
        if axes == 1:
            assert (index == 0) == (abs(force_n) <= levels(0.05, 0.025)[1][0])


def test_a_force_is_silent_within_its_cell_and_sent_when_it_crosses_into_the_next():
    encoder = LevelCrossing(law=LAW, hysteresis=0.0).encoder(1)
    sent = [encoder.encode(0, (force_n,)) for force_n in (0.20, 0.22, 0.176, 0.224, 0.226, 0.274, 0.224)]
    assert sent == [struct.pack(">h", 4), None, None, None, struct.pack(">h", 5), None, struct.pack(">h", 4)]


def test_noise_at_a_crossing_is_sent_unless_a_hysteresis_is_wider():
    noise = 0.225 + np.random.default_rng(1).uniform(-0.002, 0.002, (1000, 1))
    packets = [len(stream(LevelCrossing(law=LAW, hysteresis=h), noise).sent) for h in (0.0, 0.1, 0.25)]
    assert packets[0] > 300
    assert packets[1:] == [1, 1]


def test_it_sends_fewer_packets_than_the_deadband_at_the_same_bound():
    stimuli = wandering(20_000, seed=2)
    packets = {type(codec): len(stream(codec, stimuli).sent) for codec in (Deadband(), LevelCrossing(hysteresis=0.1))}
    assert packets[LevelCrossing] < 0.75 * packets[Deadband]


@pytest.mark.parametrize(
    "law", [WeberLaw(floor_n=0.0), WeberLaw(multiplier=0.0), WeberLaw(weber_fraction=0.0, floor_n=1e-9)]
)
def test_where_there_is_no_level_a_force_is_sent_as_the_deadband_sends_it(law):
    codec = LevelCrossing(law=law)
    payload = codec.encoder(1).encode(0, (1.1,))
    assert payload == Deadband(law=law).encoder(1).encode(0, (1.1,))
    decoder = codec.decoder(1)
    decoder.decode(0, payload)
    assert decoder.reconstruct(0)[0] == pytest.approx(1.1)


@pytest.mark.parametrize(
    "payload", [struct.pack(">h", 400), struct.pack(">h", -32_768), b"", b"\0" * 3, struct.pack(">f", math.nan)]
)
def test_a_corrupt_payload_is_refused_and_the_held_stimulus_stays(payload):
    decoder = LevelCrossing(law=LAW, hysteresis=0.0).decoder(1)
    decoder.decode(0, struct.pack(">h", -4))
    before = decoder.reconstruct(0)
    assert before[0] == pytest.approx(-0.2)
    with pytest.raises(PeerError, match="payload"):
        decoder.decode(1, payload)
    assert decoder.reconstruct(1) == before
