"""Frames of vibration: what is felt is within the quantiser's bound, and what is not felt takes nothing."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.vibration import (
    FRAME,
    LARGEST_M_S2,
    LARGEST_SCALE,
    LONGEST_BYTES,
    RATE_HZ,
    WEBER,
    Quantised,
    VibrationCodec,
    felt_m_s2,
    pack_frame,
    unpack_frame,
)
from hapticnet.errors import PeerError, SampleError, SettingsError
from tests.vectors import make_vibration

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "vibration.json").read_text())
FRAMES = st.lists(st.floats(-LARGEST_M_S2, LARGEST_M_S2), min_size=FRAME, max_size=FRAME)
DCT = np.array([[make_vibration.wave(order, at) for at in range(FRAME)] for order in range(FRAME)])


def sine(amplitude, frequency_hz, phase=0.0):
    return amplitude * np.sin(2.0 * math.pi * frequency_hz * np.arange(FRAME) / RATE_HZ + phase)


def test_the_vectors_are_what_the_script_writes():
    assert make_vibration.document() == VECTORS


@pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda vector: vector["name"])
def test_golden_frames_are_written_to_the_byte_and_played(vector):
    codec = VibrationCodec(vector["threshold"])
    payload = codec.encode(vector["samples"])
    assert (None if payload is None else payload.hex()) == vector["payload"]
    if payload is not None:
        assert codec.decode(payload) == pytest.approx(vector["played"], abs=1e-9)


@pytest.mark.parametrize("vector", VECTORS["refused"], ids=lambda vector: vector["name"])
def test_golden_refused_frames_are_refused(vector):
    with pytest.raises(PeerError, match="frame of vibration"):
        VibrationCodec().decode(bytes.fromhex(vector["payload"]))


@given(FRAMES, st.floats(0.001, 10.0), st.integers(0, 20))
def test_every_coefficient_is_within_half_a_step(samples, threshold, coarser):
    codec = VibrationCodec(threshold)
    quantised = codec.quantise(samples, coarser=coarser)
    if quantised is None:
        return
    coefficients = np.zeros(FRAME)
    steps = codec.steps(quantised.scale)
    coefficients[: len(quantised.numbers)] = quantised.numbers * steps[: len(quantised.numbers)]
    assert np.abs(DCT @ samples - coefficients).max() <= 0.5 * steps.max()
    assert (np.abs(DCT @ samples - coefficients) <= 0.5 * steps * (1.0 + 1e-9) + 1e-9).all()
    assert codec.decode(pack_frame(quantised)) == pytest.approx(np.clip(coefficients @ DCT, -1000.0, 1000.0), abs=1e-6)


@given(FRAMES, st.floats(0.001, 10.0))
def test_the_error_is_not_felt_beside_the_frame(samples, threshold):
    """It is below the threshold, or at most sqrt(3) times the share `WEBER` of the frame's level, the worst case."""
    codec = VibrationCodec(threshold)
    payload = codec.encode(samples)
    played = np.zeros(FRAME) if payload is None else codec.decode(payload)
    level = codec.level(samples)
    assert codec.level(played - samples) <= math.sqrt(3.0) * max(1.0, WEBER * level) * (1.0 + 1e-6)


@given(FRAMES, st.floats(0.0, 0.99))
def test_nothing_is_sent_below_the_threshold(samples, share):
    codec = VibrationCodec()
    level = codec.level(samples)
    weak = np.array(samples) * (share / level if level > 1.0 else share)
    assert codec.encode(weak.tolist()) is None


def test_the_sensitivity_is_that_of_its_sources():
    felt = felt_m_s2(1.0, np.array([40.0, 100.0, 250.0, 500.0, 1000.0]))
    assert 20.0 * np.log10(felt) == pytest.approx([0.0, 0.0, 0.0, 24.1, 48.2], abs=0.1)

    def vc_pwq(hz):
        return 62.0 * (math.log10(hz / 550.0 + 6.0 / 11.0) / math.log10(6.0 / 11.0)) ** 2 - 77.0

    assert vc_pwq(500.0) - vc_pwq(250.0) == pytest.approx(24.1, abs=0.5)


@given(st.integers(0, LARGEST_SCALE), st.lists(st.integers(-40, 40), min_size=1, max_size=FRAME))
def test_packed_frames_are_read_back(scale, numbers):
    numbers[-1] = numbers[-1] or 1
    quantised = Quantised(scale, tuple(numbers))
    payload = pack_frame(quantised)
    assert unpack_frame(payload) == quantised
    assert len(payload) <= LONGEST_BYTES


@given(st.binary(max_size=120))
def test_garbage_is_refused_or_within_the_range(payload):
    try:
        samples = VibrationCodec().decode(payload)
    except PeerError:
        return
    assert samples.shape == (FRAME,)
    assert np.abs(samples).max() <= LARGEST_M_S2


@pytest.mark.parametrize("samples", [[], [0.0] * 27, [1001.0] + [0.0] * 27, [math.nan] * 28, [math.inf] * 28])
def test_what_is_no_frame_is_refused(samples):
    with pytest.raises(SampleError, match=r"28 numbers within ±1000 m/s²"):
        VibrationCodec().encode(samples)


def test_a_threshold_out_of_range_is_refused():
    with pytest.raises(SettingsError, match="vibration threshold"):
        VibrationCodec(0.0)
