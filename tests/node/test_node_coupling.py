"""Couplings in sessions: one at the master alone, and one with an end at each side."""

import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from hapticnet.api.link import virtual_link
from hapticnet.control import couplings
from hapticnet.errors import PeerError, SettingsError, UnavailableError
from hapticnet.node.coupled import CouplingFailedError
from hapticnet.node.events import HeldBack
from hapticnet.node.settings import MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet.samples import PositionSample
from hapticnet.scene.settings import SceneSettings, Tissue

SECOND = 1_000_000


@dataclass(frozen=True)
class Offset:
    """A toy: the master says where the tool is moved to, the slave by how much it was; forces are halved and back."""

    name: ClassVar[str] = "offset"
    by_m: float = 0.002

    def forward_bytes(self, axes):
        return 8 * axes

    def feedback_bytes(self, _axes):
        return 4

    def master(self, _port):
        return OffsetMaster(self)

    def slave(self, _port):
        return OffsetSlave()


class OffsetMaster:
    def __init__(self, coupling):
        self.by_m, self.heard, self.held_back, self.counts = coupling.by_m, [], 0, True

    def outgoing(self, position_m, _now_us):
        return struct.pack(f">{len(position_m)}d", *(self.by_m for _ in position_m))

    def incoming(self, data):
        self.heard.append(struct.unpack(">f", data)[0])

    def limit(self, force_n, _position_m, _now_us, *, follows):  # noqa: ARG002
        self.held_back += self.counts
        return tuple(2.0 * component for component in force_n)

    def report(self):
        return {}


class OffsetSlave:
    def command(self, position_m, _t_us, data):
        moved = struct.unpack(f">{len(position_m)}d", data)
        if moved[0] > 1.0:
            raise PeerError("moved too far")
        self.moved = moved[0]
        return tuple(x + by for x, by in zip(position_m, moved, strict=True))

    def answer(self, force_n):
        return tuple(0.5 * component for component in force_n), struct.pack(">f", self.moved)


class Still:
    axes, duration_us = 1, 10 * SECOND

    def sample(self, t_us):
        return PositionSample(t_us, (0.003,))


def wall(stiffness):
    layer = Tissue(name="wall", rest_position_m=0.0, stiffness_n_per_m=stiffness, breach_force_n=1e6)
    return SceneSettings(name=f"wall {stiffness:g}", tissues=(layer,))


pytestmark = pytest.mark.usefixtures("offset")


@pytest.fixture
def offset(monkeypatch):
    monkeypatch.setitem(couplings._installed, "offset", Offset)


@pytest.mark.parametrize("codec", ["raw", "deadband", "motion-predictive"])
def test_a_coupling_moves_the_tool_and_changes_the_force_on_both_sides(make_wall, codec):
    link = virtual_link(scene=make_wall(200.0), codec=codec, operator=Still(), coupling="offset:by_m=0.002")
    link.run(seconds=1.0)
    master, slave = link.master_samples(), link.slave_samples()
    assert master["held_n"][-1] == pytest.approx(200.0 * 0.005, rel=0.06)
    assert slave["force_n"][-1] == pytest.approx(200.0 * 0.005)
    assert slave["position_m"][-1] == pytest.approx(0.003), "the codec goes on from the received position"
    assert link.report().forward_wire_bytes / link.report().samples > 8.0 + 20.0


def test_without_loss_the_codec_keeps_its_law_on_the_coupled_vector(make_wall):
    hand = YieldingOperator(Still(), HANDS["arm"])
    link = virtual_link(scene=make_wall(50.0), codec="deadband", operator=hand, coupling="offset")
    link.run(seconds=2.0)
    assert link.report().exceed_jnd_fraction == 0.0


@pytest.mark.parametrize("way", [{"announced": True}, {"predicted": True}, {"positions": "line"}])
def test_a_coupling_with_two_ends_needs_every_position_at_its_own_place(way):
    with pytest.raises(SettingsError, match="cannot be combined"):
        MasterSettings(coupling="offset", **way)


def test_a_slave_refuses_a_coupling_that_it_does_not_know(make_wall, monkeypatch):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    monkeypatch.delitem(couplings._installed, "offset")
    link.run(seconds=0.5)
    master = link._loopback.master
    assert master.refused
    assert "unknown coupling 'offset'" in master.end_reason


def test_bad_data_of_a_coupling_is_counted_and_answered_with_nothing(make_wall):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset:by_m=2")
    link.run(seconds=0.2)
    (context,) = link._loopback.slave.contexts
    assert context.session.received.malformed > 100
    assert context.steps == 0
    assert not link.master_samples()["held_n"].any()


def test_a_coupling_that_fails_ends_the_session_without_a_force(make_wall, monkeypatch):
    def fails(*_, **__):
        raise RuntimeError("no more")

    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    link.run(seconds=0.2)
    monkeypatch.setattr(OffsetMaster, "limit", fails)
    with pytest.raises(UnavailableError, match="the coupling failed: RuntimeError: no more"):
        link.run(seconds=0.2)
    assert link.master_samples()["held_n"][-1] == 0.0


@pytest.mark.parametrize("method", ["forward_bytes", "feedback_bytes", "master"])
def test_a_coupling_that_cannot_be_made_at_the_master_is_one_line(make_wall, monkeypatch, method):
    monkeypatch.setattr(Offset, method, lambda *_: 1 / 0)
    with pytest.raises(CouplingFailedError, match="the coupling failed: ZeroDivisionError"):
        virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")


@pytest.mark.parametrize(
    ("method", "length"), [("forward_bytes", 2.5), ("feedback_bytes", -1), ("feedback_bytes", "4")]
)
def test_an_impossible_length_of_data_is_refused_at_both_sides(make_wall, monkeypatch, method, length):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    monkeypatch.setattr(Offset, method, lambda *_: length)
    link.run(seconds=0.2)
    assert link._loopback.master.refused
    assert "the coupling failed" in link._loopback.master.end_reason
    with pytest.raises(CouplingFailedError, match="the coupling failed"):
        virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")


def test_an_end_without_a_count_of_what_it_held_back_is_named(make_wall, monkeypatch):
    monkeypatch.setattr(Offset, "master", lambda *_: OffsetSlave())
    with pytest.raises(CouplingFailedError, match="'OffsetSlave' object has no attribute 'held_back'"):
        virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")


@pytest.mark.parametrize("broken", ["incoming", "outgoing"])
def test_the_coupling_is_blamed_for_its_data_and_not_the_codec(make_wall, monkeypatch, broken):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    monkeypatch.setattr(OffsetMaster, broken, lambda *_: 1 / 0)
    with pytest.raises(UnavailableError, match="the session ended: the coupling failed: ZeroDivisionError"):
        link.run(seconds=0.2)


def test_data_of_another_length_than_stated_ends_the_session(make_wall, monkeypatch):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    monkeypatch.setattr(OffsetMaster, "outgoing", lambda *_: b"abc")
    with pytest.raises(UnavailableError, match="its data is b'abc'; it must have 8 bytes"):
        link.run(seconds=0.2)


def test_a_master_whose_next_session_cannot_have_an_end_fails_in_one_line(make_wall, monkeypatch):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    link.run(seconds=0.2)
    monkeypatch.setattr(Offset, "master", lambda *_: 1 / 0)
    link._loopback.master.change(codec="raw")
    with pytest.raises(UnavailableError, match="the coupling failed: ZeroDivisionError"):
        link.run(seconds=0.2)


def test_a_coupling_with_a_slave_and_no_lengths_is_refused_by_name(monkeypatch):
    monkeypatch.delattr(Offset, "feedback_bytes")
    with pytest.raises(SettingsError, match=r"'offset' has slave\(\), so it needs forward_bytes\(\) and feedback_b"):
        MasterSettings(coupling="offset")


def test_an_arm_that_oscillates_over_a_delay_comes_to_rest_within_the_bound(make_wall):
    swings = {}
    for coupling in ("direct", "energy-bounded"):

        class Press(Still):
            def sample(self, t_us):
                return PositionSample(t_us, (min(t_us * 1e-6, 1.0) * 0.03 - 0.005,))

        link = virtual_link(
            scene=make_wall(500.0), forward="delay=25ms", feedback="delay=25ms", coupling=coupling,
            operator=YieldingOperator(Press(), HANDS["arm"]),
        )  # fmt: skip
        link.run(seconds=4.0)
        swings[coupling] = np.ptp(link.master_samples()["position_m"][-1000:])
        report = link.report().master["coupling"]
    assert swings["direct"] > 0.05
    assert swings["energy-bounded"] < 2e-4
    assert report["name"] == "energy-bounded"
    assert report["held_back_share"] > 0.1


@pytest.mark.parametrize("returned", [(float("nan"),), (1.0, 2.0), None, "1 N"])
def test_what_a_coupling_returns_is_checked(make_wall, monkeypatch, returned):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    link.run(seconds=0.2)
    monkeypatch.setattr(OffsetMaster, "limit", lambda *_, **__: returned)
    with pytest.raises(UnavailableError, match="the coupling failed"):
        link.run(seconds=0.2)
    assert link.master_samples()["held_n"][-1] == 0.0


def test_no_coupling_asks_for_more_than_the_device_can_render(make_wall):
    class Weak(Still):
        max_force_n = 0.7

    link = virtual_link(scene=make_wall(200.0), operator=Weak(), coupling="offset")
    link.run(seconds=1.0)
    assert link.master_samples()["held_n"].max() == pytest.approx(0.7)


@pytest.mark.parametrize("returned", [((1.0,), b""), ((1.0, 2.0), b"1234"), ((float("nan"),), b"1234"), None])
def test_a_coupling_that_fails_at_the_slave_ends_the_session_and_both_are_told(make_wall, monkeypatch, returned):
    monkeypatch.setattr(OffsetSlave, "answer", lambda *_: returned)
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    with pytest.raises(UnavailableError, match="the coupling failed"):
        link.run(seconds=0.2)


def test_a_coupling_that_cannot_be_made_refuses_the_session(make_wall, monkeypatch):
    monkeypatch.setattr(Offset, "slave", lambda *_: 1 / 0)
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset")
    link.run(seconds=0.2)
    assert link._loopback.master.refused
    assert "the coupling failed" in link._loopback.master.end_reason


def test_a_change_of_session_keeps_the_end_of_the_forces_that_are_applied(make_wall):
    link = virtual_link(scene=make_wall(200.0), operator=Still(), coupling="offset", forward="delay=20ms")
    link.run(seconds=1.0)
    master = link._loopback.master
    before = master._coupling._applied
    master.change(codec="raw")
    link.run(seconds=0.05)
    link.run(seconds=0.5)
    assert master._coupling._applied is not before
    held_n = link.master_samples()["held_n"][500:]
    assert np.ptp(held_n) < 0.05 * held_n.mean()


@pytest.mark.plain
def test_a_hand_feels_no_force_once_its_session_is_lost(make_wall, monkeypatch):
    class Feels(Still):
        felt = ()

        def feel(self, _t_us, force_n):
            self.felt = (*self.felt[-1:], force_n[0])

    hand = Feels()
    link = virtual_link(scene=make_wall(200.0), operator=hand)
    link.run(seconds=1.0)
    assert hand.felt[-1] > 0.5
    monkeypatch.setattr(SlaveNode, "receive_datagram", lambda *_: None)
    link._loopback.slave.close("done", link._loopback.now_us)
    link._loopback.run(SECOND)
    assert not link._loopback.master.session.streaming
    assert hand.felt[-1] == 0.0


def test_the_operator_is_told_that_the_force_is_held_back_and_again_after_a_while_without(make_wall):
    link = virtual_link(scene=make_wall(100.0), operator=Still(), coupling="offset")
    master = link._loopback.master
    told = []
    for number in range(200):
        link.run(seconds=0.1)
        master._coupling._applied.counts = not 100 <= number < 160
        master.check(link._loopback.now_us)
        while (event := master.next_event()) is not None:
            told += [number] if isinstance(event, HeldBack) else []
    assert len(told) == 2
    assert told[0] < 10
    assert told[1] >= 150


@pytest.fixture
def make_wall():
    from hapticnet.scene.sources import make_scene

    return lambda stiffness: make_scene(wall(stiffness))
