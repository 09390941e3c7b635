"""What encoders and decoders refuse leaves no trace: they go on as if the sample had not come."""

import math

import pytest

from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import every_codec
from hapticnet.errors import SampleError

CODECS = every_codec()

FORCES_N = (0.0, 1.0, 1.01, 1.2, -3.0, 4.0)


def sample(index, axes):
    force_n = tuple(FORCES_N[index] * scale for scale in (1.0, -0.5, 0.1)[:axes])
    return 1000 * index, force_n, (0.01 * index,) * axes


def bad_samples(axes):
    good, bad = (1.0,) * axes, (math.nan,) + (1.0,) * (axes - 1)
    yield from ((bad, good), (bad, None), ((math.inf,) * axes, good))
    for wrong in {0, 1, 2, 3, 4} - {axes}:
        yield from (((1.0,) * wrong, None), ((1.0,) * wrong, good))


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("made", CODECS.values(), ids=CODECS)
def test_an_encoder_goes_on_as_if_a_refused_sample_had_not_come(made, axes):
    undisturbed, disturbed = made().encoder(axes), made().encoder(axes)
    for index in range(len(FORCES_N)):
        t_us, force_n, position_m = sample(index, axes)
        for bad_n, bad_m in bad_samples(axes):
            with pytest.raises(SampleError):
                disturbed.encode(t_us - 500, bad_n, bad_m)
        assert disturbed.encode(t_us, force_n, position_m) == undisturbed.encode(t_us, force_n, position_m)


def refusing(made, encoder, decoder):
    """Return the side that looks at positions."""
    if made.name.startswith("passive"):
        return lambda t_us, _force_n, position_m: decoder.reconstruct(t_us, position_m)
    return encoder.encode


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("made", [made for made in CODECS.values() if made.needs_position], ids=lambda made: made.name)
def test_a_position_that_is_not_finite_or_has_other_axes_is_refused(made, axes):
    encoder, decoder = made().encoder(axes), made().decoder(axes)
    for index in range(len(FORCES_N)):
        t_us, force_n, position_m = sample(index, axes)
        payload = encoder.encode(t_us, force_n, position_m)
        if payload is not None:
            decoder.decode(t_us, payload)
        applied = decoder.reconstruct(t_us, position_m)
        for bad_m in ((math.nan,) * axes, (-math.inf,) * axes, (1.0,) * (axes + 1), ()):
            with pytest.raises(SampleError, match="position"):
                refusing(made, encoder, decoder)(t_us, force_n, bad_m)
        assert decoder.reconstruct(t_us, position_m) == applied


@pytest.mark.parametrize("made", [made for made in CODECS.values() if made.needs_position], ids=lambda made: made.name)
def test_a_recording_with_a_position_that_is_not_finite_is_refused(made):
    with pytest.raises(SampleError, match="sample 2: position is nan"):
        encode_array(made(), [0, 1000, 2000], [1.0, 1.0, 1.0], [0.0, 0.1, math.nan])
