import math
import struct

import numpy as np
import pytest
from codec_cases import assert_within_threshold

from hapticnet.codec.recording import encode_streamed
from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.contact import local_stiffness
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.schemes.motion import COUPLED, CURVE, HOLD, SURFACE
from hapticnet.codec.schemes.motion_predictive import MotionPredictive
from hapticnet.errors import PeerError
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
TICK_US = 1000


def times(count: int):
    return TICK_US * np.arange(count, dtype=np.int64)


def played(codec, forces, positions):
    forces, positions = np.atleast_2d(np.transpose(forces)).T, np.atleast_2d(np.transpose(positions)).T
    return encode_streamed(codec, times(len(forces)), forces, positions)


def kinds_sent(codec, forces, positions):
    encoder, form = codec.encoder(1), codec.form(1)
    sent = []
    for t_us, force, position in zip(times(len(forces)).tolist(), forces, positions, strict=True):
        payload = encoder.encode(t_us, (float(force),), (float(position),))
        if payload is not None:
            sent.append(form.unpack(payload))
    return sent


def hand(samples=4000, seed=1, speed_hz=0.5, reach_m=0.01):
    """Return the positions of a hand that goes to and fro, with tremor."""
    rng = np.random.default_rng(seed)
    t_s = 1e-3 * np.arange(samples)
    tremor = np.convolve(rng.normal(0.0, 2e-5, samples), np.ones(20) / 20, "same")
    return reach_m * np.sin(2 * math.pi * speed_hz * t_s) + tremor


def paper(insertions=2, seed=1):
    operator = ScriptedOperator(InsertionSettings(insertions=insertions), np.random.default_rng(seed))
    scene = Scene(paper_scene(seed).tissues)
    positions = [operator.sample(t_us).position_m for t_us in range(0, operator.duration_us, TICK_US)]
    forces = [scene.step(PositionSample(TICK_US * k, at)).force_n for k, at in enumerate(positions)]
    return np.array(forces), np.array(positions)


def test_a_spring_with_a_damper_is_learned_and_then_needs_hardly_a_packet():
    positions = hand(8000, speed_hz=0.7)
    velocities, before, velocity = [], positions[0], 0.0
    for position in positions:  # as the codec sees it
        velocity = (position - before + 0.005 * velocity) / 0.006
        before = position
        velocities.append(velocity)
    forces = 150.0 * positions + 4.0 * np.array(velocities) + 2.0
    sent = played(MotionPredictive(law=LAW), forces, positions).sent
    assert np.sum(sent > 4000) <= 2
    assert len(played(AdaptivePredictive(law=LAW), forces, positions).sent) > 50


@pytest.mark.parametrize("noise_n", [0.0, 0.02, 0.2])
def test_where_positions_say_nothing_it_needs_about_as_many_packets_as_the_better_of_curve_and_hold(noise_n):
    rng = np.random.default_rng(4)
    forces = 1.5 + np.sin(np.arange(6000) / 150.0) + rng.normal(0.0, noise_n, 6000)
    positions = hand(6000, seed=9, speed_hz=3.1)
    of = {
        made: len(played(made(law=LAW), forces, positions).sent)
        for made in (MotionPredictive, AdaptivePredictive, Deadband)
    }
    assert of[MotionPredictive] <= 1.05 * min(of[AdaptivePredictive], of[Deadband]) + 5


def test_without_positions_no_surface_and_no_coupling_is_sent():
    codec = MotionPredictive(law=LAW)
    encoder, form = codec.encoder(1), codec.form(1)
    forces = 400.0 * np.clip(hand(2000), 0.0, None)
    payloads = [encoder.encode(t_us, (float(force),)) for t_us, force in enumerate(forces)]
    assert {form.unpack(payload).kind for payload in payloads if payload is not None} <= {HOLD, CURVE}


def test_a_receiver_that_is_elsewhere_applies_what_holds_there():
    """A hand that is pushed on while the answer to its first touch is under way feels the surface grow at once."""
    codec = MotionPredictive(law=LAW)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    depths = np.arange(0.0, 0.003, 1e-4)
    payloads = [encoder.encode(TICK_US * k, (500.0 * d,), (float(d),)) for k, d in enumerate(depths)]
    newest = max(k for k, payload in enumerate(payloads) if payload is not None)
    assert newest < 10
    for k, payload in enumerate(payloads):
        if payload is not None:
            decoder.decode(TICK_US * k, payload)
    for depth in (0.0005, 0.004, 0.01):
        now_us = int(1e9 * depth)
        (applied,) = decoder.reconstruct(TICK_US * newest, (depth,), now_us)
        assert applied == pytest.approx(500.0 * depth, abs=LAW.threshold_n(500.0 * depth))
    assert decoder.reconstruct(TICK_US * newest, (-0.01,), 10**9) == (0.0,), "a surface does not pull"


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_tilted_surface_acts_along_its_normal(axes):
    normal = np.array([0.8, -0.5, 0.33])[:axes]
    normal /= np.linalg.norm(normal)
    depth = np.concatenate([np.linspace(-1e-3, 4e-3, 100), np.full(200, 4e-3)])
    slide = np.linspace(0.0, 0.05, 300)[:, None] * np.cross(np.pad(normal, (0, 3 - axes)), [0.2, 0.4, 0.9])[:axes]
    if axes > 1:
        slide -= (slide @ normal)[:, None] * normal
    positions = depth[:, None] * normal + (slide if axes > 1 else 0.0)
    forces = 600.0 * np.clip(depth, 0.0, None)[:, None] * normal
    sent = played(MotionPredictive(law=LAW), forces, positions).sent
    assert len(sent) <= 5, "sliding along a plane changes no force"


@pytest.mark.parametrize(
    ("name", "forces", "positions"),
    [
        ("rest", np.ones(600) + np.random.default_rng(1).normal(0.0, 0.05, 600), np.full(600, 0.02)),
        ("repeated positions", 300.0 * np.repeat(hand(60, speed_hz=20.0), 10), np.repeat(hand(60, speed_hz=20.0), 10)),
        ("sign changes", 300.0 * hand(3000, speed_hz=5.0), hand(3000, speed_hz=5.0)),
        ("a wall of 1e6 N/m", 1e6 * np.clip(hand(3000), 0.0, None), hand(3000)),
        ("vibration", 1.0 + 0.5 * np.sin(np.arange(3000) * 1.6), hand(3000)),
        ("a hand that jumps", 200.0 * np.clip(hand(3000), 0.0, None), hand(3000) + (np.arange(3000) % 97 == 0) * 10.0),
        ("positions in a far frame", 300.0 * np.clip(hand(3000), 0.0, None), hand(3000) + 1e6),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_hard_cases_stay_within_the_threshold_and_cost_little_more_than_the_deadband(name, forces, positions):
    assert name
    codec = MotionPredictive(law=LAW)
    encoding = played(codec, forces, positions)
    assert_within_threshold(LAW, forces[:, None], encoding.decoded)
    assert len(encoding.sent) <= 1.05 * len(played(Deadband(law=LAW), forces, positions).sent) + 5
    for message in kinds_sent(codec, forces, positions):
        assert 0.0 <= message.stiffness <= 1.002 * codec.stiffest_n_per_m
        assert message.normal[0] ** 2 <= 1.002 * codec.stiffest_n_per_m


def test_the_local_stiffness_is_that_of_the_surface_and_the_learned_one_where_the_tool_hardly_moved():
    def estimated(positions, forces, learned):
        table = [[float(x)] for x in positions], [[float(x)] for x in forces]
        return local_stiffness(
            times(len(forces)).tolist(), table[1], table[0], 0, len(forces) - 1, 0.05, learned, (0.0,)
        )[0]

    rng = np.random.default_rng(2)
    moving = np.linspace(0.001, 0.003, 20)
    assert estimated(moving, 700.0 * moving, 0.0) == pytest.approx(700.0)
    at_rest = 0.002 + rng.normal(0.0, 1e-7, 20)
    assert estimated(at_rest, 1.0 + rng.normal(0.0, 0.01, 20), 250.0) == 250.0
    assert estimated(moving, np.zeros(20), 250.0) == 0.0, "no force, no surface"
    assert estimated(moving, 2.0 - 300.0 * moving, 250.0) == 0.0, "what grows softer as one pushes is no surface"
    after_breach = np.where(moving < 0.002, 5.0, 700.0 * moving)
    assert estimated(moving, after_breach, 0.0) == pytest.approx(700.0), "samples before an impact do not count"


def test_one_payload_is_all_a_decoder_needs():
    codec = MotionPredictive(law=LAW)
    forces, positions = paper(1)
    encoder, all_along = codec.encoder(1), codec.decoder(1)
    late, payloads = None, 0
    for t_us, force, position in zip(times(len(forces)).tolist(), forces.tolist(), positions.tolist(), strict=True):
        payload = encoder.encode(t_us, tuple(force), tuple(position))
        if payload is not None:
            all_along.decode(t_us, payload)
            payloads += 1
            if payloads == 4:
                late = codec.decoder(1)
            if late is not None:
                late.decode(t_us, payload)
        applied = all_along.reconstruct(t_us, tuple(position))
        if late is not None:
            assert late.reconstruct(t_us, tuple(position)) == applied
    assert late is not None


def test_a_receiver_without_a_position_applies_nothing_for_a_surface():
    decoder = MotionPredictive(law=LAW).decoder(1)
    decoder.decode(0, struct.pack(">Bfe", SURFACE, 1.0, 20.0))
    assert decoder.reconstruct(0) == (0.0,)
    assert decoder.reconstruct(1000, (0.001,)) == pytest.approx((1.4,))


def test_the_last_known_motion_counts_while_positions_are_missing():
    codec = MotionPredictive(law=LAW)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    rng = np.random.default_rng(6)
    for k, at in enumerate(hand(2000, speed_hz=2.0).tolist()):
        position = (at,) if rng.random() < 0.7 else None
        force = 300.0 * max(at, 0.0) + 0.5
        payload = encoder.encode(TICK_US * k, (force,), position)
        if payload is not None:
            decoder.decode(TICK_US * k, payload)
        (applied,) = decoder.reconstruct(TICK_US * k, position)
        assert abs(applied - force) <= LAW.threshold_n(applied)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "kind -1"),
        (struct.pack(">Bf", 4, 1.0), "kind 4"),
        (struct.pack(">Bf", HOLD, math.nan), "finite"),
        (struct.pack(">Bd", HOLD, 1.0), "kind 0 with 1 axes takes 5"),
        (struct.pack(">Bfe", CURVE, 1.0, 2000.0), "thresholds"),
        (struct.pack(">Bfe", SURFACE, 1.0, 0.0), "normal is zero"),
        (struct.pack(">Bfe", SURFACE, 1.0, 200.0), "stiffness of 40000 N/m"),
        (struct.pack(">Bffee", COUPLED, 1.0, math.inf, 1.0, 1.0), "travel"),
        (struct.pack(">Bffee", COUPLED, 1.0, 0.0, -1.0, 1.0), "stiffness"),
        (struct.pack(">Bffee", COUPLED, 1.0, 0.0, 1.0, 1200.0), "viscosity"),
    ],
)
def test_what_no_encoder_sends_is_refused_and_changes_nothing(payload, words):
    decoder = MotionPredictive(law=LAW).decoder(1)
    decoder.decode(0, struct.pack(">Bfe", SURFACE, 0.5, 20.0))
    before = decoder.reconstruct(0, (0.001,))
    with pytest.raises(PeerError, match=words):
        decoder.decode(1000, payload)
    assert decoder.reconstruct(0, (0.001,)) == before
