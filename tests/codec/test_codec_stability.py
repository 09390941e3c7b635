"""Every registered codec on signals from next to nothing to far beyond a hand, and over long runs."""

from functools import cache

import numpy as np
import pytest

from bench.measure.codec_trials import hand_force, in_step, trials
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.measure.metrics import norms
from hapticnet.perception import WeberLaw

CODECS = every_codec()

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
WITHOUT_FLOOR = WeberLaw(weber_fraction=0.05, floor_n=0.0)

WITHIN_A_WINDOW_ANYTHING = {"merging"}
"""The codecs that do not claim zero exceedance at rest."""

every_codec = pytest.mark.parametrize("name", CODECS)
laws = pytest.mark.parametrize("law", [LAW, WITHOUT_FLOOR], ids=["floor", "no floor"])


@cache
def every_trial():
    return trials(400, np.random.default_rng(4))


def on_axes(stimuli: np.ndarray, axes: int) -> np.ndarray:
    """Return a stimulus of one axis on several, out of step with itself."""
    return np.column_stack([stimuli, np.roll(stimuli, 7), -stimuli][:axes])


@pytest.mark.parametrize("name", [name for name, codec in CODECS.items() if not codec.renders_model])
@laws
@pytest.mark.parametrize("axes", [1, 3])
def test_in_motion_too_no_force_is_applied_that_is_much_larger_than_any_before(name, law, axes):
    codec = make_codec(name, law)
    for trial in every_trial():
        stimuli, positions = on_axes(trial.stimuli, axes), on_axes(trial.positions, axes)
        applied = norms(encode_array(codec, trial.t_us, stimuli, positions).decoded)
        # A passive ramp that takes the energy of its whole change leads, on several axes, over the sphere around it.
        largest = norms(stimuli).max() * (1.0 if axes == 1 else np.sqrt(2.0))
        assert applied.max() <= largest + 2.2 * law.threshold_n(largest), trial.name


@every_codec
@pytest.mark.parametrize("axes", [1, 3])
def test_no_signal_makes_a_payload_longer_than_a_value_and_a_slope_in_full(name, axes):
    codec = make_codec(name, WITHOUT_FLOOR)
    for trial in every_trial():
        sizes = encode_array(codec, trial.t_us, on_axes(trial.stimuli, axes)).payload_bytes
        assert sizes.max(initial=0) <= 1 + (8 + 4) * axes


@pytest.mark.plain
@every_codec
def test_over_300_000_samples_encoder_and_decoder_stay_in_step(name):
    codec = make_codec(name, LAW)
    rng = np.random.default_rng(2)
    force = hand_force(300_000, rng)
    force[rng.integers(0, 300_000, 50)] += 1e5  # spikes, that sums would remember
    force[100_000:200_000] -= 2.0  # through zero
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    gain, floor_n = LAW.weber_fraction, LAW.floor_n
    exceeded = 0
    for index, x in enumerate(force.tolist()):
        payload = encoder.encode(1000 * index, (x,))
        if payload is not None:
            decoder.decode(1000 * index, payload)
        (applied,) = decoder.reconstruct(1000 * index)
        exceeded += not (abs(x - applied) <= floor_n or abs(x - applied) <= gain * abs(applied))
        if index % 50_000 == 49_999:
            assert in_step(encoder, decoder, LAW, 1000 * index, x)
    assert exceeded == 0 or name in WITHIN_A_WINDOW_ANYTHING


@pytest.mark.plain
def test_being_out_of_step_by_the_last_bit_is_seen():
    codec = make_codec("deadband", LAW)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    decoder.decode(0, encoder.encode(0, (1.5,)))
    assert in_step(encoder, decoder, LAW, 0, 1.5)
    other = codec.encoder(1)
    decoder.decode(1, other.encode(1, (float(np.nextafter(np.float32(1.5), 2)),)))
    assert not in_step(encoder, decoder, LAW, 1, 1.5)
