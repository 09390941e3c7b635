"""What a decoder that follows the receiver's own position may apply: never far beyond what was answered lately."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet import virtual_link
from hapticnet.channel.settings import ChannelSettings
from hapticnet.codec.base import Predictive
from hapticnet.codec.registry import every_codec, make_codec
from hapticnet.errors import PeerError
from hapticnet.node import decoders
from hapticnet.node.closed_loop import simulate_link
from hapticnet.node.decoders import GROWTH, LATELY_US, MARGIN_N, receiver
from hapticnet.node.hand_predictor import LONGEST_AHEAD_US
from hapticnet.perception import WeberLaw

CODECS = every_codec()
LAW = WeberLaw()
MOTION = make_codec("motion-predictive", LAW)


def coupled(offset_n: float, stiffness_n_m: float, viscosity_n_s_m: float) -> bytes:
    """Return an update that says how the force follows position and velocity."""
    return bytes([3]) + struct.pack(">ffee", offset_n, 0.0, stiffness_n_m, viscosity_n_s_m)


def taps(stiffness_n_m: float, viscosity_n_s_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, forces and positions of a hand that taps on a viscous wall for four seconds."""
    t_us = np.arange(0, 4_000_000, 1000)
    position_m = 0.004 * np.sin(5e-6 * np.pi * t_us) + 0.001 * np.sin(18e-6 * np.pi * t_us)
    pressed_n = stiffness_n_m * position_m + viscosity_n_s_m * np.gradient(position_m, 1e-3)
    noise_n = 0.02 * np.random.default_rng(3).standard_normal(len(t_us))
    return t_us, (np.where(position_m > 0.0, np.maximum(pressed_n, 0.0), 0.0) + noise_n)[:, None], position_m[:, None]


def largest_applied_n(delay_us: int) -> tuple[float, float]:
    """Return the largest force that is applied, and the largest there is."""
    t_us, forces_n, positions_m = taps(2000.0, 20.0)
    late = ChannelSettings(delay_us=delay_us)
    played = simulate_link(MOTION, t_us, forces_n, positions_m, forward=late, feedback=late, repair_us=200_000,
                  rng=np.random.default_rng(1))  # fmt: skip
    return float(np.abs(played.applied).max()), float(forces_n.max())


@pytest.mark.plain
def test_a_stiffness_learned_a_round_trip_ago_does_not_strike(monkeypatch):
    applied_n, true_n = largest_applied_n(25_000)
    assert applied_n <= GROWTH * true_n + MARGIN_N + LAW.threshold_n(GROWTH * true_n)
    monkeypatch.setattr(decoders, "MARGIN_N", 1e9)
    without_n, _ = largest_applied_n(25_000)
    assert without_n > 3.0 * true_n, "the case tests the bound"


def bytes_of_positions():
    """Return how many bytes the coded positions of some insertions take at 50 ms each way."""
    late = "delay=50ms"
    link = virtual_link(
        scene="paper:1", codec="motion-predictive", positions="line", forward=late, feedback=late, seed=1
    )
    link.run(seconds=6)
    return link.report().forward_wire_bytes


def test_the_bound_costs_no_positions(monkeypatch):
    within_bound = bytes_of_positions()
    monkeypatch.setattr(decoders, "MARGIN_N", 1e9)
    assert within_bound <= 1.05 * bytes_of_positions()


def test_without_delay_the_bound_changes_nothing():
    t_us, forces_n, positions_m = taps(2000.0, 20.0)
    encoder, plain, decoder = MOTION.encoder(1), MOTION.decoder(1), receiver(MOTION, 1)
    for at_us, force_n, place_m in zip(t_us.tolist(), forces_n[:, 0], positions_m[:, 0], strict=True):
        payload = encoder.encode(at_us, (float(force_n),), (float(place_m),))
        for each in (plain, decoder):
            if payload is not None:
                each.decode(at_us, payload)
        position = (float(place_m),)
        assert decoder.reconstruct(at_us, position, at_us) == plain.reconstruct(at_us, position, at_us)


@settings(max_examples=200, deadline=None)
@given(
    updates=st.lists(st.tuples(st.floats(-50, 50), st.floats(0, 9e3), st.floats(0, 900)), min_size=1, max_size=6),
    places=st.lists(st.floats(-0.05, 0.05), min_size=10, max_size=60),
    late=st.integers(0, 9),
)
def test_whatever_a_slave_says_the_force_stays_near_what_it_said_of_answered_positions(updates, places, late):
    decoder, behind = receiver(MOTION, 1), MOTION.decoder(1)
    answered_n = [0.0]
    heard_us = None
    for tick, place in enumerate(places):
        now_us, position = 1000 * tick, (place,)
        if heard_us is None:
            decoder.reconstruct(now_us, position, now_us)
        answered = tick - late
        if answered < 0:
            continue
        t_us = 1000 * answered
        if heard_us is None:
            for before in range(answered + 1):
                behind.reconstruct(1000 * before, (places[before],), 1000 * before)
        if updates and (heard_us is None or tick % 5 == 0):
            payload = coupled(*updates.pop())
            decoder.decode(t_us, payload)
            behind.decode(t_us, payload)
            heard_us = now_us
        answered_n.append(abs(behind.reconstruct(t_us, (places[answered],), t_us)[0]))
        (force_n,) = decoder.reconstruct(t_us, position, now_us)
        assert abs(force_n) <= GROWTH * max(answered_n) + MARGIN_N + 1e-9


def test_forces_of_more_than_a_second_ago_do_not_count():
    decoder = receiver(MOTION, 1)
    decoder.reconstruct(0, (0.010,), 0)
    decoder.decode(0, coupled(0.0, 500.0, 0.0))
    assert decoder.reconstruct(0, (0.010,), 0)[0] == pytest.approx(5.0)
    decoder.decode(1000, coupled(0.0, 0.0, 0.0))
    for now_us in range(1000, LATELY_US + 3000, 1000):
        assert decoder.reconstruct(now_us, (0.010,), now_us)[0] == 0.0
    decoder.decode(LATELY_US, coupled(0.0, 500.0, 0.0))
    (force_n,) = decoder.reconstruct(LATELY_US, (0.020,), LATELY_US + 3000)
    assert force_n <= GROWTH * 5.0 + MARGIN_N + 1e-9


@pytest.mark.parametrize("name", CODECS)
def test_only_codecs_that_follow_positions_are_bounded(name):
    codec = make_codec(name, LAW)
    decoder = receiver(codec, 1)
    assert isinstance(decoder, decoders.BoundedDecoder) == codec.needs_position
    assert isinstance(decoder, Predictive) == isinstance(codec.decoder(1), Predictive)
    with pytest.raises(PeerError):
        decoder.decode(0, b"\xff" * 200)


@pytest.mark.parametrize("period_us", [0, 15_000])
def test_where_the_hand_is_predicted_only_answers_that_are_older_than_that_are_bounded(period_us):
    decoder, plain = receiver(MOTION, 1, predicted=True, period_us=period_us), MOTION.decoder(1)
    for each in (decoder, plain):
        each.reconstruct(0, (0.0,), 0)
        each.decode(0, coupled(0.0, 5_000.0, 0.0))
    latest_us = LONGEST_AHEAD_US + period_us  # the answer to the next position comes a period later
    for late_us in (latest_us, latest_us + 1):
        forces = [each.reconstruct(0, (0.01,), late_us)[0] for each in (decoder, plain)]
        assert forces == ([50.0, 50.0] if late_us == latest_us else [MARGIN_N, 50.0])
