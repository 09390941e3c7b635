"""Stimuli of several parts: each part keeps its own law, and every update carries them all."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.registry import make_codec
from hapticnet.errors import PeerError, SampleError, SettingsError
from hapticnet.parts import KINDS, PartsLaw, apart_function, parse_parts, size_function
from hapticnet.perception import WeberLaw
from hapticnet.vectors import distance, magnitude
from tests.vectors import make_parts

VECTORS = json.loads((Path(make_parts.__file__).with_name("parts.json")).read_text())
POSE = parse_parts(("force:3", "torque:3", "grip:1"))
LAW = PartsLaw.of(POSE, WeberLaw())

component = st.floats(-50.0, 50.0)
stimulus = st.tuples(*[component] * LAW.axes)


def parts_of(x):
    return [x[each] for each in LAW.slices()]


@given(st.lists(stimulus, min_size=1, max_size=30))
def test_what_is_applied_is_within_the_threshold_of_every_part_at_every_sample(stimuli):
    codec = make_codec("deadband", LAW)
    encoder, decoder = codec.encoder(LAW.axes), codec.decoder(LAW.axes)
    for t_us, x in enumerate(stimuli):
        payload = encoder.encode(t_us, x)
        if payload is not None:
            decoder.decode(t_us, payload)
        applied = decoder.reconstruct(t_us)
        for own, true, held in zip(LAW.laws, parts_of(x), parts_of(applied), strict=True):
            assert distance(true, held) <= own.threshold_n(magnitude(held))


@given(st.lists(stimulus, min_size=1, max_size=20))
def test_a_stimulus_is_sent_when_one_part_is_and_any_later_update_repairs_a_loss(stimuli):
    codec = make_codec("deadband", LAW)
    encoder, alone = codec.encoder(LAW.axes), [make_codec("deadband", own) for own in LAW.laws]
    held = None
    for t_us, x in enumerate(stimuli):
        payload = encoder.encode(t_us, x)
        outside = held is None or any(
            distance(now, before) > each.law.threshold_n(magnitude(before))
            for now, before, each in zip(parts_of(x), held, alone, strict=True)
        )
        assert (payload is not None) == outside
        if payload is not None:
            newcomer = codec.decoder(LAW.axes)  # which has missed all before
            newcomer.decode(t_us, payload)
            held = parts_of(newcomer.reconstruct(t_us))


def test_a_part_that_does_not_change_costs_no_packets():
    encoder = make_codec("deadband", LAW).encoder(LAW.axes)
    turning = [(1.0, 0.0, 0.0, 0.0, 0.0, 0.002 * t, 3.0) for t in range(100)]
    sent = sum(encoder.encode(t, x) is not None for t, x in enumerate(turning))
    alone = make_codec("deadband", LAW.laws[1]).encoder(3)
    assert sent == sum(alone.encode(t, x[3:6]) is not None for t, x in enumerate(turning)) < 40


def test_parts_are_passed_to_codecs_that_follow_the_motion_with_their_own_position():
    codec = make_codec("motion-predictive", LAW)
    encoder, decoder = codec.encoder(LAW.axes), codec.decoder(LAW.axes)
    sent = 0
    for t in range(2000):
        angle = 0.5 * math.sin(t / 300.0)
        position, x = (0.0, 0.0, 0.0, 0.0, 0.0, angle, 0.05), (0.0,) * 5 + (0.4 * angle, 0.0)
        payload = encoder.encode(1000 * t, x, position)
        if payload is not None:
            decoder.decode(1000 * t, payload)
            sent += 1
        applied = decoder.reconstruct(1000 * t, position)
        assert abs(applied[5] - x[5]) <= LAW.laws[1].threshold_n(abs(applied[5])) + 1e-9
    assert sent < 20  # the torque is a spring of the rotation


@pytest.mark.parametrize("case", VECTORS["cases"], ids=lambda case: case["name"])
def test_payloads_are_those_of_the_golden_vectors(case):
    law = PartsLaw.of(parse_parts(case["parts"]), WeberLaw(), case["thresholds"])
    codec = make_codec(case["codec"], law, case["parameters"])
    encoder, decoder = codec.encoder(law.axes), codec.decoder(law.axes)
    for t_us, force, position, payload, arrives, applied in case["samples"]:
        sent = encoder.encode(t_us, tuple(force), tuple(position))
        assert (sent.hex() if sent else None) == payload
        if arrives:
            decoder.decode(t_us, sent)
        assert list(decoder.reconstruct(t_us, tuple(position))) == applied
    for payload in case["refused"]:
        with pytest.raises(PeerError):
            decoder.decode(case["samples"][-1][0], bytes.fromhex(payload))


def test_the_vectors_are_those_that_are_made():
    assert json.loads(json.dumps(make_parts.document())) == VECTORS


@pytest.mark.parametrize(
    ("x", "words"), [((1.0,) * 6, "it must have 7"), ((1.0,) * 6 + (math.nan,), "nan"), ((math.inf,) * 7, "inf")]
)
def test_a_stimulus_that_must_not_enter_leaves_every_part_as_it_was(x, words):
    codec = make_codec("deadband", LAW)
    encoder, other = codec.encoder(7), codec.encoder(7)
    good = (1.0, 0.0, 0.0, 0.1, 0.0, 0.0, 2.0)
    assert encoder.encode(0, good) == other.encode(0, good)
    with pytest.raises(SampleError, match=words):
        encoder.encode(1, x)
    assert encoder.encode(2, (1.2, *good[1:])) == other.encode(2, (1.2, *good[1:]))


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (("force",), "KIND:AXES"),
        (("force:4",), "KIND:AXES"),
        (("grip:2",), "grip: 1"),
        (("slip:1",), "kinds are force, torque, grip"),
        (("force:3", "force:3"), "are the same"),
        ((7,), "KIND:AXES"),
        ((), "0 axes"),
        (tuple(f"force:3@f{n}" for n in range(9)), "27 axes"),
    ],
)
def test_parts_that_cannot_be_used_are_refused_with_what_would_be_right(texts, words):
    with pytest.raises(SettingsError, match=words):
        parse_parts(texts)


@pytest.mark.parametrize(
    "others", [{"slip": (0.1, 0.1)}, {"force": (0.1, 0.1)}, {"torque": (0.1, 0.0)}, {"grip": (2, 1)}]
)
def test_thresholds_that_cannot_be_used_are_refused(others):
    with pytest.raises(SettingsError):
        PartsLaw.of(POSE, WeberLaw(), others)


@given(stimulus, stimulus)
def test_unlike_quantities_are_compared_in_their_own_thresholds(x, y):
    apart, size = apart_function(LAW), size_function(LAW)
    each = [apart_function(own)(a, b) for own, a, b in zip(LAW.laws, parts_of(x), parts_of(y), strict=True)]
    assert apart(x, y) == max(each)
    in_floors = [magnitude(part) / own.floor_n for part, own in zip(parts_of(x), LAW.laws, strict=True)]
    assert size(x) == pytest.approx(LAW.floor_n * max(in_floors))


def test_the_published_thresholds():
    assert [round(kind.weber_fraction, 3) for kind in KINDS.values()] == [0.05, 0.127, 0.07]
    assert np.allclose([kind.floor for kind in KINDS.values()], [0.025, 0.00762, 0.175])
