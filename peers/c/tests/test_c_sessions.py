"""Live sessions of the C master in virtual time: it sends the same bytes and applies the same forces as hapticnet's."""

import ctypes
import math
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest

import peer
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
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import SEALED
from hapticnet.samples import ForceSample
from tests.peers import ENTRY, SLAVE

NETWORKS = {
    "perfect": "delay=0ms",
    "slow": "delay=40ms",
    "lossy": "delay=10ms,jitter=normal:4ms,loss=15%",
    "bursts": "delay=20ms,loss=gilbert:1%,12%,jitter=normal:5ms",
    "disorder": "delay=30ms,jitter=normal:12ms,reorder=5%,duplicate=5%",
    "near the end": "delay=480ms,jitter=normal:30ms,loss=5%",
    "too slow": "delay=700ms,jitter=normal:300ms",
}
WRAP_US = 2**32 - 1_500_000  # time stamps wrap after a second and a half


def hand(axes):
    """Return where the hand is after some time: it goes in and out, not the same on each axis."""
    return lambda t_us: tuple(0.02 * (1.0 - math.cos(t_us / 2e5 * (1 + i))) + 1e-4 * i for i in range(axes))


class Spring:
    """A spring of 300 N/m behind 10 mm, on each axis."""

    def __init__(self, axes):
        self.axes, self.name = axes, f"{axes} springs"

    def step(self, sample):
        return ForceSample(sample.t_us, tuple(300.0 * max(0.0, x - 0.01) for x in sample.position_m))


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
    operator = UserOperator(SimpleNamespace(axes=axes, sample=hand(axes)))
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
        hand(axes),
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


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("axes", [1, 3])
def test_each_datagram_is_equal_to_the_byte_and_each_force_to_the_bit(lib, network, axes):
    pair = Pair(lib, network, axes=axes)
    pair.run(4.0)
    pair.check(least_n=0.0 if network == "too slow" else 3.0)


@pytest.mark.parametrize(("codec", "parameters"), CODECS)
def test_every_codec_that_does_not_follow_the_hand_agrees_over_loss(lib, codec, parameters):
    pair = Pair(lib, "lossy", codec, axes=2, **parameters)
    pair.run(3.0)
    pair.check(least_n=3.0)


def stopped(loop, **settings):
    """Restart the slave of a loop: it knows no session any more."""
    axes = loop.master.axes
    loop.slave = SlaveNode(lambda _: Spring(axes), SlaveSettings(**settings), np.random.default_rng([9, 9]))


@pytest.mark.parametrize("ways", [{}, {"forward": False}, {"back": False}], ids=["both ways", "back", "forth"])
@pytest.mark.parametrize("seconds", [0.25, 0.9, 3.0, 8.0])
def test_a_silent_link_releases_the_force_and_recovers_or_is_asked_for_again(lib, seconds, ways):
    pair = Pair(lib, "lossy")
    pair.run(1.0)
    pair.shut(0.0, seconds, **ways)
    pair.run(seconds)
    assert pair.of_c.master.held_n == (0.0,) or seconds < 0.3
    pair.run(2.5)
    assert pair.of_c.master.state == "established"
    pair.check(least_n=3.0)


def test_a_restarted_slave_is_noticed_by_its_reset_and_asked_for_another_session(lib):
    pair = Pair(lib, "slow")
    pair.run(1.0)
    pair.each(stopped)
    pair.run(2.0)
    assert pair.of_c.master.state == "established"
    assert pair.of_c.slave.session_count == 1
    pair.check(least_n=3.0)


def test_a_close_of_the_slave_is_followed_by_another_session_and_the_force_by_its_force(lib):
    pair = Pair(lib, "disorder")
    pair.run(1.0)
    pair.each(lambda loop: loop.slave._end(loop.slave.contexts[0], "moved", loop.now_us))
    pair.run(1.0)
    assert (pair.of_c.master.state, pair.of_c.master.reason) == ("established", ("moved", 0))
    pair.check(least_n=3.0)


def test_a_failure_of_the_slave_ends_the_master_with_no_force(lib):
    pair = Pair(lib, "slow")
    pair.run(1.0)
    pair.each(lambda loop: loop.slave._end(loop.slave.contexts[0], "broken", loop.now_us, code=Code.FAILED))
    pair.run(1.0)
    master = pair.of_c.master
    assert (master.state, master.reason) == ("closed", ("broken", Code.FAILED))
    pair.check()
    master.drive(pair.of_c.now_us)
    assert master.held_n == (0.0,)


def test_a_master_that_closes_is_answered_and_ends(lib):
    pair = Pair(lib, "lossy")
    pair.run(1.0)
    pair.each(lambda loop: loop.close("done"))
    pair.check()
    assert pair.of_c.master.state == "closed"
    assert pair.of_c.slave.session_count == 0


def test_a_master_that_closes_without_a_network_gives_up(lib):
    pair = Pair(lib)
    pair.run(0.5)
    pair.shut(0.0, 9.0)
    pair.each(lambda loop: loop.close("done"))
    pair.check()
    assert pair.of_c.master.state == "closed"


def test_a_refused_request_ends_with_the_reason_of_the_slave(lib):
    pair = Pair(lib, axes=3)
    for loop in pair.loops:
        loop.slave = SlaveNode(lambda _: Spring(1), SlaveSettings(), np.random.default_rng(3))
    pair.run(1.0)
    pair.check()
    reason, code = pair.of_c.master.reason
    assert (pair.of_c.master.state, code) == ("closed", Code.AXES)
    assert "axes" in reason


def test_a_slave_that_stops_is_asked_again_later_and_its_notice_is_kept(lib):
    pair = Pair(lib, "slow")
    pair.each(lambda loop: loop.slave.drain(loop.now_us))
    pair.run(4.0)
    assert (pair.of_c.master.state, pair.of_c.master.reason[1]) == ("connecting", Code.STOPPING)
    pair.each(stopped)
    pair.run(8.0)
    assert pair.of_c.master.state == "established"
    pair.each(lambda loop: loop.slave.drain(loop.now_us))
    pair.each(lambda loop: loop.slave.check(loop.now_us))
    pair.run(1.0)
    assert pair.of_c.master.reason == ("this slave is about to stop: end soon, or go on elsewhere", Code.STOPPING)
    pair.check(least_n=3.0)


def test_sequence_numbers_of_both_sides_wrap_without_a_change_of_force(lib):
    session = SessionSettings(first_sequence=2**32 - 60)
    pair = Pair(lib, "disorder", slave={"session": session})
    pair.run(0.2)
    pair.of_python.master.session._stream.sequence = 2**32 - 500
    lib.shim_set_sequence(pair.of_c.master.pointer, ctypes.c_uint32(2**32 - 500))
    pair.run(2.0)
    pair.check(least_n=3.0)


@pytest.mark.parametrize("rate_hz", [20.0, 300.0, 997.3, 4000.0])
def test_any_rate_and_a_slave_that_grants_less_give_the_same_positions(lib, rate_hz):
    pair = Pair(lib, "lossy", rate_hz=rate_hz, slave={"fastest_rate_hz": 700.0})
    pair.run(2.0)
    pair.check(least_n=0.5)


def test_a_clock_that_jumps_gives_no_other_datagram_or_force(lib):
    pair = Pair(lib, "slow")
    for jump_us in (-300_000, 40_000, -5_000_000, 30_000_000, 0):
        pair.run(0.7)
        for loop in pair.loops:
            loop.now_us += jump_us
            loop._next_tick_us += jump_us
    pair.check()


def test_a_hand_without_a_place_sends_no_position_until_it_has_one_again(lib):
    master = peer.Master(lib, lambda: 7, lambda t_us: (math.nan if 500_000 <= t_us < 1_000_000 else 0.02,))
    channels = Watched("delay=1ms", 1), Watched("delay=1ms", 2)
    slave = SlaveNode(lambda _: Spring(1), SlaveSettings(), np.random.default_rng(3))
    loop = Loopback(master, slave, forward=channels[0], feedback=channels[1])
    for seconds, state, force_n in ((0.4, "established", 3.0), (0.5, "stale", 0.0), (0.6, "established", 3.0)):
        loop.run(round(1e6 * seconds))
        assert (master.state, round(master.held_n[0], 3)) == (state, force_n)
