"""Two equal ends of a session of which one is disturbed: what must not count leaves both the same, to the byte."""

import struct

import numpy as np

from hapticnet.node.admission import SMALLEST_SESSION
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.messages import Force, Keepalive
from hapticnet.protocol.wire import Kind, pack, pack_body
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene
from tests.conftest import make_slave
from tests.peers import GRANT, KEY, HandMaster, HandSlave

SESSION = 0xDEADBEEF
HERE = ("10.0.0.1", 1)


def seal_or_pack(seal, kind, sequence, message, session=SESSION):
    """Return a datagram of the session, whose body is that of a message or given as bytes."""
    body = message if isinstance(message, bytes) else pack_body(message)
    if seal is None:
        return pack(kind, session, sequence, body)
    seal._sent = -1
    return seal.pack(kind, session, sequence, body)


class Fixed:
    """Random numbers, but for the number of a session."""

    def __init__(self, seed):
        self._rng = np.random.default_rng(seed)

    def integers(self, low, high):
        return SESSION if low == SMALLEST_SESSION else self._rng.integers(low, high)


def slave_of_session(tissues=None):
    """Return a slave whose session has the number SESSION."""
    scene = tissues or paper_scene(1).tissues
    return make_slave(make_scene=lambda _: Scene(scene), sealed=None, rng=Fixed(1), record=False)


class Slaves:
    """A disturbed and an undisturbed slave, with a session each."""

    def __init__(self, *, sealed=False, line=False):
        self.now_us, self.sequence, self.line = 1000, 0, line
        self.said = []
        self.slaves = [slave_of_session() for _ in range(2)]
        share = 0.25 if line else 0.0
        self.masters = [HandMaster(each, HERE, sealed=sealed, position_share=share).join() for each in self.slaves]
        for _ in range(5):
            self.step()

    @property
    def disturbed(self):
        return self.slaves[0]

    @property
    def malformed(self):
        """Number of datagrams that the disturbed slave has counted as malformed."""
        return self.disturbed.unknown_peers.malformed + sum(
            each.session.received.malformed for each in self.disturbed.contexts
        )

    def pack(self, kind, message, sequence=None):
        """Return a datagram of the session, by default the next one."""
        master, sequence = self.masters[0], self.sequence + 1 if sequence is None else sequence
        return seal_or_pack(master.seal, kind, sequence, message)

    def step(self):
        """Send both the next position; both must answer the same."""
        self.now_us += 1000
        self.sequence += 1
        place = struct.pack(">f", 0.02 + 0.0002 * (self.sequence % 50)) + struct.pack(">e", 0.1) * self.line
        acknowledged = 1 if self.sequence > 2 else None
        said = []
        for master, slave in zip(self.masters, self.slaves, strict=True):
            data = master.pack(Kind.POSITION, self.sequence, (self.now_us, acknowledged, place))
            self.said.append(data)
            slave.receive_datagram(data, HERE, self.now_us)
            slave.tick(self.now_us + 500)
            slave.account_sent(self.now_us + 500)
            said.append((slave.datagrams_to_send(), slave.totals()))
        assert said[0] == said[1]

    def disturb(self, data, address=HERE):
        """Send a datagram to one of them; return the answers to it, none of which may be to the other's master."""
        self.disturbed.receive_datagram(data, address, self.now_us)
        answers = self.disturbed.datagrams_to_send()
        assert all(to == address for _, to in answers)
        assert sum(len(answer) for answer, _ in answers) <= len(data)
        return [answer for answer, _ in answers]


def make_master(*, sealed=False, line=False, **settings):
    operator = ScriptedOperator(InsertionSettings(), np.random.default_rng(1))
    more = {"key": KEY} if sealed else {}
    more |= {"positions": "line", "position_share": 0.25} if line else {}
    return MasterNode(operator, None, MasterSettings(codec="deadband", **more, **settings), np.random.default_rng(2))


class Masters:
    """A disturbed and an undisturbed master, with a session each."""

    def __init__(self, *, sealed=False, line=False):
        self.now_us, self.sequence = 0, 0
        self.masters = [make_master(sealed=sealed, line=line) for _ in range(2)]
        grant = GRANT._replace(session=SESSION, position_share=0.25 if line else 0.0)
        self.slaves = [HandSlave(each, sealed=sealed).connect(grant=grant) for each in self.masters]
        for _ in range(40):  # until the force has risen
            self.step()

    @property
    def disturbed(self):
        return self.masters[0]

    @property
    def malformed(self):
        """Number of datagrams that the disturbed master has counted as malformed."""
        return self.disturbed.session.received.malformed

    def pack(self, kind, message, sequence=None):
        """Return a datagram of the session, by default the next one."""
        return seal_or_pack(self.slaves[0].seal, kind, self.sequence + 1 if sequence is None else sequence, message)

    def step(self):
        """Tick both and send both the next force or keepalive; both must apply and say the same."""
        self.now_us += 1000
        self.sequence += 1
        message = Force(self.now_us, struct.pack(">f", 0.5 + 0.01 * (self.sequence % 40)))
        kind = Kind.FORCE if self.sequence % 3 else Kind.KEEPALIVE
        data = self.pack(
            kind, message if kind is Kind.FORCE else Keepalive(self.now_us, self.sequence - 1), self.sequence
        )
        said = []
        for master in self.masters:
            master.tick(self.now_us)
            master.receive_datagram(data, self.now_us)
            master.drive(self.now_us)
            events = list(iter(master.next_event, None))
            said.append((master.datagrams_to_send(), master.held_n, master.session.state, events))
        assert said[0] == said[1]

    def disturb(self, data, address=HERE):  # noqa: ARG002 - as `Slaves.disturb`: a master has one peer
        """Send a datagram to one of them; it must not be answered."""
        self.disturbed.receive_datagram(data, self.now_us)
        return self.disturbed.datagrams_to_send()
