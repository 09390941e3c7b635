"""What every codec refuses leaves no trace, and a question about the future changes nothing."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.base import Predictive
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.errors import PeerError, SampleError, SettingsError
from hapticnet.perception import WeberLaw

CODECS = every_codec()

FORCES_N = (0.0, 1.0, 1.01, 1.2, -3.0, 4.0)


def sample(index, axes):
    force_n = tuple(FORCES_N[index] * scale for scale in (1.0, -0.5, 0.1)[:axes])
    return 1000 * index, force_n, (0.01 * index,) * axes


def bad_samples(axes, positions_matter):
    good = (1.0,) * axes
    for axis in range(axes):
        for value in (math.nan, math.inf, -math.inf, 1e300):
            bad = tuple(value if each == axis else 1.0 for each in range(axes))
            yield from ((bad, good), (bad, None))
            if positions_matter:
                yield good, bad
    for wrong in {0, 1, 2, 3, 4} - {axes}:
        yield from (((1.0,) * wrong, None), ((1.0,) * wrong, good))


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("made", CODECS.values(), ids=CODECS)
def test_an_encoder_goes_on_as_if_a_refused_sample_had_not_come(made, axes):
    undisturbed, disturbed = made().encoder(axes), made().encoder(axes)
    for index in range(len(FORCES_N)):
        t_us, force_n, position_m = sample(index, axes)
        for bad_n, bad_m in bad_samples(axes, made.needs_position and not made.name.startswith("passive")):
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


@pytest.mark.parametrize("name", sorted(CODECS))
@given(payload=st.binary(max_size=30), axes=st.integers(1, 3))
def test_a_corrupt_payload_is_refused_or_finite_and_never_half_applied(name, payload, axes):
    decoder = make_codec(name, WeberLaw()).decoder(axes)
    before = decoder.reconstruct(0)
    try:
        decoder.decode(0, payload)
    except PeerError:
        assert decoder.reconstruct(0) == before
    else:
        assert all(abs(component) <= 1e15 for component in decoder.reconstruct(0))


@pytest.mark.parametrize(
    ("name", "parameter", "values"),
    [
        ("raw", "step_n", (-0.001, math.nan, math.inf, 1e-13, 1.5)),
        ("deadband", "step_n", (-0.001, math.nan, math.inf, 1e-13, 1.5)),
        ("adaptive-predictive", "horizon_ms", (0.5, math.nan)),
        ("adaptive-predictive", "window_ms", (2000.0, math.nan)),
        ("adaptive-predictive", "jump_thresholds", (0.05, math.nan)),
        ("adaptive-predictive", "step_n", (-1.0, math.nan)),
        ("motion-predictive", "stiffest_n_per_m", (0.5, 1e6)),
        ("motion-predictive", "horizon_ms", (0.0,)),
        ("motion-predictive", "window_ms", (1e4,)),
        ("linear-predictive", "slope_samples", (1.0, 2.5, math.nan)),
        ("linear-predictive", "horizon_ms", (0.0, math.inf)),
        ("linear-predictive", "step_n", (-1.0,)),
        ("level-crossing", "hysteresis", (-0.1, 0.6, math.nan)),
        ("probabilistic", "loss_probability", (0.95,)),
        ("probabilistic", "deviation_limit", (0.0,)),
        ("probabilistic", "step_n", (-1.0,)),
        ("velocity-adaptive", "speed_gain_s_m", (-1.0,)),
        ("velocity-adaptive", "largest_fraction", (1.1,)),
        ("velocity-adaptive", "time_constant_ms", (math.nan,)),
        ("velocity-adaptive", "step_n", (2.0,)),
        ("merging", "window_ms", (-1.0, math.inf)),
        ("merging", "step_n", (math.nan,)),
        ("passive-interpolative", "interval_ms", (-1.0, 1001.0, math.nan)),
        ("least-squares", "updates", (1.0, 3.5)),
        ("least-squares", "horizon_ms", (0.5,)),
        ("least-squares", "step_fraction", (0.0, math.nan)),
        ("least-squares", "absolute_every", (128.0,)),
        ("least-squares", "step_n", (2.0,)),
    ],
)
def test_a_parameter_out_of_range_is_refused_by_name(name, parameter, values):
    for value in values:
        with pytest.raises(SettingsError, match=f"{parameter} is"):
            CODECS[name](**{parameter: value})


# `predict`: what `reconstruct` will return, and nothing changed by the question -----------------------------------


@pytest.mark.parametrize("name", sorted(CODECS))
@pytest.mark.parametrize("axes", [1, 3])
def test_a_decoder_that_is_asked_for_the_future_goes_on_as_one_that_is_not(name: str, axes: int) -> None:
    codec = make_codec(name, WeberLaw(), {})
    encoder, asked, plain = codec.encoder(axes), codec.decoder(axes), codec.decoder(axes)
    assert isinstance(asked, Predictive)
    for tick in range(300):
        t_us = 1_000 * tick
        position = (0.01 * math.sin(0.03 * tick),) * axes
        payload = encoder.encode(t_us, (2.0 + math.sin(0.02 * tick),) * axes, position)
        if payload is not None:
            asked.decode(t_us, payload)
            plain.decode(t_us, payload)
        assert asked.reconstruct(t_us, position) == plain.reconstruct(t_us, position)
        asked.predict(t_us + 30_000, (1.0,) * axes, t_us + 30_000)


@pytest.mark.parametrize("name", sorted(CODECS))
def test_what_is_foretold_is_what_is_reconstructed_then(name: str) -> None:
    codec = make_codec(name, WeberLaw(), {})
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for tick in range(100):
        payload = encoder.encode(1_000 * tick, (0.02 * tick,), (1e-5 * tick,))
        if payload is not None:
            decoder.decode(1_000 * tick, payload)
        decoder.reconstruct(1_000 * tick, (1e-5 * tick,))
    ahead = decoder.predict(130_000, (1.3e-3,), 130_000)
    assert ahead == decoder.reconstruct(130_000, (1.3e-3,))
