import struct

import numpy as np
import pytest
from codec_cases import wandering
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.base import Encoding
from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.perception import WeberLaw

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)


def encoded(codec, stimuli: np.ndarray, period_us: int = 1000) -> Encoding:
    return encode_array(codec, period_us * np.arange(len(stimuli), dtype=np.int64), stimuli)


def packets(codec, stimuli: np.ndarray) -> int:
    return len(encoded(codec, stimuli).sent)


@given(st.integers(0, 1000), st.integers(1, 3))
def test_one_payload_is_all_a_decoder_needs(seed, axes):
    codec = AdaptivePredictive(law=LAW)
    encoder, all_along = codec.encoder(axes), codec.decoder(axes)
    for t_us, stimulus in zip(range(0, 400_000, 1000), wandering(400, seed=seed, axes=axes).tolist(), strict=True):
        payload = encoder.encode(t_us, tuple(stimulus))
        if payload is not None:
            all_along.decode(t_us, payload)
            late = codec.decoder(axes)
            late.decode(t_us, payload)
        assert late.reconstruct(t_us) == all_along.reconstruct(t_us)


@given(st.integers(0, 1000), st.integers(2, 399))
def test_after_a_loss_the_curve_ends_at_its_travel_and_stays_there(seed, last):
    codec = AdaptivePredictive(law=LAW)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    for t_us, stimulus in zip(range(0, 1000 * last, 1000), wandering(last, seed=seed).tolist(), strict=False):
        payload = encoder.encode(t_us, tuple(stimulus))
        if payload is not None:
            sent_us, newest = t_us, payload
    decoder.decode(sent_us, newest)
    (start,) = struct.unpack(">f", newest[:4])
    (thresholds,) = struct.unpack(">e", newest[4:])
    followed = [decoder.reconstruct(sent_us + 1000 * ms)[0] for ms in range(400)]
    assert followed[0] == start
    assert followed == sorted(followed, reverse=thresholds < 0)
    assert set(followed[200:]) == {start + thresholds * LAW.threshold_n(abs(start))}


def test_a_steady_slope_is_followed_without_a_packet():
    ramp = 1.0 + 2.0 * np.arange(150)[:, np.newaxis] / 1000.0
    assert packets(AdaptivePredictive(law=LAW, horizon_ms=10_000.0), ramp) <= 3
    assert packets(Deadband(law=LAW), ramp) >= 5


def test_on_noise_it_learns_to_hold_the_level_and_not_what_left_the_threshold():
    noise = 1.0 + 0.02 * np.random.default_rng(5).standard_normal((20_000, 1))
    assert packets(AdaptivePredictive(law=LAW), noise) < 0.7 * packets(Deadband(law=LAW), noise)


@pytest.mark.parametrize("step", [0.003, 0.01, 0.03])
def test_on_a_walk_without_trend_it_becomes_a_deadband(step):
    law = WeberLaw(weber_fraction=0.0, floor_n=0.05)
    walk = np.cumsum(step * np.random.default_rng(6).choice([-1.0, 1.0], (20_000, 1)), axis=0)
    assert packets(AdaptivePredictive(law=law), walk) < 1.1 * packets(Deadband(law=law), walk)


def test_a_breach_is_not_taken_for_a_slope():
    stimuli = np.full((60, 1), 3.0)
    stimuli[30:] = 1.0
    encoding = encoded(AdaptivePredictive(law=LAW), stimuli)
    assert encoding.sent.tolist() == [0, 30]
    assert encoding.decoded.tolist() == stimuli.tolist()


def jumps_n(codec, stimuli: np.ndarray) -> tuple[list[float], list[float]]:
    """Return how far each update moves the applied force, and how far the true one was from it before."""
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    jumps, away = [], []
    for t_us, (x,) in zip(range(0, 1000 * len(stimuli), 1000), stimuli.tolist(), strict=True):
        (before,) = decoder.reconstruct(t_us)
        payload = encoder.encode(t_us, (x,))
        if payload is not None:
            decoder.decode(t_us, payload)
            jumps.append(abs(decoder.reconstruct(t_us)[0] - before))
            away.append(abs(x - before))
    return jumps[1:], away[1:]


@pytest.mark.parametrize("bound", [0.25, 0.5, 1.0])
def test_the_applied_force_jumps_no_further_than_the_bound_and_the_force_itself_demand(bound):
    law = WeberLaw(weber_fraction=0.0, floor_n=0.05)
    stimuli = wandering(5000, seed=8)
    stimuli[2500:] += 1.0
    jumps, away = jumps_n(AdaptivePredictive(law=law, jump_thresholds=bound), stimuli)
    assert max(jumps) > 0.9
    for jump, distance in zip(jumps, away, strict=True):
        assert jump <= max(bound * 0.05, distance - 0.9 * 0.05) + 1e-6
    assert max(jumps_n(AdaptivePredictive(law=law), stimuli[:2500])[0]) > 0.05
