"""A model that has many positions to catch up with: until it has, the force before goes on and is acknowledged."""

import struct

import numpy as np
import pytest

from hapticnet.node.decoders import MOST_PLAYED, OF_CODEC, pack_model, read_state
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Force, unpack_hello, unpack_position
from hapticnet.protocol.wire import Kind
from hapticnet.samples import PositionSample
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead
from tests.peers import GRANT, SESSION, HandSlave

ANNOUNCED = GRANT._replace(announced=True)
PIERCED = LayerAhead(0.0, 100.0, 0.5)
WHOLE = LayerAhead(0.0, 100.0)
MODEL = pack_model([PIERCED] * (MOST_LAYERS - 1) + [WHOLE], 1)
STATE, MODEL_N = 0x7F, 1.0


class Still:
    """An operator who does not move."""

    axes, duration_us = 1, None

    def sample(self, elapsed_us):
        return PositionSample(elapsed_us, (0.01,))


def held(force_n):
    return OF_CODEC + struct.pack(">f", force_n)


class Ends:
    """A master, and its slave by hand, at one time."""

    def __init__(self, operator=None, **settings):
        settings = MasterSettings(codec="raw", announced=True, **settings)
        self.master = MasterNode(operator or Still(), None, settings, np.random.default_rng(1))
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
