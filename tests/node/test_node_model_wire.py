"""Payloads with models: golden vectors, and nothing but a PeerError for anything else."""

import json
import math
import struct
from pathlib import Path

import numpy as np
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
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Force, unpack_hello, unpack_position
from hapticnet.protocol.wire import Kind
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead
from tests.peers import GRANT, SESSION, HandSlave, Still
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


@pytest.mark.plain
def test_a_flood_of_new_models_begins_few_of_them_between_two_positions(monkeypatch):
    begun, made, one = [], decoders.ContactModel, passed()
    monkeypatch.setattr(decoders, "ContactModel", lambda *call: begun.append(1) or made(*call))
    for index in range(1000, 1010):
        begun.clear()
        one.move(1000 * index, (0.0,))
        for _ in range(100):
            one.decode(1000 * index, pack_model(FULL, 1))
        assert 0 < len(begun) <= 1 + MOST_PLAYED // (decoders.COST_OF_BEGINNING * (1 + MOST_LAYERS))


def test_what_was_applied_goes_on_until_a_model_has_caught_up_and_only_the_newest_waits_for_it():
    one = passed()
    one.decode(0, OF_CODEC + struct.pack(">f", 2.0))
    newest = passed()
    for force_n in (1.0, 2.0, 3.0):
        one.decode(0, pack_model([*FULL[1:], LayerAhead(-0.02, 100.0, force_n)], 1))
    newest.decode(0, pack_model([*FULL[1:], LayerAhead(-0.02, 100.0, 3.0)], 1))
    assert (one.taken, one.settled) == (3, 0)
    assert one.reconstruct(0) == (2.0,)
    settled = []
    for index in range(1000, 1100):
        one.move(1000 * index, (0.0,))
        newest.move(1000 * index, (0.0,))
        settled.append(one.settled)
    assert sorted(set(settled)) == [0, 1, 3]
    assert (one.state, one.reconstruct(0)) == (newest.state, newest.reconstruct(0))


def test_a_payload_of_the_codec_replaces_the_models_that_have_not_caught_up():
    one = passed()
    for _ in range(2):
        one.decode(0, pack_model(FULL, 1))
    one.decode(0, OF_CODEC + struct.pack(">f", 2.0))
    assert one.settled == one.taken == 2
    for index in range(1000, 1050):
        one.move(1000 * index, (0.0,))
        assert one.reconstruct(0) == (2.0,)
    one.decode(0, pack_model(FULL, 1))
    for index in range(1050, 1150):
        assert one.settled == (3 if one.on_model else 2), "none of the replaced ones comes back"
        one.move(1000 * index, (0.0,))
    assert one.on_model


def test_the_largest_model_fits_a_datagram():
    full = LayerAhead(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, (1.0, 0.0, 0.0), True, 1.0, 1.0)
    assert len(pack_model([full] * MOST_LAYERS, 3)) == 2 + 8 * 53 <= 1024


def test_a_position_says_which_layers_are_pierced():
    assert read_state(with_state(5, b"abcd")) == (5, b"abcd")
    with pytest.raises(PeerError):
        read_state(b"")


ANNOUNCED = GRANT._replace(announced=True)
PIERCED = LayerAhead(0.0, 100.0, 0.5)
WHOLE = LayerAhead(0.0, 100.0)
MODEL = pack_model([PIERCED] * (MOST_LAYERS - 1) + [WHOLE], 1)


STATE, MODEL_N = 0x7F, 1.0


def held(force_n):
    return OF_CODEC + struct.pack(">f", force_n)


class Ends:
    """A master, and its slave by hand, at one time."""

    def __init__(self, operator=None, **settings):
        settings = MasterSettings(codec="raw", announced=True, **settings)
        self.master = MasterNode(operator or Still(0.01), None, settings, np.random.default_rng(1))
        self.slave = HandSlave(self.master).connect(grant=ANNOUNCED)
        self.now_us = self.sequence = 0

    def used(self):
        """Let some time pass in which the slave answers with 2 N."""
        for ms in range(300):
            self.tick()
            if not ms % 50:
                self.force(held(2.0))
        return self

    def tick(self):
        """Tick the master; return the FORCE that its position acknowledges, and the state."""
        self.now_us += 1000
        self.master.tick(self.now_us)
        self.master.drive(self.now_us)
        said = None
        for datagram in self.slave.said():
            if datagram.kind is Kind.POSITION:
                position = unpack_position(datagram.body)
                said = position.newest, read_state(position.payload)[0]
            elif not unpack_hello(datagram.body).cookie:
                self.slave.cookie(datagram, self.now_us)
            else:
                self.slave.welcome(datagram, self.now_us, ANNOUNCED._replace(session=SESSION + 1))
                self.sequence = 0
        return said

    def force(self, payload, *, ago_ms=0, sequence=None):
        """Let a FORCE arrive that answers a position of some time ago; return its number."""
        self.sequence += sequence is None
        number = self.sequence if sequence is None else sequence
        self.slave.say(Kind.FORCE, number, Force(self.now_us - 1000 * ago_ms, payload), self.now_us)
        return number

    def until(self, sequence, other):
        """Tick until a model is acknowledged; return the forces before. Until then, every position says `other`."""
        forces_n = []
        for _ in range(50):
            forces_n.append(self.master.received_n[0])
            if (said := self.tick()) != other:
                assert said == (sequence, STATE)
                assert len(forces_n) > 2, "it must have taken some ticks"
                assert self.master.on_model
                assert self.master.received_n == (pytest.approx(MODEL_N, rel=1e-6),)
                return forces_n
        raise AssertionError("the model never caught up")

    def change(self):
        """Let the master have another session."""
        self.master.change(law=WeberLaw(multiplier=2.0))
        for _ in range(3):
            self.tick()
        assert self.master.connections == 2


def test_a_late_model_is_acknowledged_with_its_state_once_it_has_caught_up():
    ends = Ends().used()
    before = ends.sequence
    model = ends.force(MODEL, ago_ms=250)
    assert set(ends.until(model, (before, 0))) == {2.0}


def test_a_force_that_a_late_model_has_overtaken_is_dropped():
    ends = Ends().used()
    before = ends.sequence
    ends.force(MODEL, ago_ms=250, sequence=before + 2)
    ends.force(held(4.0), sequence=before + 1)
    assert set(ends.until(before + 2, (before, 0))) == {2.0}


def test_of_the_models_that_arrive_meanwhile_only_the_newest_is_applied_after_it():
    ends = Ends().used()
    before = ends.sequence
    first, _, newest = (ends.force(MODEL, ago_ms=250) for _ in range(3))
    ends.until(first, (before, 0))
    ends.until(newest, (first, STATE))


def test_a_payload_of_the_codec_is_applied_at_once_in_place_of_a_late_model():
    ends = Ends().used()
    ends.force(MODEL, ago_ms=250)
    newest = ends.force(held(3.0))
    for _ in range(50):
        assert ends.tick() == (newest, 0)
        assert ends.master.received_n == (3.0,)


def test_a_malformed_model_that_arrives_meanwhile_counts_and_changes_nothing():
    ends = Ends().used()
    before = ends.sequence
    model = ends.force(MODEL, ago_ms=250)
    ends.force(MODEL[:-1], ago_ms=250)
    assert ends.master.session.received.malformed == 1
    ends.until(model, (before, 0))


def test_a_late_model_of_the_session_before_is_applied_and_not_acknowledged_to_the_new_one():
    ends = Ends().used()
    ends.force(MODEL, ago_ms=280)
    ends.change()
    assert not ends.master.on_model
    for _ in range(50):
        assert ends.tick() == (None, 0)
    assert ends.master.on_model, "it is that of the session before"


def test_the_session_before_goes_on_until_the_first_model_of_the_new_one_has_caught_up():
    ends = Ends().used()
    ends.change()
    for _ in range(150):
        ends.tick()
    model = ends.force(MODEL, ago_ms=140)
    assert set(ends.until(model, (None, 0))) == {2.0}


@pytest.mark.parametrize("positions", ["raw", "line"])
def test_no_flood_of_old_models_makes_a_tick_play_more_than_is_allowed(monkeypatch, positions):
    costs, step = [], ContactModel.step

    def counted(model, t_us, position):
        costs.append(1 + MOST_LAYERS)
        return step(model, t_us, position)

    monkeypatch.setattr(ContactModel, "step", counted)
    ends = Ends(ScriptedOperator(InsertionSettings(), np.random.default_rng(1)), positions=positions)
    largest = 0
    for _ in range(1200):
        costs.clear()
        ends.tick()
        for _ in range(20):
            ends.force(MODEL, ago_ms=min(900, ends.now_us // 1000))
        largest = max(largest, sum(costs))
    # Besides: the model that is applied, and what it predicts, at both places of the tool.
    assert MOST_PLAYED <= largest <= MOST_PLAYED + 6 * (1 + MOST_LAYERS)
    assert ends.master.report()["ticks_on_model"] > 500
