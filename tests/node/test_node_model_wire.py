"""Payloads with models: golden vectors, and nothing but a PeerError for anything else."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.errors import PeerError
from hapticnet.node.announced import AnnouncedDecoder
from hapticnet.node.model_wire import pack_model, read_state, unpack_model, with_state
from hapticnet.scene.ahead import MOST_LAYERS, LayerAhead
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
        assert one.models == 1
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


def test_a_flood_of_models_is_refused_until_the_next_position():
    one, payload = moved(), pack_model([SPRING], 1)
    for _ in range(4):
        one.decode(0, payload)
    with pytest.raises(PeerError, match="more models"):
        one.decode(0, payload)
    one.move(2000, (0.022,))
    one.decode(0, payload)
    assert one.reconstruct(0) == (pytest.approx(1.0, rel=1e-6),)


def test_the_largest_model_fits_a_datagram():
    full = LayerAhead(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, (1.0, 0.0, 0.0), True, 1.0, 1.0)
    assert len(pack_model([full] * MOST_LAYERS, 3)) == 2 + 8 * 53 <= 1024


def test_a_position_says_which_layers_are_pierced():
    assert read_state(with_state(5, b"abcd")) == (5, b"abcd")
    with pytest.raises(PeerError):
        read_state(b"")
