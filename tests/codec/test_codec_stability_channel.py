"""Every registered codec behind a channel that corrupts, loses, delays and reorders."""

import contextlib
import copy

import numpy as np
import pytest
from codec_cases import wandering

import bench.measure.codec_trials  # noqa: F401 - so that codecs can be copied
from hapticnet.codec.recording import encode_lossy
from hapticnet.codec.registry import codec_parameters, every_codec, make_codec
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.vectors import magnitude

CODECS = every_codec()

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
REPAIR_MS = 20
LONGEST_DELAY_MS = 5

every_codec = pytest.mark.parametrize("name", CODECS)
bounds_its_error_by_the_threshold = pytest.mark.parametrize("name", [name for name in CODECS if name != "merging"])
losses = pytest.mark.parametrize("loss", [0.0, 0.05, 0.1, 0.3])


def impacts(samples: int, *, seed: int, axes: int = 1) -> np.ndarray:
    """Return a hand's force that a wall throws up and a breach lets fall, by 2 N in one sample."""
    force = wandering(samples, seed=seed, axes=axes)
    force[np.arange(samples) % 400 >= 200] += 2.0
    return force


def is_within_threshold(x, applied) -> bool:
    error = magnitude(tuple(a - b for a, b in zip(x, applied, strict=True)))
    return error <= LAW.threshold_n(magnitude(applied))


def spoilt(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Return a payload as no encoder need have made it: bits turned, cut off, grown, of two halves, or of nothing."""
    way = rng.integers(6)
    if way == 0:
        turned = int.from_bytes(payload) ^ 1 << int(rng.integers(8 * len(payload)))
        return turned.to_bytes(len(payload))
    if way == 1:
        return payload[: rng.integers(len(payload))]
    if way == 2:
        return payload + rng.bytes(rng.integers(1, 20))
    if way == 3:
        return other[: rng.integers(len(other) + 1)] + payload[rng.integers(len(payload)) :]
    if way == 4:
        return bytes([int(rng.choice([0x00, 0x7F, 0x80, 0xFF]))]) * len(payload)
    return rng.bytes(rng.integers(40))


@pytest.mark.plain
@every_codec
@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("step_n", [0.0, 0.001])
def test_a_corrupt_payload_is_refused_without_a_trace_or_leads_to_a_finite_force(name, axes, step_n):
    codec = make_codec(name, LAW)
    if "step_n" in codec_parameters(codec):
        codec = make_codec(name, LAW, {"step_n": step_n})
    rng = np.random.default_rng(axes)
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    payloads = []
    refused = 0
    for t_us, x in zip(range(0, 400_000, 1000), impacts(400, seed=axes, axes=axes).tolist(), strict=True):
        payload = encoder.encode(t_us, tuple(x))
        if payload is None:
            continue
        payloads.append(payload)
        bad = spoilt(payload, payloads[rng.integers(len(payloads))], rng)
        victim, untouched = copy.deepcopy(decoder), copy.deepcopy(decoder)
        try:
            victim.decode(t_us, bad)
        except PeerError:
            refused += 1
            victim.decode(t_us, payload)
            untouched.decode(t_us, payload)
            for later_us in (0, 1000, 150_000, 10**12):
                assert victim.reconstruct(t_us + later_us) == untouched.reconstruct(t_us + later_us)
        else:
            for later_us in (0, 1000, 150_000, 10**12):
                assert all(abs(component) <= LARGEST_COMPONENT for component in victim.reconstruct(t_us + later_us))
        decoder.decode(t_us, payload)
    assert refused > len(payloads) / 4


def through_channel(codec, stimuli: np.ndarray, *, loss: float, rng: np.random.Generator):
    """Yield, for every sample, what is applied, and whether it is what the newest update made of it.

    Updates are lost, and take up to 5 ms, so that they overtake each other. As in a session, the late ones are
    dropped, and 20 ms after an update that did not arrive the encoder is refreshed.
    """
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    under_way: list[tuple[int, int, int, bytes]] = []
    sent = taken = seen = sent_ms = 0
    for now_ms, x in enumerate(stimuli.tolist()):
        if taken < sent and now_ms - sent_ms >= REPAIR_MS:
            encoder.refresh()
        payload = encoder.encode(1000 * now_ms, tuple(x))
        if payload is not None:
            sent, sent_ms = sent + 1, now_ms
            if rng.random() >= loss:
                arrival_ms = now_ms + int(rng.integers(LONGEST_DELAY_MS + 1))
                under_way.append((arrival_ms, sent, 1000 * now_ms, payload))
        for update in sorted(update for update in under_way if update[0] <= now_ms):
            under_way.remove(update)
            _, number, t_us, payload = update
            if number > seen:
                seen = number
                try:
                    decoder.decode(t_us, payload)
                except PeerError:  # it builds on one that was lost
                    continue
                taken = number
        yield decoder.reconstruct(1000 * now_ms), taken == sent


@bounds_its_error_by_the_threshold
@losses
@pytest.mark.parametrize("axes", [1, 3])
def test_through_loss_and_reordering_whoever_has_the_newest_update_is_within_the_threshold(name, loss, axes):
    stimuli = impacts(2000, seed=9, axes=axes)
    rng = np.random.default_rng(3)
    checked = 0
    for x, (applied, newest) in zip(
        stimuli.tolist(), through_channel(make_codec(name, LAW), stimuli, loss=loss, rng=rng), strict=True
    ):
        if newest:
            checked += 1
            assert is_within_threshold(x, applied)
    assert checked > 100


@every_codec
@losses
def test_through_loss_and_reordering_the_applied_force_stays_within_what_was_seen_and_the_way_along_a_slope(name, loss):
    codec = make_codec(name, LAW)
    stimuli = impacts(3000, seed=10)
    largest, smallest = stimuli.max(), min(0.0, stimuli.min())
    # A codec that extrapolates follows no steeper slope than there was between two samples, and to its horizon only.
    threshold_n = LAW.threshold_n(largest)
    steepest_n_per_ms = np.abs(np.diff(stimuli[:, 0])).max() + 2.0 * threshold_n
    way_n = threshold_n + steepest_n_per_ms * getattr(codec, "horizon_ms", 0.0)
    for (applied,), _ in through_channel(codec, stimuli, loss=loss, rng=np.random.default_rng(4)):
        assert smallest - way_n <= applied <= largest + way_n


@bounds_its_error_by_the_threshold
@losses
def test_from_a_loss_to_the_next_update_taken_in_is_all_that_exceeds_the_threshold(name, loss):
    stimuli = impacts(3000, seed=11)
    t_us = 1000 * np.arange(3000, dtype=np.int64)
    codec = make_codec(name, LAW)
    rng = np.random.default_rng(5)
    encoding, received = encode_lossy(codec, t_us, stimuli, loss=loss, repair_us=1000 * REPAIR_MS, rng=rng)
    newest_sent = np.searchsorted(encoding.sent, np.arange(3000), side="right")
    newest_received = encoding.sent[np.searchsorted(encoding.sent, received)]
    up_to_date = np.isin(encoding.sent[newest_sent - 1], newest_received)
    errors = np.abs(stimuli - encoding.decoded)[:, 0]
    exceeds = ~(errors <= LAW.thresholds_n(np.abs(encoding.decoded[:, 0])))
    assert not np.any(exceeds & up_to_date)
    assert np.any(~up_to_date) == (loss > 0.0)


@every_codec
@pytest.mark.parametrize("axes", [1, 3])
def test_after_losses_and_corrupt_payloads_a_refresh_restores_the_threshold_with_one_payload(name, axes):
    codec = make_codec(name, LAW)
    rng = np.random.default_rng(6)
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    for index, x in enumerate(map(tuple, impacts(3000, seed=12, axes=axes).tolist())):
        lossy, refreshed = index % 20 < 10, index % 20 == 10
        if refreshed:
            encoder.refresh()
        payload = encoder.encode(1000 * index, x)
        for _ in range(3 * refreshed):
            with contextlib.suppress(PeerError):  # whatever is taken in before
                decoder.decode(1000 * index, spoilt(payload, payload, rng))
        if payload is not None and not (lossy and rng.random() < 0.3):
            try:
                decoder.decode(1000 * index, payload)
            except PeerError:
                assert lossy
        if refreshed or not (lossy or name == "merging"):
            assert is_within_threshold(x, decoder.reconstruct(1000 * index))
