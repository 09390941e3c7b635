"""Payloads with models: golden vectors, and nothing but a PeerError for anything else."""

import json
import math
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.errors import PeerError
from hapticnet.node import decoders
from hapticnet.node.decoders import (
    MOST_PLAYED,
    OF_CODEC,
    AnnouncedDecoder,
    pack_model,
    read_state,
    unpack_model,
    with_state,
)
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead
from tests.vectors import make_models

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "models.json").read_text())
STIFFEST = 1e4
SPRING = LayerAhead(0.02, 500.0, 2.0)


def decoder(axes=1):
    return AnnouncedDecoder(Deadband().decoder(axes), axes, STIFFEST)


def test_the_vectors_are_those_of_the_document():
    made = make_models.document()
    assert [case["payload"] for case in made["models"]] == [case["payload"] for case in VECTORS["models"]]


@pytest.mark.parametrize("case", VECTORS["models"], ids=lambda case: case["name"])
def test_golden_models_are_read_written_and_rendered(case):
    payload = bytes.fromhex(case["payload"])
    assert pack_model(unpack_model(payload, case["axes"], STIFFEST), case["axes"]) == payload
    path, begins = case["path"], case["begins"]
    one = decoder(case["axes"])
    for t_us, position in path[: begins + 1]:
        one.move(t_us, tuple(position))
    one.decode(path[begins][0], payload)
    felt = [one.reconstruct(0)]
    for t_us, position in path[begins + 1 :]:
        one.move(t_us, tuple(position))
        felt.append(one.reconstruct(0))
    for force_n, expected_n in zip(felt, case["forces"], strict=True):
        assert force_n == pytest.approx(expected_n, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("case", VECTORS["models"], ids=lambda case: case["name"])
def test_a_model_that_arrives_late_is_played_what_happened_since(case):
    late = decoder(case["axes"])
    for t_us, position in case["path"]:
        late.move(t_us, tuple(position))
    late.decode(case["path"][case["begins"]][0], bytes.fromhex(case["payload"]))
    assert late.reconstruct(0) == pytest.approx(case["forces"][-1], rel=1e-9, abs=1e-9)


def moved():
    one = decoder()
    one.move(0, (0.0,))
    one.decode(0, pack_model([SPRING], 1))
    one.move(1000, (0.021,))
    return one


@given(st.one_of(st.binary(max_size=64), st.binary(max_size=120).map(lambda rest: b"\x01" + rest)))
def test_any_other_payload_is_a_peer_error_and_changes_nothing(payload):
    one = moved()
    before = one.reconstruct(0)
    try:
        one.decode(1000, payload)
    except PeerError:
        assert one.reconstruct(0) == before
        assert one.taken == one.settled == 1
    else:
        assert all(abs(component) <= 1e15 for component in one.reconstruct(0))


@given(st.data())
def test_one_changed_byte_is_a_model_or_a_peer_error(data):
    payload = bytearray(pack_model([SPRING, SPRING._replace(surface_m=0.04, viscosity_n_s_per_m=1.0)], 1))
    payload[data.draw(st.integers(1, len(payload) - 1))] = data.draw(st.integers(0, 255))
    one = moved()
    try:
        one.decode(1000, bytes(payload))
    except PeerError:
        assert one.reconstruct(0) == (pytest.approx(0.5),)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x01",
        b"\x02",
        b"\x01\x09" + bytes(100),
        pack_model([SPRING], 1)[:-1],
        pack_model([SPRING], 1) + b"\x00",
        b"\x01\x01\x40" + bytes(8),
        pack_model([SPRING._replace(stiffness_n_per_m=1e6)], 1),
        pack_model([SPRING._replace(stiffness_n_per_m=float("nan"))], 1),
        pack_model([SPRING._replace(normal=(0.0, 0.0))], 2),
    ],
)
def test_what_the_document_forbids_is_refused(payload):
    with pytest.raises(PeerError):
        moved().decode(1000, payload)


def test_a_model_before_any_position_is_refused():
    with pytest.raises(PeerError, match="before any position"):
        decoder().decode(0, pack_model([SPRING], 1))


FULL = [LayerAhead(0.0, 100.0, 0.5, 1.0, 10.0, 0.1, 1e-3, 0.001)] * MOST_LAYERS


def passed(positions=1000):
    """Return a decoder whose tool went in and out for a second."""
    one = decoder()
    for index in range(positions):
        one.move(1000 * index, (0.01 * math.sin(0.05 * index),))
    return one


@pytest.fixture
def played(monkeypatch):
    """Return what models have been played since it was last taken: the layers of each position, and 1."""
    costs, step = [], ContactModel.step

    def counted(model, t_us, position):
        costs.append(1 + len(model.layers()))
        return step(model, t_us, position)

    monkeypatch.setattr(ContactModel, "step", counted)

    def taken():
        cost = sum(costs)
        costs.clear()
        return cost

    return taken


def test_a_flood_of_old_models_is_played_no_more_of_the_past_between_two_positions(played):
    one, payload = passed(), pack_model(FULL, 1)
    for index in range(1000, 1100):
        one.move(1000 * index, (0.0,))
        for _ in range(50):
            one.decode(1000 * (index - 900), payload)
        assert played() <= MOST_PLAYED + 2 * 9, "and one more for the model that is applied"


@pytest.mark.plain
def test_a_model_that_is_caught_up_later_renders_what_it_would_have_rendered_at_once(monkeypatch):
    late, payload = passed(), pack_model(FULL, 1)
    late.decode(100_000, payload)
    assert not late.on_model
    for index in range(1000, 1036):
        late.move(1000 * index, (0.01 * math.sin(0.05 * index),))
    assert late.on_model
    monkeypatch.setattr(decoders, "MOST_PLAYED", 1 << 20)
    at_once = passed(1036)
    at_once.decode(100_000, payload)
    assert late.state == at_once.state
    assert late.reconstruct(0) == at_once.reconstruct(0) != (0.0,)


def test_a_model_of_three_layers_is_played_a_round_trip_of_fifty_positions_at_once():
    one = passed()
    one.decode(949_000, pack_model(FULL[:3], 1))
    assert one.on_model


def test_what_was_applied_goes_on_until_a_model_has_caught_up_and_only_the_newest_waits_for_it():
    one = passed()
    one.decode(0, OF_CODEC + struct.pack(">f", 2.0))
    for force_n in (1.0, 2.0, 3.0):
        one.decode(0, pack_model([*FULL[1:], LayerAhead(-0.02, 100.0, force_n)], 1))
    assert (one.taken, one.settled) == (3, 0)
    assert one.reconstruct(0) == (2.0,)
    settled = []
    for index in range(1000, 1100):
        one.move(1000 * index, (0.0,))
        settled.append(one.settled)
    assert sorted(set(settled)) == [0, 1, 3]


def test_a_payload_of_the_codec_replaces_the_models_that_have_not_caught_up():
    one = passed()
    for _ in range(2):
        one.decode(0, pack_model(FULL, 1))
    one.decode(0, OF_CODEC + struct.pack(">f", 2.0))
    assert one.settled == one.taken == 2
    for index in range(1000, 1050):
        one.move(1000 * index, (0.0,))
        assert one.reconstruct(0) == (2.0,)


def test_the_largest_model_fits_a_datagram():
    full = LayerAhead(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, (1.0, 0.0, 0.0), True, 1.0, 1.0)
    assert len(pack_model([full] * MOST_LAYERS, 3)) == 2 + 8 * 53 <= 1024


def test_a_position_says_which_layers_are_pierced():
    assert read_state(with_state(5, b"abcd")) == (5, b"abcd")
    with pytest.raises(PeerError):
        read_state(b"")
