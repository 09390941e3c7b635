"""What strangers get from a slave before and after they have proved their address: cookies and buckets."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.registry import every_codec
from hapticnet.protocol import hello_filter
from hapticnet.protocol.buckets import TokenBucket
from hapticnet.protocol.handshake import MAC_BYTES, hello_mac, is_hello_mac
from hapticnet.protocol.hello_filter import ALL_REQUESTS_AT_ONCE, GENERATION_US, REQUESTS_AT_ONCE, Buckets, CookieJar
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey
from hapticnet.protocol.messages import COOKIE_BYTES, HELLO_BYTES, REASON_BYTES, Code, clipped, unpack_hello
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import OPEN, SEALED, Kind, pack, pack_body, unpack
from tests.conftest import make_slave
from tests.peers import KEY, MASTER, OTHER_MASTER, PSK, SLAVE, HandMaster

CODECS = every_codec()
SECOND = 1_000_000


def of_version(version, nonce=5):
    return pack_body((version, Kind.HELLO, 0, 0, pack_body((nonce, "?" * 400))))


def kept(slave):
    """Return how much a slave keeps for those that have no session."""
    at = slave.hello_filter
    return len(slave.contexts), len(slave._welcomes), len(at._spent), len(at._spent_before), len(at._hosts._buckets)


def test_a_hello_without_a_cookie_leaves_nothing_behind(sealed):
    slave = make_slave(sealed=sealed)
    made = []
    slave._admission._make_scene = lambda _: made.append(1)
    for number in range(2000):
        (answer,) = HandMaster(slave, f"address {number}", sealed=sealed, nonce=number).hello(number)
        assert answer.kind is Kind.COOKIE
    assert kept(slave) == (0, 0, 0, 0, 0)
    assert made == []
    assert slave.unknown_peers.by_kind[Kind.HELLO] == 2000


@pytest.mark.parametrize("wrong", ["guessed", "another nonce", "another address", "two generations old"])
def test_a_wrong_cookie_gets_another_cookie_and_leaves_nothing_behind(sealed, wrong):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed)
    now_us = 0
    if wrong == "guessed":
        master.cookie = bytes(16)
    else:
        other = HandMaster(slave, "b" if wrong == "another address" else "a", sealed=sealed, nonce=2)
        (other if wrong != "two generations old" else master).hello(0)
        master.cookie = master.cookie or other.cookie
        now_us = 2 * GENERATION_US if wrong == "two generations old" else 0
    assert [answer.kind for answer in master.hello(now_us)] == [Kind.COOKIE]
    assert kept(slave) == (0, 0, 0, 0, 0)
    assert [answer.kind for answer in master.hello(now_us)] == [Kind.WELCOME]


def test_no_answer_to_a_stranger_is_larger_than_what_it_answers(sealed):
    slave = make_slave(sealed=sealed)
    rng = np.random.default_rng(1)
    questions = [
        *(HandMaster(slave, 0, sealed=each, nonce=nonce).attempt.hello(b"") for nonce, each in ((1, True), (2, False))),
        of_version(7),
        pack(Kind.POSITION, 99, 0, b"", SEALED if sealed else OPEN),
        pack(Kind.CLOSE, 99, 0, b""),
        *(rng.bytes(int(size)) for size in rng.integers(0, 1500, 2000)),
    ]
    answered = 0
    for number, question in enumerate(questions):
        slave.receive_datagram(question, number, 0)
        for data, address in slave.datagrams_to_send():
            assert address == number
            assert len(data) <= len(question)
            answered += 1
    assert answered == 5


@pytest.mark.parametrize("request_", [{}, {"codec": "x" * 64}, {"axes": 3}, {"weber_fraction": -1.0}])
def test_no_answer_to_a_proved_address_is_larger_than_what_it_answers(sealed, request_):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed, **request_)
    for _ in range(3):
        master.hello()
    assert slave.to_unknown_peers.payload_bytes + sum(s.session.sent.payload_bytes for s in slave.contexts) < 3 * 300
    assert slave.to_unknown_peers.packets + sum(s.session.sent.packets for s in slave.contexts) >= 2


def test_a_short_hello_is_malformed_and_gets_no_answer(sealed):
    slave = make_slave(sealed=sealed)
    whole = unpack(HandMaster(slave, sealed=sealed).attempt.hello(b""))
    bare = pack(Kind.HELLO, 0, 0, pack_body((*unpack_hello(whole.body), b"")), whole.version)
    assert len(bare) < HELLO_BYTES
    slave.receive_datagram(bare, "a", 0)
    assert slave.datagrams_to_send() == []
    assert slave.unknown_peers.malformed == 1


@pytest.mark.parametrize(
    ("version", "code", "reason"),
    [
        (OPEN, Code.KEY, "this slave serves sealed sessions only: give the master a key, with --peer-key"),
        (
            SEALED,
            Code.KEY,
            "this slave serves open sessions only: start it with --key for sealed ones, or omit --peer-key",
        ),
        (3, Code.VERSION, "this slave speaks protocol versions 1 and 2 only"),
    ],
)
def test_a_hello_of_a_version_that_is_not_served_is_told_which_one_is(version, code, reason):
    slave = make_slave(sealed=version == OPEN)
    stranger = HandMaster(slave)
    (refusal,) = stranger.send(of_version(version), 0)
    assert refusal.kind is Kind.REFUSE
    assert stranger.refusal == (5, reason, code)
    assert kept(slave) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_a_hello_for_another_slave_gets_no_answer_at_all(rounds):
    slave = make_slave(sealed=True)
    lost = HandMaster(slave, sealed=True, key=MasterKey(MASTER, OTHER_MASTER.public))
    for _ in range(rounds):
        assert lost.hello() == []
    assert slave.report()["unkeyed"] == rounds
    assert kept(slave) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("change", "code", "reason"),
    [
        ({"codec": "mp3"}, Code.CODEC, clipped(f"unknown codec 'mp3'; there are: {', '.join(CODECS)}", REASON_BYTES)),
        ({"axes": 3}, Code.AXES, "the master has 3 axes; scene 'paper:1' has 1"),
        ({"weber_fraction": -1.0}, Code.PARAMETER, "Weber fraction is -1.0; it must be 0 or between 1e-12 and 1"),
        (
            {"parameters": {"bitrate": 1.0}},
            Code.PARAMETER,
            "codec 'deadband' has no parameter 'bitrate'; it has: step_n",
        ),
    ],
)
def test_what_cannot_be_served_is_refused_in_words_and_with_a_code(sealed, change, code, reason):
    slave = make_slave(sealed=sealed)
    assert HandMaster(slave, sealed=sealed, **change).refused()[1:] == (reason, code)
    assert slave.contexts == ()


def test_an_unknown_key_is_told_and_a_wrong_pre_shared_key_opens_nothing():
    stranger = PrivateKey(bytes(range(200, 232)))
    slave = make_slave(sealed=True, masters=[MasterEntry(name="surgeon", public=MASTER.public, psk=PSK)])
    refusal = HandMaster(slave, sealed=True, key=MasterKey(stranger, SLAVE.public)).refused()
    assert refusal == (0, "this slave does not know the master's key: add it to its list of masters", Code.KEY)
    assert slave.contexts == ()
    guest = HandMaster(slave, sealed=True, key=KEY, nonce=2)
    guest.hello()
    slave.receive_datagram(guest.attempt.hello(guest.cookie), "a", 0)
    ((welcome, _),) = slave.datagrams_to_send()
    with pytest.raises(Exception, match=r"(?i)open|tag|key"):
        guest._read(welcome)
    assert [context.session.state for context in slave.contexts] == [SlaveState.HALF_OPEN]
    member = HandMaster(slave, sealed=True, key=MasterKey(PrivateKey(MASTER.private, PSK), SLAVE.public), nonce=3)
    assert member.work().grant


def test_the_same_hello_gets_the_same_welcome_and_another_one_a_new_session(sealed):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed).join()
    hello = master.attempt.hello(master.cookie)
    slave.receive_datagram(hello, "a", 10)
    slave.receive_datagram(hello, "a", 20)
    (first, _), (second, _) = slave.datagrams_to_send()
    assert first == second
    assert unpack(first).session == master.session
    other = HandMaster(slave, sealed=sealed, nonce=2).join()
    assert other.session != master.session
    assert len(slave.contexts) == 2


@pytest.mark.plain
def test_a_copied_hello_costs_a_hash_and_nothing_else(sealed):
    slave = make_slave(sealed=sealed)
    master = HandMaster(slave, sealed=sealed).work()
    hello = master.attempt.hello(master.cookie)
    read = []
    for door in slave._doors.values():
        door.read = lambda *call: read.append(call)
    slave.close("done", 0)
    slave.datagrams_to_send()
    before = kept(slave)
    for number in range(1000):
        slave.receive_datagram(hello, "a", number)
        slave.receive_datagram(hello, f"forged {number}", number)
    kinds = {unpack(data).kind for data, _ in slave.datagrams_to_send()}
    assert kinds == {Kind.COOKIE}, "for the forged addresses only"
    assert read == []
    assert kept(slave) == before


def test_a_host_is_heard_so_often_and_others_beside_it(sealed):
    slave = make_slave(sealed=sealed, host_of=lambda address: address[0])
    for number in range(100):
        master = HandMaster(slave, ("flood", number), sealed=sealed, nonce=number)
        master.hello(0)
        master.hello(0)
    assert slave.report()["throttled"] == 100 - REQUESTS_AT_ONCE
    assert HandMaster(slave, ("newcomer", 1), sealed=sealed, nonce=1000).join(0).grant
    later = HandMaster(slave, ("flood", 7), sealed=sealed, nonce=2000)
    later.hello(200_000)
    assert [answer.kind for answer in later.hello(200_001)] == [Kind.WELCOME]
    throttled = HandMaster(slave, ("flood", 8), sealed=sealed, nonce=2001)
    throttled.hello(200_001)
    assert throttled.hello(200_001) == []
    assert [answer.kind for answer in throttled.hello(400_010)] == [Kind.WELCOME], "a repetition is read later"


def test_all_hosts_together_are_heard_so_often(sealed):
    slave = make_slave(sealed=sealed)
    for number in range(300):
        master = HandMaster(slave, number, sealed=sealed, nonce=number)
        master.hello(0)
        master.hello(0)
    assert slave.report()["throttled"] == 300 - ALL_REQUESTS_AT_ONCE


@pytest.mark.plain
def test_memory_for_proved_addresses_is_bounded(sealed, monkeypatch):
    monkeypatch.setattr(hello_filter.HelloFilter, "read", counting_read(reads := [], hello_filter.HelloFilter.read))
    slave = make_slave(sealed=sealed, session=SessionSettings(most_sessions=8))
    worker = HandMaster(slave, "worker", sealed=sealed).work()
    for number in range(3000):
        now_us = 100_000 * number
        master = HandMaster(slave, number, sealed=sealed, nonce=number)
        master.hello(now_us)
        master.hello(now_us)
        worker.position(2 + number, now_us)
        slave.tick(now_us)
    contexts, welcomes, spent, spent_before, hosts = kept(slave)
    assert len(reads) == 3001
    assert contexts <= 1 + 128
    assert welcomes == contexts - 1, "one is open"
    assert max(spent, spent_before) <= 1 + 2 * GENERATION_US // 100_000
    assert hosts <= 4096
    assert slave.contexts[0].session.state is SlaveState.OPEN
    assert slave.contexts[0].steps == 3001


def counting_read(reads, read):
    return lambda *call: reads.append(1) or read(*call)


def test_sessions_that_were_never_used_are_accounted_for_to_the_byte(sealed):
    slave = make_slave(sealed=sealed, session=SessionSettings(half_open_us=SECOND))
    sent = 0
    masters = [HandMaster(slave, str(number), sealed=sealed, nonce=number) for number in range(3)]
    for master in masters:
        for _ in range(2):
            slave.receive_datagram(master.attempt.hello(master.cookie), master.address, 0)
            for data, _ in slave.datagrams_to_send():
                sent += len(data)
                master._read(data)
        slave.receive_datagram(pack(Kind.CLOSE, 99, 0, b""), "stranger", 0)
        sent += sum(len(data) for data, _ in slave.datagrams_to_send())
    slave.tick(2 * SECOND)
    report = slave.report()
    assert report["never_used"] == 3
    hellos = sum(len(master.attempt.hello(cookie)) for master in masters for cookie in (b"", master.cookie))
    assert report["unknown_peers"]["payload_bytes"] == hellos + 3 * len(pack(Kind.CLOSE, 99, 0, b""))
    assert report["to_unknown_peers"]["payload_bytes"] == sent
    assert report["to_unknown_peers"]["by_kind"] == {"cookie": 3, "welcome": 3, "reset": 3}


HERE = b"('192.0.2.1', 5000)"


@pytest.fixture
def jar():
    return CookieJar(np.random.default_rng(1))


def test_a_cookie_is_accepted_from_its_address_with_its_nonce_alone(jar):
    cookie = jar.make(HERE, 7, 0)
    assert len(cookie) == COOKIE_BYTES
    assert jar.accepts(cookie, HERE, 7, 1)
    assert not jar.accepts(cookie, HERE, 8, 1)
    assert not jar.accepts(cookie, b"('192.0.2.1', 5001)", 7, 1)
    assert not jar.accepts(cookie, b"('192.0.2.2', 5000)", 7, 1)
    assert not jar.accepts(cookie, b"\x07" + HERE, 0, 1), "nonce and address do not run into each other"


@pytest.mark.parametrize("cookie", [b"", bytes(16), b"guessed a cookie"])
def test_no_other_cookie_is_accepted(jar, cookie):
    jar.make(HERE, 7, 0)
    assert not jar.accepts(cookie, HERE, 7, 1)


@pytest.mark.parametrize(
    ("now_us", "accepted"),
    [
        (GENERATION_US, True), (2 * GENERATION_US - 1, True), (2 * GENERATION_US, False), (10 * GENERATION_US, False),
        (-GENERATION_US, False),
    ],
)  # fmt: skip
def test_a_cookie_lives_for_the_generation_it_was_made_in_and_the_next_one(jar, now_us, accepted):
    start = 5 * GENERATION_US
    cookie = jar.make(HERE, 7, start + (30 * SECOND if accepted else 0))
    assert jar.accepts(cookie, HERE, 7, start + now_us) is accepted


def test_each_generation_and_each_slave_has_a_secret_of_its_own(jar):
    cookies = [jar.make(HERE, 7, generation * GENERATION_US) for generation in range(20)]
    cookies.append(CookieJar(np.random.default_rng(2)).make(HERE, 7, 0))
    assert len(set(cookies)) == 21


@pytest.mark.plain
def test_a_jar_keeps_nothing_for_an_address(jar):
    for nonce in range(1000):
        jar.make(f"address {nonce}".encode(), nonce, 0)
        jar.accepts(bytes(16), f"address {nonce}".encode(), nonce, 0)
    sizes = [len(value) for value in (jar._secret, jar._previous)]
    assert sizes == [32, 32]


@given(st.lists(st.integers(0, 300_000), min_size=50, max_size=200))
def test_a_bucket_lets_no_more_through_than_its_depth_and_rate(gaps):
    bucket, now_us, taken = TokenBucket(5.0, 8.0), 0, []
    for gap_us in gaps:
        now_us += gap_us
        if bucket.take(now_us):
            taken.append(now_us)
    for first in range(len(taken)):
        for last in range(first, len(taken)):
            assert last - first + 1 <= 8 + 5 * (taken[last] - taken[first]) / 1e6 + 1e-6


def test_a_bucket_is_full_at_first_and_fills_at_its_rate():
    bucket = TokenBucket(5.0, 8.0)
    assert [bucket.take(10**12) for _ in range(9)] == [True] * 8 + [False]
    assert [bucket.take(10**12 + 200_001 * step) for step in (1, 2, 3)] == [True] * 3
    assert not bucket.take(10**12 + 600_010)
    later = 10**12 + 3600 * SECOND
    assert [bucket.take(later) for _ in range(9)] == [True] * 8 + [False]


def test_a_clock_that_goes_back_fills_no_bucket_and_stops_none():
    bucket = TokenBucket(5.0, 1.0)
    assert bucket.take(10 * SECOND)
    assert not bucket.take(0)
    assert bucket.take(SECOND)


def test_keys_do_not_share_a_bucket_and_only_so_many_are_remembered():
    buckets = Buckets(5.0, 2.0, most_keys=100)
    assert [buckets.take("a", 0) for _ in range(3)] == [True, True, False]
    assert buckets.take("b", 0)
    for number in range(10_000):
        buckets.take(number, 0)
        buckets.take("a", 0)
    assert len(buckets._buckets) == 100
    assert not buckets.take("a", 0), "the one that keeps asking is remembered"


PUBLIC = bytes(range(32))


uint32 = st.integers(0, 2**32 - 1)


@given(nonce=uint32, sequence=uint32, noise1=st.binary(max_size=200))
def test_the_code_is_what_the_document_says(nonce, sequence, noise1):
    key = hashlib.blake2s(b"hapticnet mac1" + PUBLIC, digest_size=32).digest()
    said = nonce.to_bytes(4, "big") + sequence.to_bytes(4, "big") + noise1
    mac = hello_mac(PUBLIC, nonce, sequence, noise1)
    assert mac == hashlib.blake2s(said, key=key, digest_size=16).digest()
    assert len(mac) == MAC_BYTES
    assert is_hello_mac(mac, PUBLIC, nonce, sequence, noise1)


@pytest.mark.parametrize(
    ("slave", "nonce", "sequence", "noise1"),
    [
        (bytes(32), 1, 2, b"3"),
        (PUBLIC, 2, 2, b"3"),
        (PUBLIC, 1, 1, b"3"),
        (PUBLIC, 1, 2, b"4"),
        (PUBLIC, 1, 2, b""),
    ],
)
def test_the_code_of_anything_else_is_wrong(slave, nonce, sequence, noise1):
    assert not is_hello_mac(hello_mac(PUBLIC, 1, 2, b"3"), slave, nonce, sequence, noise1)


def test_every_flipped_bit_and_every_other_length_is_wrong():
    mac = hello_mac(PUBLIC, 1, 2, b"3")
    for bit in range(8 * MAC_BYTES):
        changed = bytearray(mac)
        changed[bit // 8] ^= 1 << bit % 8
        assert not is_hello_mac(bytes(changed), PUBLIC, 1, 2, b"3")
    assert not any(is_hello_mac(mac[:length], PUBLIC, 1, 2, b"3") for length in range(MAC_BYTES))
    assert not is_hello_mac(mac + b"\0", PUBLIC, 1, 2, b"3")
