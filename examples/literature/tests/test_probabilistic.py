import numpy as np
import pytest
from codec_cases import assert_same, laws, steps, stream, timed, wandering
from hypothesis import given

from hapticnet.codec.base import Codec
from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.measure.metrics import error_report
from hapticnet.perception import WeberLaw
from hapticnet_literature.probabilistic import MOST_STATES, Probabilistic

LAW = WeberLaw(weber_fraction=0.1, floor_n=0.01)


@given(timed(), laws, steps)
def test_where_nothing_is_lost_or_nothing_minded_it_is_the_deadband(case, law, step_n):
    t_us, stimuli, _ = case
    deadband = encode_array(Deadband(law=law, step_n=step_n), t_us, stimuli)
    for parameters in ({"loss_probability": 0.0}, {"loss_probability": 0.3, "deviation_limit": 0.3}):
        codec = Probabilistic(law=law, step_n=step_n, **parameters)
        assert_same(deadband, encode_array(codec, t_us, stimuli))


def sent_by_enumeration(stimuli: np.ndarray, codec: Probabilistic) -> list[int]:
    """Return what is sent by the rule as the docstring states it, by all that a receiver may have got of it."""
    updates: list[float] = []
    sent = []
    for index, x in enumerate(stimuli[:, 0].tolist()):
        newest_is_off = not updates or abs(x - updates[-1]) > codec.law.threshold_n(abs(updates[-1]))
        deviation, p = 1.0, codec.loss_probability
        for age, r in enumerate(reversed(updates[-MOST_STATES:])):
            if abs(x - r) <= codec.law.threshold_n(abs(r)):
                deviation -= (1 - p) * p**age
        if newest_is_off or deviation > codec.deviation_limit + 1e-12:
            updates.append(float(np.float32(x)))
            sent.append(index)
    return sent


@pytest.mark.parametrize(("loss", "limit"), [(0.1, 0.05), (0.3, 0.05), (0.3, 0.01), (0.8, 0.1), (0.8, 0.001)])
def test_what_is_sent_follows_from_what_the_receiver_may_be_holding(loss, limit):
    codec = Probabilistic(law=LAW, loss_probability=loss, deviation_limit=limit)
    stimuli = wandering(1500, seed=4)
    assert stream(codec, stimuli).sent.tolist() == sent_by_enumeration(stimuli, codec)


def through_loss(codec: Codec, stimuli: np.ndarray, *, loss: float, seed: int) -> tuple[float, int]:
    """Return exceed-JND fraction and packets when each packet is lost independently and nothing is repaired."""
    lost = np.random.default_rng(seed).random(len(stimuli)) < loss
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    packets, applied = 0, []
    for index, stimulus in enumerate(zip(*stimuli.T.tolist(), strict=True)):
        payload = encoder.encode(index * 1000, stimulus)
        if payload is not None:
            packets += 1
            if not lost[index]:
                decoder.decode(index * 1000, payload)
        applied.append(decoder.reconstruct(index * 1000))
    return error_report(codec.law, stimuli, np.array(applied)).exceed_jnd_fraction, packets


@pytest.mark.parametrize("loss", [0.05, 0.1, 0.3])
def test_under_loss_exceedance_falls_by_more_than_the_packets_grow(loss):
    stimuli = wandering(20_000, seed=5)
    plain, packets = through_loss(Deadband(law=LAW), stimuli, loss=loss, seed=6)
    codec = Probabilistic(law=LAW, loss_probability=loss, deviation_limit=loss / 2)
    resilient, more_packets = through_loss(codec, stimuli, loss=loss, seed=6)
    assert packets < more_packets < 2.2 * packets
    assert resilient < 0.55 * plain
