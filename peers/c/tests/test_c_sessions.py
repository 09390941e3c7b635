"""Pairs of sessions in virtual time, for what peers/conformance cannot reach, and a hand that loses its place."""

import math
from typing import Any

import msgpack
import numpy as np

import peer
from conformance.scenes import Hand, Spring
from conformance.session import NETWORKS, WRAP_US
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.codec.registry import codec_parameters, every_codec, make_codec
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import UserOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.handshake import SealedDoor
from hapticnet.protocol.keys import NO_PSK, Roster
from hapticnet.protocol.wire import SEALED
from tests.peers import ENTRY, SLAVE


class Watched:
    """A channel that notes what is sent, and may be closed for some time."""

    def __init__(self, network, seed):
        self.emulator = Emulator(parse_channel(network), np.random.default_rng(seed))
        self.log, self.shut = [], ()
        self.due, self.next_timer_us = self.emulator.due, self.emulator.next_timer_us

    def push(self, item, size, now_us):
        self.log.append((now_us, item))
        if not any(first <= now_us < last for first, last in self.shut):
            self.emulator.push(item, size, now_us)


class Felt:
    """A master that notes every force that it applies."""

    def __init__(self, master):
        self.master, self.forces, self.drive_ = master, [], master.drive
        master.drive = self.drive

    def drive(self, now_us):
        self.drive_(now_us)
        self.forces.append((now_us, [x.hex() for x in self.master.held_n]))


def in_python(codec, axes, rate_hz, seed, parameters, key=None, more=None):
    operator = UserOperator(Hand(axes))
    more = dict(more or {})
    if "position_share" in more:
        more["positions"] = "line"
    settings = MasterSettings(
        codec=codec, parameters=parameters, law=WeberLaw(**peer.LAW), rate_hz=rate_hz, name="same", key=key, **more
    )
    return MasterNode(operator, None, settings, np.random.default_rng(seed))


def in_c(lib, codec, axes, rate_hz, seed, parameters, key=None, more=None):
    rng = np.random.default_rng(seed)
    given = codec_parameters(make_codec(codec, WeberLaw(**peer.LAW), parameters))
    master = peer.Master(
        lib,
        lambda: int(rng.integers(0, 1 << 32)),
        Hand(axes).sample,
        codec=codec,
        parameters=given,
        rate_hz=rate_hz,
        axes=axes,
        name="same",
        **(more or {}),
    )
    assert master.wrong is None
    if key is not None:
        psk = None if key.own.psk == NO_PSK else key.own.psk
        assert master.seal(key.own.private, key.peer, psk)
    return master


def contents(sent):
    """Return time and fields of a HELLO: hapticnet writes a whole parameter as an integer, C as a float."""
    now_us, data = sent
    fields = msgpack.unpackb(msgpack.unpackb(data)[4])
    return now_us, fields[:2], msgpack.unpackb(fields[2])


class Pair:
    """The same session, once with a master in Python and once with one in C."""

    def __init__(
        self,
        lib,
        network="perfect",
        codec="deadband",
        *,
        axes=1,
        rate_hz=1000.0,
        slave=None,
        key=None,
        masters=(ENTRY,),
        more=None,
        scene=None,
        **parameters,
    ):
        self.loops, self.felt = [], []
        asked = codec, axes, rate_hz, 1, parameters, key, more
        for master in (in_python(*asked), in_c(lib, *asked)):
            rng = np.random.default_rng(5)
            doors = None if key is None else {SEALED: SealedDoor(SLAVE.private, Roster(masters), rng)}
            node = SlaveNode(lambda _: (scene or Spring)(axes), SlaveSettings(**(slave or {})), rng, doors=doors)
            forward, back = Watched(NETWORKS[network], 6), Watched(NETWORKS[network], 7)
            self.felt.append(Felt(master))
            self.loops.append(Loopback(master, node, forward=forward, feedback=back, start_us=WRAP_US))
        self.of_python, self.of_c = self.loops

    def run(self, seconds):
        for loop in self.loops:
            loop.run(round(1e6 * seconds))

    def each(self, action: Any) -> None:
        for loop in self.loops:
            action(loop)

    def shut(self, first_s, last_s, *, forward=True, back=True):
        for loop in self.loops:
            times = loop.now_us + round(1e6 * first_s), loop.now_us + round(1e6 * last_s)
            loop.forward.shut += (times,) if forward else ()
            loop.feedback.shut += (times,) if back else ()

    def check(self, *, least_n=0.0):
        ours, theirs = (loop.forward.log for loop in self.loops)
        for mine, other in zip(theirs, ours, strict=True):
            assert mine == other or contents(mine) == contents(other)
        forces = [felt.forces for felt in self.felt]
        if self.of_c.master.state == "closed":  # at its last tick, hapticnet still applies what it held
            forces = [applied[:-1] for applied in forces]
        assert forces[0] == forces[1]
        received = self.of_python.master.session.received
        assert self.of_c.master.counts == (received.malformed, received.stray, received.too_old)
        assert self.of_python.master.session.state.value == self.of_c.master.state
        largest_n = max(math.hypot(*map(float.fromhex, force)) for _, force in self.felt[1].forces)
        assert largest_n >= least_n
        return largest_n


every_codec()  # those of examples/literature, too
# Not velocity-adaptive: hapticnet's master bounds the force of every codec whose encoder needs positions.
CODECS = [
    ("raw", {}), ("raw", {"step_n": 0.001}), ("deadband", {}), ("deadband", {"step_n": 0.002}), ("probabilistic", {}),
    ("merging", {}), ("level-crossing", {}), ("linear-predictive", {}), ("adaptive-predictive", {}),
    ("least-squares", {"step_n": 0.001}),
]  # fmt: skip


def test_a_hand_without_a_place_sends_no_position_until_it_has_one_again(lib):
    master = peer.Master(lib, lambda: 7, lambda t_us: (math.nan if 500_000 <= t_us < 1_000_000 else 0.02,))
    channels = Watched("delay=1ms", 1), Watched("delay=1ms", 2)
    slave = SlaveNode(lambda _: Spring(1), SlaveSettings(), np.random.default_rng(3))
    loop = Loopback(master, slave, forward=channels[0], feedback=channels[1])
    for seconds, state, force_n in ((0.4, "established", 3.0), (0.5, "stale", 0.0), (0.6, "established", 3.0)):
        loop.run(round(1e6 * seconds))
        assert (master.state, round(master.held_n[0], 3)) == (state, force_n)
