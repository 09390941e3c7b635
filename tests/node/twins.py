"""A plain slave and one with a bank, which get the same datagrams, and masters and an adversary that send them."""

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.compiled_slave import CompiledSlaveNode
from hapticnet.node.master import MasterNode
from hapticnet.node.master_settings import MasterSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.handshake import OpenDoor, SealedDoor
from hapticnet.protocol.keys import Roster
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import unpack
from hapticnet.scene.presets import paper_scene
from hapticnet.scene.scene import Scene
from tests.peers import ENTRY, KEY, SLAVE, Interned

START_US = 10_000_000
TICK_US = 250

MASTERS = (
    {"codec": "deadband"},
    {"codec": "raw"},
    {"codec": "deadband", "parameters": {"step_n": 0.01}},
    {"codec": "raw", "parameters": {"step_n": 0.001}},
    {"codec": "deadband", "positions": "line"},
    {"codec": "raw", "positions": "line"},
    {"codec": "linear-predictive"},
    {"codec": "motion-predictive", "positions": "line"},
    {"codec": "deadband", "announced": True},
)
HAND = {"insertions": 3, "approach_s": 0.2, "push_s": 0.4, "withdraw_s": 0.3}


class Twins:
    """Both slaves. What they answer must be equal."""

    def __init__(self, seed, *, is_compiled=True, make_scene=None, first_sequence=0, **settings):
        self.datagrams = 0
        self.slaves = []
        session = SessionSettings(most_per_identity=64, first_sequence=first_sequence, **settings)
        for make, others in (
            (SlaveNode, {}),
            (CompiledSlaveNode, {"addresses": Interned(), "is_compiled": is_compiled}),
        ):
            rng = np.random.default_rng(seed)
            doors = {1: OpenDoor(), 2: SealedDoor(SLAVE.private, Roster([ENTRY]), rng)}
            scene = make_scene(seed) if make_scene else lambda _: Scene(paper_scene(1).tissues)
            self.slaves.append(make(scene, SlaveSettings(session=session), rng, doors=doors, **others))
        self.plain, self.banked = self.slaves

    def to(self, batch, now_us):
        """Pass a batch of (datagram, address) to both; return what both answer."""
        for slave in self.slaves:
            slave.receive_datagrams(batch, now_us)
        return self._collect(now_us)

    def tick(self, now_us):
        """Let both do what is due."""
        for slave in self.slaves:
            slave.tick(now_us)
        return self._collect(now_us)

    def close(self, now_us):
        """End all sessions of both."""
        for slave in self.slaves:
            slave.close("done", now_us)
        return self._collect(now_us)

    def _collect(self, now_us):
        both = []
        for slave in self.slaves:
            sent = slave.datagrams_to_send()
            slave.settle(now_us)
            sent += slave.datagrams_to_send()
            in_order = {}  # of each session: between sessions, the order does not matter
            for data, address in sent:
                datagram = unpack(data)
                in_order.setdefault((address, datagram.version, datagram.session), []).append(data)
            both.append(in_order)
        plain, banked = both
        for key in plain | banked:
            ours, theirs = ([data.hex() for data in sent.get(key, ())] for sent in (banked, plain))
            assert ours == theirs, f"at {now_us} to {key}: {ours} instead of {theirs}"
        answers = {}
        for (address, _, _), datagrams in plain.items():
            answers.setdefault(address, []).extend(datagrams)
            self.datagrams += len(datagrams)
        return answers

    def check_reports(self):
        """Compare all accounts."""
        assert self.banked.totals() == self.plain.totals()
        plain, banked = (slave.report() for slave in self.slaves)
        for each in (plain, banked):
            each["sessions"].sort(key=lambda session: session["session"])
        for ours, theirs in zip(banked.pop("sessions"), plain.pop("sessions"), strict=True):
            assert ours == theirs, f"{set(map(str, ours.items())) ^ set(map(str, theirs.items()))}"
        assert banked == plain, f"{banked} instead of {plain}"


class Crowd:
    """Masters of all kinds behind networks that lose, copy, delay and reorder.

    The adversary `spoil` gets each batch that would arrive at the slaves and returns what arrives.
    """

    def __init__(self, twins, seed, *, masters=MASTERS, sealed=(False, True), network="delay=8ms", spoil=None):
        self.twins = twins
        self.now_us = START_US
        self.rng = np.random.default_rng([seed, 9])
        self.spoil = spoil or (lambda batch, _: batch)
        self.ends = []
        self.jump_us = 0
        for number, settings in enumerate([each for each in masters for _ in sealed]):
            rng = np.random.default_rng([seed, number])
            operator = ScriptedOperator(InsertionSettings(**HAND), rng)
            key = KEY if sealed[number % len(sealed)] else None
            master = MasterNode(operator, None, MasterSettings(key=key, name=f"m{number}", **settings), rng)
            channels = [Emulator(parse_channel(network), np.random.default_rng([seed, number, way])) for way in (1, 2)]
            self.ends.append(((f"host {number}", number), master, *channels))

    def run(self, milliseconds):
        """Advance all masters and both slaves."""
        for _ in range(milliseconds):
            for _, master, forward, _ in self.ends:
                master.tick(self.now_us)
                master.drive(self.now_us)
                for data in master.datagrams_to_send():
                    forward.push(data, len(data), self.now_us)
            for _ in range(1000 // TICK_US):
                self.now_us += TICK_US
                batch = [(data, address) for address, _, forward, _ in self.ends for data in forward.due(self.now_us)]
                self._back(self.twins.to(self.spoil(batch, self.rng), self.slaves_us))
                due = [us for us in (slave.next_timer_us() for slave in self.twins.slaves) if us is not None]
                if due and min(due) <= self.slaves_us:
                    self._back(self.twins.tick(self.slaves_us))

    @property
    def slaves_us(self):
        """The clock of the slaves."""
        return self.now_us + self.jump_us

    def _back(self, answers):
        for address, master, _, feedback in self.ends:
            for data in answers.get(address, ()):
                feedback.push(data, len(data), self.now_us)
            for data in feedback.due(self.now_us):
                master.receive_datagram(data, self.now_us)
