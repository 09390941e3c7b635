"""What motion-predictive makes of the round trip: the laws hold, the truest line is sent, and one that errs is left."""

import math

import numpy as np
import pytest
from codec_cases import assert_within_threshold, laws, timed
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.channel.settings import ChannelSettings
from hapticnet.codec.base import Delayed
from hapticnet.codec.recording import encode_streamed
from hapticnet.codec.schemes.contact import no_coupling
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.schemes.motion import COUPLED, CURVE, HOLD, SURFACE
from hapticnet.codec.schemes.motion_felt import (
    SIMILAR_LINE,
    SURFACE_LINE,
    TIMED_LINE,
    better,
    similar_coupling,
)
from hapticnet.codec.schemes.motion_predictive import MotionPredictive
from hapticnet.codec.streams import table_of_rows
from hapticnet.node.closed_loop import simulate_link
from hapticnet.perception import WeberLaw

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
TICK_US = 1000
ROUND_TRIP_US = 50_000


def hand(samples, seed=1, speed_hz=1.5, reach_m=0.015):
    rng = np.random.default_rng(seed)
    t_s = 1e-3 * np.arange(samples)
    return reach_m * (np.sin(2 * math.pi * speed_hz * t_s) + 0.4 * np.sin(7.3 * t_s + rng.uniform(0.0, 6.0)))


def foam(positions, seed=1):
    """Return what something gives that stiffens, is softer on the way back, damps, and is measured with noise."""
    rng, rubbed, forces = np.random.default_rng(seed), 0.0, []
    for before, here in zip([positions[0], *positions[:-1]], positions, strict=True):
        rubbed = min(max(rubbed + 400.0 * (here - before), -0.3), 0.3)
        depth = here + 0.02
        forces.append(60.0 * depth + 2000.0 * depth**2 + rubbed + 5.0 * 1e3 * (here - before))
    return np.array(forces) + rng.normal(0.0, 0.005, len(positions))


def encoded(forces, positions, round_trip_us, codec=None):
    """Return what an encoder sends that is told the round trip, and what a decoder applies at once."""
    codec = codec or MotionPredictive(law=LAW)
    forces, positions = forces.reshape(len(forces), -1), positions.reshape(len(positions), -1)
    axes = forces.shape[1]
    encoder, decoder, form = codec.encoder(axes), codec.decoder(axes), codec.form(axes)
    assert isinstance(encoder, Delayed)
    encoder.set_round_trip(round_trip_us)
    messages, applied = [], []
    for k, (force, position) in enumerate(zip(forces.tolist(), positions.tolist(), strict=True)):
        payload = encoder.encode(TICK_US * k, tuple(force), tuple(position))
        if payload is not None:
            decoder.decode(TICK_US * k, payload)
            messages.append((k, form.unpack(payload)))
        applied.append(decoder.reconstruct(TICK_US * k, tuple(position)))
    return messages, np.array(applied)


def felt_rmse(codec, forces, positions, delay_us=25_000):
    link = ChannelSettings(delay_us=delay_us)
    times = TICK_US * np.arange(len(forces), dtype=np.int64)
    played = simulate_link(
        codec, times, forces[:, None], positions[:, None], forward=link, feedback=link, repair_us=100_000,
        rng=np.random.default_rng(1),
    )  # fmt: skip
    return float(np.sqrt(np.mean((played.applied[:, 0] - forces) ** 2)))


@given(st.integers(0, 1000), st.integers(1, 3), st.sampled_from([0, 8_000, ROUND_TRIP_US, 10**6]), st.floats(0.0, 1e5))
def test_whatever_the_round_trip_the_error_without_delay_stays_within_the_threshold(seed, axes, round_trip_us, stiff):
    rng = np.random.default_rng(seed)
    positions = hand(500, seed, 2.5)[:, None] * rng.normal(1.0, 0.3, (1, axes))
    speeds = np.gradient(positions, 1e-3, axis=0)
    forces = stiff * np.clip(positions, 0.0, None) + 3.0 * speeds + rng.normal(0.0, 0.02, positions.shape)
    _, applied = encoded(forces, positions, round_trip_us)
    assert_within_threshold(LAW, forces, applied)


@given(timed(), laws, st.integers(0, 100_000))
def test_no_input_and_no_round_trip_breaks_the_law(recording, law, round_trip_us):
    times, stimuli, positions = recording
    codec = MotionPredictive(law=law)
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    encoder.set_round_trip(round_trip_us)
    applied = []
    for t_us, x, at in zip(times.tolist(), stimuli.tolist(), positions.tolist(), strict=True):
        payload = encoder.encode(t_us, tuple(x), tuple(at))
        if payload is not None:
            decoder.decode(t_us, payload)
        applied.append(decoder.reconstruct(t_us, tuple(at)))
    assert_within_threshold(law, stimuli, np.array(applied).reshape(stimuli.shape))


@given(st.integers(0, 10_000), st.sampled_from([0.002, 0.02, 0.1, 0.5]), st.booleans(), st.sampled_from([1.0, 4.0]))
def test_it_never_needs_over_2_percent_and_2_packets_more_than_the_deadband(seed, noise_n, is_placed, multiplier):
    rng = np.random.default_rng(seed)
    positions = hand(1500, seed, rng.uniform(0.3, 4.0))
    steps = 2.0 * (rng.random(1500) < 0.005)
    forces = np.clip(rng.uniform(-300.0, 600.0) * positions, -1.0, None) + np.cumsum(steps) % 5.0
    forces += rng.normal(0.0, noise_n, 1500)
    law = WeberLaw(weber_fraction=0.05, floor_n=0.025, multiplier=multiplier)
    where = positions[:, None] if is_placed else None
    times = TICK_US * np.arange(1500, dtype=np.int64)
    ours, deadband = (
        len(encode_streamed(made(law=law), times, forces[:, None], where).sent) for made in (MotionPredictive, Deadband)
    )
    assert ours <= max(1.02 * deadband, deadband + 2)


def test_after_a_loss_it_is_as_frugal_as_the_deadband_again():
    forces = 1.5 + np.random.default_rng(3).normal(0.0, 0.2, 2000)
    sent = []
    for codec in (MotionPredictive(law=LAW), Deadband(law=LAW)):
        encoder, count = codec.encoder(1), 0
        for k, force in enumerate(forces.tolist()):
            if k % 100 == 50:
                encoder.refresh()
            count += encoder.encode(TICK_US * k, (force,)) is not None
        sent.append(count)
    assert sent[0] <= 1.02 * sent[1] + 2


def test_foam_is_felt_far_truer_than_held_and_than_with_a_choice_by_packets():
    positions = hand(6000)
    forces = foam(positions)
    plain = MotionPredictive(law=LAW)
    held = felt_rmse(Deadband(law=LAW), forces, positions)
    assert felt_rmse(plain, forces, positions) < 0.5 * held
    kinds = [message.kind for _, message in encoded(forces, positions, ROUND_TRIP_US)[0]]
    assert kinds.count(COUPLED) > 0.8 * len(kinds)


def test_a_surface_that_errs_is_left_although_it_is_still_within_the_threshold():
    """At first the force grows with the position, from 3 s on it falls, as no surface and no coupling can."""
    positions = hand(6000, speed_hz=0.8)
    forces = 2.0 + 200.0 * positions
    forces[3000:] = 2.0 + 200.0 * positions[3000] - 100.0 * (positions[3000:] - positions[3000])
    messages, applied = encoded(forces, positions, ROUND_TRIP_US)
    assert {message.kind for k, message in messages if 1000 < k < 3000} <= {SURFACE, COUPLED}
    assert {message.kind for k, message in messages if k > 3800} <= {HOLD, CURVE}
    assert_within_threshold(LAW, forces[:, None], applied)


def test_another_line_is_wanted_only_if_it_is_clearly_better():
    assert better((3.0, 2.0, 2.9), SURFACE_LINE) == TIMED_LINE
    assert better((2.2, 2.0, 2.9), SURFACE_LINE) == SURFACE_LINE
    assert better((0.0, 0.0, 0.0), SIMILAR_LINE) == SIMILAR_LINE


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_the_way_in_and_the_way_back_are_learned_apart(axes):
    codec = MotionPredictive(law=LAW)
    rule = codec.rule(axes, table_of_rows)
    cells, along = rule.cells, np.array([0.8, -0.5, 0.33])[:axes]
    along /= np.linalg.norm(along)
    encoder = codec.encoder(axes)
    encoder.set_round_trip(20_000)
    encoder._rule = rule._replace(round_trip_us=[[20_000.0]])
    positions = 0.01 * np.abs((np.arange(4000) / 500.0) % 2.0 - 1.0)  # up and down at 20 mm/s
    for k, depth in enumerate(positions.tolist()):
        force = 400.0 * depth if k % 1000 >= 500 else 100.0 * depth
        encoder.encode(TICK_US * k, tuple((force + 1.0) * along), tuple(depth * along))
    into, back = (
        similar_coupling(cells, no_coupling(axes), tuple(2.0 * along), tuple(speed * along))[0]
        for speed in (0.02, -0.02)
    )
    assert into == pytest.approx(400.0, rel=0.3)
    assert back == pytest.approx(100.0, rel=0.3)


def test_without_a_round_trip_nothing_changes():
    positions = hand(2000)
    forces = foam(positions)
    told, _ = encoded(forces, positions, 0)
    codec = MotionPredictive(law=LAW)
    encoder = codec.encoder(1)
    untold = [
        encoder.encode(TICK_US * k, (force,), (at,))
        for k, (force, at) in enumerate(zip(forces.tolist(), positions.tolist(), strict=True))
    ]
    assert [k for k, _ in told] == [k for k, payload in enumerate(untold) if payload is not None]
