"""What an injector on the path of a sealed session can do: it copies, changes and repeats datagrams."""

import struct

import msgpack
import numpy as np
import pytest

from hapticnet.node.admission import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.events import Connected, ForceArrived, HoldConfirmed
from hapticnet.protocol.handshake import SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Request
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import SEALED, Kind
from hapticnet.scene.presets import find_scene
from hapticnet.scene.scene import Scene

HERE, THERE = ("192.0.2.1", 5000), ("192.0.2.66", 6000)
MASTER, SLAVE = PrivateKey(bytes([1] * 32)), PrivateKey(bytes([2] * 32))
REQUEST = Request("deadband", {}, 0.1, 0.02, 1.0, 1000.0, 1, "surgeon")


class Link:
    """A master and a slave, and whoever sits between them."""

    def __init__(self):
        roster = Roster([MasterEntry(name="surgeon", public=MASTER.public)])
        rng = np.random.default_rng(1)
        tissues = find_scene("paper:1")
        self.slave = SlaveNode(
            lambda _: Scene(tissues.tissues, name="three tissues"),
            SlaveSettings(),
            rng,
            doors={SEALED: SealedDoor(SLAVE.private, roster, rng)},
        )
        self.master = MasterSession(REQUEST, SessionSettings(), rng, MasterKey(MASTER, SLAVE.public))
        self.now_us = 1_000_000
        self.sent = []
        self.events = []

    def step(self, *, back=lambda data: [data]):
        """Run one millisecond; `back` stands between the slave and the master."""
        self.now_us += 1000
        self.master.tick(self.now_us)
        self.master.send_position(self.now_us, struct.pack(">f", 0.001))
        for data in self.master.datagrams_to_send():
            self.sent.append(data)
            self.slave.receive_datagram(data, HERE, self.now_us)
        for data, address in self.slave.datagrams_to_send():
            if address == HERE:
                for passed in back(data):
                    self.master.receive_datagram(passed, self.now_us)
        for data in self.master.datagrams_to_send():
            self.slave.receive_datagram(data, HERE, self.now_us)
            for answer, _ in self.slave.datagrams_to_send():
                for passed in back(answer):
                    self.master.receive_datagram(passed, self.now_us)
        while (event := self.master.next_event()) is not None:
            if isinstance(event, ForceArrived):
                self.master.applied(event)
            self.events.append(event)


@pytest.fixture
def link():
    made = Link()
    made.step()
    assert [type(event) for event in made.events] == [Connected]
    return made


@pytest.mark.parametrize("forged", [1, 5000, 2**31, 2**32 - 1])
def test_a_welcome_whose_frame_was_changed_deafens_nobody(forged):
    link = Link()

    def change(data):
        frame = msgpack.unpackb(data)
        if frame[1] == Kind.WELCOME:
            frame[2:4] = [12345, forged]
        return [msgpack.packb(frame)] if frame[1] == Kind.WELCOME else [data]

    for _ in range(100):
        link.step(back=change)
    assert [type(event) for event in link.events[:2]] == [Connected, ForceArrived]
    assert any(isinstance(event, HoldConfirmed) for event in link.events)
    assert link.master.received.late == 0


def test_copies_of_true_positions_do_not_use_up_the_granted_rate(link):
    for _ in range(3000):
        link.step()
        for _ in range(3):
            link.slave.receive_datagram(link.sent[-1], HERE, link.now_us)
    (station,) = link.slave.stations
    assert station.session.received.duplicate >= 8000
    assert station.session.received.over_rate == 0


def test_a_copy_from_another_address_moves_nothing(link):
    link.step()
    link.slave.receive_datagram(link.sent[-1], THERE, link.now_us)
    (station,) = link.slave.stations
    assert station.address == HERE
