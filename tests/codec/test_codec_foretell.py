"""`predict` of every decoder: what `reconstruct` will return, and nothing changed by the question."""

import math

import pytest

from hapticnet.codec.base import Predictive
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.perception import WeberLaw

CODECS = every_codec()


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
