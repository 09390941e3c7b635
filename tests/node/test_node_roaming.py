"""Masters that change their address or port, and long sessions whose keys change: in virtual time."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.loopback import Loopback
from hapticnet.protocol import seal
from hapticnet.protocol.messages import Close
from hapticnet.protocol.wire import Kind
from tests.conftest import make_master, make_slave
from tests.peers import HandMaster, events_of

SECOND = 1_000_000
HERE, THERE = ("192.0.2.1", 5000), ("192.0.2.1", 6000)


class Moving(Loopback):
    """Both nodes, with a master whose datagrams come from `address`. What is sent elsewhere is lost."""

    address = HERE

    def _exchange(self, now_us):
        self.slave.tick(now_us)
        busy = True
        while busy:
            busy = False
            for datagram in self.master.datagrams_to_send():
                self.forward.push((datagram, self.address), len(datagram), now_us)
            for datagram, address in self.forward.due(now_us):
                self.slave.receive_datagram(datagram, address, now_us)
            for datagram, address in self.slave.datagrams_to_send():
                self.feedback.push((datagram, address), len(datagram), now_us)
            for datagram, address in self.feedback.due(now_us):
                if address == self.address:
                    self.master.receive_datagram(datagram, now_us)
                    busy = True
        return self.slave.next_timer_us()


def moving(loopback, sealed, network="delay=10ms"):
    made = loopback(1, sealed=sealed)
    slave = make_slave(1, sealed=sealed, host_of=lambda address: address[0])
    channels = (Emulator(parse_channel(network), np.random.default_rng(seed)) for seed in (1, 2))
    forward, feedback = channels
    return Moving(made.master, slave, forward=forward, feedback=feedback)


def silences_us(link, from_us):
    """Return the longest time between two forces that the slave computed since `from_us`."""
    stepped = np.concatenate([context.recording.table()["t_us"] for context in link.slave.contexts])
    return np.diff(stepped[stepped >= from_us]).max()


@pytest.mark.plain
def test_a_sealed_session_follows_its_master_to_another_address(loopback):
    link = moving(loopback, sealed=True)
    link.run(SECOND)
    (context,) = link.slave.contexts
    link.address = ("198.51.100.7", 7000)
    link.run(SECOND)
    assert link.slave.contexts == (context,)
    assert context.address == link.address
    assert silences_us(link, 900_000) == 1000
    assert link.master.report()["connections"] == 1
    assert link.master.report()["received"]["lost"] <= 1 + 20


@pytest.mark.plain
def test_an_open_session_is_replaced_after_a_new_port_and_the_scene_goes_on(loopback):
    link = moving(loopback, sealed=False)
    link.run(2_500_000)
    (before,) = link.slave.contexts
    felt_n, breaches = before.scene.force_n, before.scene.breaches
    events_of(link.master)
    link.address = THERE
    link.run(400_000)
    (after,) = link.slave.contexts
    assert after.address == THERE
    assert after.scene is before.scene
    assert after.scene.breaches >= breaches > 0
    assert link.master.report()["connections"] == 2
    assert after.report()["continues"] == before.session.number
    gap_us = after.recording.table()["t_us"][0] - before.recording.table()["t_us"][-1]
    assert gap_us <= 20_000 + 45_000 + 10_000 + 4 * 10_000 + 10_000, "silence, doubt, two round trips"
    assert felt_n != 0.0


def test_nothing_but_a_new_position_of_the_master_moves_a_sealed_session():
    slave = make_slave(sealed=True)
    master = HandMaster(slave, "here", sealed=True).join()
    (context,) = slave.contexts
    for step in (1, 3, 5):
        master.position(step, 1000 * step)
    late = master.pack(Kind.POSITION, 4, (4000, None, bytes(4)))
    forged = bytearray(master.pack(Kind.POSITION, 6, (6000, None, bytes(4))))
    forged[-1] ^= 1
    old_close = master.pack(Kind.CLOSE, 2, Close("done"))
    for data in (*master.said[2:], late, bytes(forged), old_close):
        assert [answer.kind for answer in master.send(data, 6000, address="there")] in ([], [Kind.WELCOME])
        assert context.address == "here"
    assert slave.contexts == (context,)
    master.send(master.pack(Kind.POSITION, 6, (6000, None, bytes(4))), 6000, address="there")
    assert context.address == "there"
    assert master.position(7, 100_000) != [], "and back again"


def test_a_close_from_a_new_address_is_answered_there():
    slave = make_slave(sealed=True)
    master = HandMaster(slave, "here", sealed=True).work()
    (answer,) = master.send(master.pack(Kind.CLOSE, 2, Close("done")), 0, address="there")
    assert answer.kind is Kind.CLOSE
    assert slave.contexts == ()


@pytest.mark.plain
@pytest.mark.parametrize("network", ["perfect", "delay=20ms,jitter=normal:5ms,order=free,loss=10%,duplicate=5%"])
def test_a_long_session_changes_its_keys_many_times_and_every_datagram_opens(loopback, monkeypatch, network):
    monkeypatch.setattr(seal, "EPOCH_BITS", 6)
    link = loopback(2, forward=network, feedback=network, sealed=True, insertions=3)
    link.run(8 * SECOND)
    (context,) = link.slave.contexts
    used = context.session.seal
    assert used.receive_epoch > 100
    assert used.send_epoch > 3
    assert context.session.received.malformed == 0
    assert link.master.report()["received"]["malformed"] == 0
    assert link.master.report()["connections"] == 1
    assert context.scene.breaches > 3


@pytest.mark.plain
def test_a_pause_of_more_than_an_epoch_needs_a_new_session_and_gets_one(loopback, monkeypatch):
    """A receiver opens the next epoch only: what is further away cannot be told from a forgery."""
    monkeypatch.setattr(seal, "EPOCH_BITS", 6)
    link = loopback(2, sealed=True, insertions=3)
    link.run(SECOND)
    forward, link.forward = link.forward, Emulator(parse_channel("loss=100%"), np.random.default_rng(0))
    link.run(SECOND)
    link.forward = forward
    (before,) = link.slave.contexts
    link.run(3 * SECOND)
    (after,) = link.slave.contexts
    assert after.session.number != before.session.number
    assert after.scene is before.scene
    assert link.master.report()["connections"] == 2


@pytest.mark.parametrize(("away_us", "same"), [(100_000, False), (300_000, True), (29 * SECOND, True)])
def test_a_restarted_master_feels_the_same_scene_again(loopback, sealed, away_us, same):
    link = loopback(1, sealed=sealed)
    link.run(2_500_000)
    (before,) = link.slave.contexts
    breaches = before.scene.breaches
    assert breaches > 0
    link.now_us = link._next_tick_us = link.now_us + away_us
    link.master = make_master(2, settings=link.master.settings)
    link.run(SECOND)
    after = link.slave.contexts[-1]
    assert (after.scene is before.scene) is same
    assert (after.scene.breaches >= breaches) is same
    assert link.master.report()["connections"] == 1
