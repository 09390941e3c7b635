"""Masters and a slave of sealed sessions, datagram by datagram, for tests that stand between them."""

import struct

import numpy as np

from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Request
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import ForceArrived
from hapticnet.protocol.wire import SEALED
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene

SURGEON, STUDENT, SLAVE = (PrivateKey(bytes([number] * 32)) for number in (1, 2, 3))
ENTRIES = (MasterEntry(name="surgeon", public=SURGEON.public), MasterEntry(name="student", public=STUDENT.public))
REQUEST = Request("deadband", {}, 0.1, 0.02, 1.0, 1000.0, 1, "a name that nobody else has")


class Tap:
    """A slave that knows two masters, and the datagrams to and from it."""

    def __init__(self, entries=ENTRIES):
        preset = find_scene("paper:1")
        self.now_us = 1_000_000
        self.rng = np.random.default_rng(1)
        self.slave = SlaveNode(
            lambda _: Scene(preset.tissues, name=preset.name),
            SlaveSettings(),
            self.rng,
            doors={SEALED: SealedDoor(SLAVE.private, Roster(entries), self.rng)},
        )
        self.sent = []
        self.answers = []

    def master(self, key=SURGEON, request=REQUEST):
        return MasterSession(request, SessionSettings(), self.rng, MasterKey(key, SLAVE.public))

    def to_slave(self, data, address):
        """Pass one datagram to the slave; return its answers with their destinations."""
        self.slave.receive_datagram(data, address, self.now_us)
        return self.slave.datagrams_to_send()

    def step(self, master, address, *, back=lambda data: data):
        """Run a master for one millisecond; `back` stands between slave and master. Return its events."""
        self.now_us += 1000
        master.tick(self.now_us)
        master.send_position(self.now_us, struct.pack(">f", 0.001))
        while sent := master.datagrams_to_send():
            for data in sent:
                self.sent.append(data)
                for answer, to in self.to_slave(data, address):
                    self.answers.append(answer)
                    if to == address:
                        master.receive_datagram(back(answer), self.now_us)
        events = []
        while (event := master.next_event()) is not None:
            if isinstance(event, ForceArrived):
                master.applied(event)
            events.append(event)
        return events

    def run(self, master, address, milliseconds=100):
        """Run a master for some time. Return its events."""
        return [event for _ in range(milliseconds) for event in self.step(master, address)]
