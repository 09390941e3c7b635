"""Sealed sessions with a peer that shares no code with them, masters that move, and keys that change."""

import struct

import msgpack
import numpy as np
import pytest
from cryptography.exceptions import InvalidTag

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.loopback import Loopback
from hapticnet.node.settings import MasterSettings
from hapticnet.protocol import master_stream, seal
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, PrivateKey
from hapticnet.protocol.messages import Close, Code
from hapticnet.protocol.wire import Kind, unpack
from tests.conftest import make_master, make_slave
from tests.peers import MASTER, SLAVE, HandMaster, Still, events_of
from tests.protocol.sealed_peer import CLOSE, COOKIE, FORCE, KEEPALIVE, POSITION, WELCOME, Master, Slave

PSK = bytes(range(64, 96))
REQUEST = ["deadband", {}, 0.05, 0.025, 1.0, 1000.0, 1, "test", None, 0, False, 0.0]
GRANT = [0xDEADBEEF, 1000.0, 45_000, "paper:1", bytes(range(16)), False, False, 0.0]
DEEP_M = 0.024
each_psk = pytest.mark.parametrize("psk", [NO_PSK, PSK], ids=["without psk", "with psk"])


def slave_with(psk=NO_PSK):
    return make_slave(sealed=True, masters=[MasterEntry(name="theatre 2", public=MASTER.public, psk=psk)])


def master_with(psk=NO_PSK):
    key = MasterKey(PrivateKey(MASTER.private, psk), SLAVE.public)
    return make_master(settings=MasterSettings(record=True, key=key))


def serve(master, peer, now_us, answer_to=lambda _kind, _fields: None):
    """Tick a master and pass all datagrams between it and its peer; `answer_to` answers those of the session."""
    master.drive(now_us)
    master.tick(now_us)
    while sent := master.datagrams_to_send():
        for data in sent:
            kind, fields, answer = peer.receive(data)
            if answer := answer or answer_to(kind, fields):
                master.receive_datagram(answer, now_us)


def ask(slave, peer_data, now_us=0, address="a"):
    """Return the slave's one answer to a datagram, None if it gives none."""
    slave.receive_datagram(peer_data, address, now_us)
    answers = slave.datagrams_to_send()
    assert len(answers) <= 1
    return answers[0][0] if answers else None


def join(slave, *, psk=NO_PSK, nonce=7, address="a"):
    peer = Master(MASTER.private, SLAVE.public, REQUEST, nonce=nonce, psk=psk)
    peer.receive(ask(slave, peer.hello(), address=address))
    assert peer.receive(ask(slave, peer.hello(), address=address))[0] == WELCOME
    return peer


def position(t_us, position_m, newest=None):
    return [t_us, newest, struct.pack(">f", position_m)]


@each_psk
def test_a_master_written_from_the_document_plays_with_this_slave(psk):
    slave = slave_with(psk)
    peer = Master(MASTER.private, SLAVE.public, REQUEST, nonce=7, psk=psk)
    cookie = ask(slave, peer.hello())
    assert peer.receive(cookie)[0] == COOKIE
    kind, (_, rate_hz, keepalive_us, scene, ticket, resumed, *_) = peer.receive(ask(slave, peer.hello()))
    assert (kind, rate_hz, keepalive_us, scene, len(ticket), resumed) == (WELCOME, 1000.0, 45_000, "paper:1", 16, False)
    answers = []
    for now_us in range(1000, 200_000, 1000):
        depth_m = DEEP_M if now_us < 50_000 else 0.0
        data = ask(slave, peer.send(POSITION, position(now_us, depth_m)), now_us)
        if data is not None:
            answers.append(peer.receive(data))
    assert {kind for kind, _ in answers} == {FORCE, KEEPALIVE}
    first_kind, (t_us, payload) = answers[0]
    assert (first_kind, t_us) == (FORCE, 1000)
    assert struct.unpack(">f", payload)[0] > 0.1
    assert peer.receive(ask(slave, peer.send(CLOSE, ["bye", 0]), 200_000)) == (CLOSE, ("as asked", 0))
    assert slave.contexts == ()
    assert slave.report()["sessions"][0]["sealed"]


@each_psk
def test_a_slave_written_from_the_document_plays_with_this_master(psk):
    master = master_with(psk)
    peer = Slave(SLAVE.private, SLAVE.public, GRANT, psk=psk)
    heard = []

    def answer_to(kind, fields):
        heard.append(kind)
        if kind == CLOSE:
            assert fields == ("enough", 0)
            return peer.send(CLOSE, ["as asked", 0])
        t_us, newest, _ = fields
        assert newest == (None if t_us <= 10_000 else 1 + (t_us - 1) // 40_000)
        if t_us == 10_000:
            return peer.send(FORCE, [t_us, struct.pack(">f", 1.25)])
        return peer.send(KEEPALIVE, [t_us, 1]) if t_us % 40_000 == 0 else None

    for now_us in range(0, 300_000, 1000):
        if now_us == 200_000:
            assert master.held_force_n(now_us)[0] == pytest.approx(1.25)
            master.close("enough", now_us)
        serve(master, peer, now_us, answer_to)
    assert set(heard) == {POSITION, CLOSE}
    assert peer.master_public == MASTER.public
    assert peer.request[0] == "deadband"
    assert master.end_reason == "enough"
    assert master.report()["received"]["malformed"] == 0


@pytest.mark.plain
def test_an_observer_sees_neither_names_nor_keys_nor_forces(loopback):
    link = loopback(sealed=True, settings=MasterSettings(name="nobody else"))
    link.master._operator, seen = Still(DEEP_M), []
    for end in (link.master, link.slave):
        end.receive_datagram = lambda data, *rest, take=end.receive_datagram: (
            seen.append(unpack(data)),
            take(data, *rest),
        )
    link.run(200_000)
    (context,) = link.slave.contexts
    link.close()
    kinds = {Kind.HELLO, Kind.COOKIE, Kind.WELCOME, Kind.POSITION, Kind.FORCE, Kind.KEEPALIVE, Kind.CLOSE}
    assert {datagram.kind for datagram in seen} == kinds
    assert context.scene.force_n > 0.1
    numbers = [struct.pack(">f", number) for number in (DEEP_M, context.scene.force_n)]
    texts = [b"nobody else", b"deadband", b"paper:1", MASTER.public, SLAVE.public, context.grant.ticket]
    assert not [secret for secret in (*texts, *numbers) for datagram in seen if secret in datagram.body]
    positions = [datagram.body for datagram in seen if datagram.kind is Kind.POSITION]
    assert len(set(positions)) == len(positions), "although the tool stands still"


def test_an_unknown_key_is_refused_in_words_that_only_its_holder_can_read():
    slave = make_slave(sealed=True, masters=[])
    peer = Master(MASTER.private, SLAVE.public, REQUEST, nonce=7)
    peer.receive(ask(slave, peer.hello()))
    data = ask(slave, peer.hello())
    assert b"key" not in data
    kind, (session, reason, code) = peer.receive(data)
    assert (kind, session, code) == (WELCOME, 0, Code.KEY)
    assert "does not know the master's key" in reason


@each_psk
def test_this_master_ends_after_a_sealed_refusal_with_its_reason(psk):
    """A slave that does not know the key has no psk for it."""
    master = master_with(psk)
    peer = Slave(SLAVE.private, SLAVE.public, [0, "not today", 7])
    serve(master, peer, 0)
    assert master.refused
    assert master.end_reason == "not today"


def test_no_grant_opens_without_the_psk():
    master = master_with(PSK)
    peer = Slave(SLAVE.private, SLAVE.public, GRANT)
    for now_us in range(0, 1_000_000, 1000):
        serve(master, peer, now_us)
    assert not master.connected
    assert master.report()["received"]["malformed"] > 0


@pytest.mark.parametrize("forged", [1, 5000, 2**31 - 1, 2**32 - 1])
def test_a_forged_sequence_in_a_welcome_makes_no_true_datagram_late(forged):
    """Nothing authenticates the frame of a WELCOME; whoever copies one can send it first, with another sequence."""
    master = master_with()
    peer = Slave(SLAVE.private, SLAVE.public, GRANT, sequence=forged)

    def answer_to(_, fields):
        return peer.send(FORCE, [fields[0], struct.pack(">f", 1.25)], sequence=1 + fields[0] // 1000)

    for now_us in range(0, 100_000, 1000):
        serve(master, peer, now_us, answer_to)
    received = master.report()["received"]
    assert received["late"] == received["malformed"] == 0
    assert master.held_force_n(100_000)[0] == pytest.approx(1.25)


def test_a_sealed_session_feels_as_an_open_one_and_costs_16_bytes_a_datagram(loopback):
    sealed, plain = loopback(sealed=True), loopback()
    for each in (sealed, plain):
        each.run(2_000_000)
        each.close()
    assert sealed.master.end_reason == plain.master.end_reason == "done"
    felt = [each.master.recording.table()["held_n"] for each in (sealed, plain)]
    assert felt[0].max() > 0.1
    np.testing.assert_array_equal(felt[0], felt[1])
    for direction in ("sent", "received"):
        one, other = (each.master.report()[direction] for each in (sealed, plain))
        assert one["by_kind"] == other["by_kind"]
        data = sum(
            count for kind, count in one["by_kind"].items() if kind in ("position", "force", "keepalive", "close")
        )
        handshake = sum(one["by_kind"].values()) - data
        assert abs(one["payload_bytes"] - other["payload_bytes"] - 16 * data) <= 80 * handshake


@pytest.mark.plain
def test_a_session_whose_numbers_run_out_continues_in_a_new_one(loopback, monkeypatch):
    monkeypatch.setattr(master_stream, "LAST_SEQUENCE", master_stream.RECENT + 300)
    pair = loopback(sealed=True)
    pair.run(200_000)
    (before,) = pair.slave.contexts
    pair.run(300_000)
    (after,) = pair.slave.contexts
    assert after.session.number != before.session.number
    assert after.scene is before.scene
    assert pair.master.report()["connections"] == 2


def test_the_keys_of_another_session_open_nothing():
    slave = slave_with()
    one, other = join(slave, nonce=7), join(slave, nonce=8, address="b")
    assert one.session != other.session
    data = ask(slave, one.send(POSITION, position(1000, DEEP_M)), 1000)
    other._receive._epoch = 0
    with pytest.raises(InvalidTag):
        other._receive.open(data)
    kept = one.session
    one.session = other.session
    assert ask(slave, one.send(POSITION, position(2000, DEEP_M)), 2000) is None
    one.session = kept
    assert unpack(ask(slave, one.send(POSITION, position(3000, 0.0)), 3000)).kind is Kind.FORCE


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


def test_who_forwards_a_position_first_gets_the_answers_until_the_next_one_and_can_open_none():
    slave = make_slave(sealed=True)
    master = HandMaster(slave, "here", sealed=True).work()
    data = master.pack(Kind.POSITION, 2, (50_000, None, bytes(4)))
    slave.receive_datagram(data, "there", 50_000)
    ((answer, to),) = slave.datagrams_to_send()
    assert to == "there"
    assert len(answer) <= len(data)
    with pytest.raises(ValueError, match=r"unpack|extra|data"):
        msgpack.unpackb(unpack(answer).body)
    assert master._read(answer).kind is Kind.KEEPALIVE
    assert master.send(data, 50_000) == [], "it is a copy by now"
    master.position(3, 51_000)
    assert slave.contexts[0].address == "here"


def test_a_close_from_a_new_address_is_answered_there():
    slave = make_slave(sealed=True)
    master = HandMaster(slave, "here", sealed=True).work()
    (answer,) = master.send(master.pack(Kind.CLOSE, 2, Close("done")), 0, address="there")
    assert answer.kind is Kind.CLOSE
    assert slave.contexts == ()


@pytest.mark.plain
@pytest.mark.parametrize("network", ["perfect", "delay=20ms,jitter=normal:5ms,reorder=5%,loss=10%,duplicate=5%"])
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
