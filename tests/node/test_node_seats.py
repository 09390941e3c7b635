"""Whom a slave serves, who holds a place, per identity and in total, who gives way, and that nobody else loses one."""

from types import SimpleNamespace

import numpy as np
import pytest

from hapticnet.errors import PeerError
from hapticnet.node.admission import MOST_HALF_OPEN, MOST_HALF_OPEN_EACH, SessionTable
from hapticnet.node.events import MasterLeft
from hapticnet.protocol import noise
from hapticnet.protocol.handshake import hello_mac, prologue
from hapticnet.protocol.keys import NO_PSK, MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.messages import Code, unpack_welcome
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState
from hapticnet.protocol.wire import Kind, pack_body, unpack
from tests.conftest import make_slave
from tests.peers import MASTER, OTHER_ENTRY, OTHER_KEY, OTHER_MASTER, REQUEST, SLAVE, HandMaster, events_of

SECOND = 1_000_000
KEYS = {name: PrivateKey(bytes(range(first, first + 32))) for first, name in enumerate("abcdefghij", start=100)}


"""Identities: the key of that name in sealed sessions, the host of that name in open ones."""


class House:
    """A slave, and masters that each bear the name of their identity."""

    def __init__(self, sealed, **settings):
        self.sealed = sealed
        entries = [MasterEntry(name=name, public=key.public) for name, key in KEYS.items()]
        settings = SessionSettings(**settings)
        self.slave = make_slave(session=settings, sealed=sealed, masters=entries, host_of=lambda address: address[0])
        self.nonce = 0

    def visitor(self, identity, **request):
        self.nonce += 1
        key = MasterKey(KEYS[identity], SLAVE.public)
        place = (f"192.0.2.{self.nonce}", 5000) if self.sealed else (identity, self.nonce)
        request = {"name": f"{identity}{self.nonce}", **request}
        return HandMaster(self.slave, place, sealed=self.sealed, nonce=self.nonce, key=key, **request)

    def works(self, identity, now_us, **request):
        return self.visitor(identity, **request).work(now_us)

    def open(self):
        """Return the masters' names of the open sessions, in the order they came."""
        contexts = self.slave.contexts
        return [each.session.request.name for each in contexts if each.session.state is SlaveState.OPEN]


@pytest.fixture
def house(sealed):
    return House(sealed, most_sessions=4, most_per_identity=2, gives_way_us=SECOND)


def test_an_identity_holds_only_its_share(house):
    for _ in range(2):
        house.works("a", 0)
    refusal = house.visitor("a").refused(10)
    assert refusal[1:] == ("all sessions that this master may have are taken; it may have 2 at once", Code.FULL)
    house.works("b", 10)
    assert house.open() == ["a1", "a2", "b4"]


def test_the_longest_silent_session_of_an_identity_gives_way_to_another_of_its_own(house):
    first, second = house.works("a", 0), house.works("a", 0)
    house.works("b", 0)
    first.position(2, 100_000)
    house.works("a", 100_000 + SECOND + 1)
    assert house.open() == ["a1", "b3", "a4"]
    left = [event.context.session for event in events_of(house.slave) if isinstance(event, MasterLeft)]
    assert [(each.number, each.end_reason) for each in left] == [(second.session, "its place was needed")]


def test_a_clock_that_went_back_keeps_no_place_for_the_silent(house):
    for identity in "aa":
        house.works(identity, 1000 * SECOND)
    for now_us in (SECOND, 2 * SECOND):  # the limits of requests start again, too
        house.visitor("a").refused(now_us)
    house.works("a", 3 * SECOND)
    assert house.open() == ["a2", "a5"]


def test_a_silent_session_gives_way_only_to_an_identity_that_holds_fewer(house):
    for name in "aabb":
        house.works(name, 0)
    assert house.visitor("c").refused(SECOND)
    house.works("c", SECOND + 1)
    assert house.open() == ["a2", "b3", "b4", "c6"]
    house.works("d", SECOND + 1)
    assert house.open() == ["a2", "b4", "c6", "d7"], "whoever holds most gives first"


@pytest.mark.parametrize("sealed", [False, True], ids=["open", "sealed"])
def test_who_holds_as_many_as_any_other_gets_no_more_from_them(sealed):
    house = House(sealed, most_sessions=4)
    for name in "aabb":
        house.works(name, 0)
    assert house.visitor("a").refused(10 * SECOND)[2] is Code.FULL
    assert house.open() == ["a1", "a2", "b3", "b4"]


def test_a_working_session_never_gives_way(house):
    masters = [house.works(name, 0) for name in "aabb"]
    for step in range(2, 60):
        now_us = 50_000 * step
        refusal = house.visitor("cdefg"[step % 5]).refused(now_us)
        assert refusal[1:] == ("all sessions of this slave are taken; it serves 4 at once", Code.FULL)
        for master in masters:
            assert master.position(step, now_us) is not None
    assert house.open() == ["a1", "a2", "b3", "b4"]
    assert all(context.steps == 59 for context in house.slave.contexts)


def test_half_open_sessions_take_no_place(house):
    for number, name in enumerate("aaabbbcccddd"):
        house.visitor(name).join(10_000 * number)  # a slave reads 100 requests a second
    assert house.open() == []
    for number, name in enumerate("efgh", start=12):
        house.works(name, 10_000 * number)
    assert house.open() == ["e13", "f14", "g15", "h16"]


def test_the_place_is_taken_by_the_first_that_prove_themselves(house):
    house.works("a", 0)
    waiting = [house.visitor("a").join(0) for _ in range(3)]
    waiting[2].position(1, 10)
    (answer,) = waiting[0].position(1, 20)
    assert answer.kind is Kind.CLOSE
    assert house.open() == ["a1", "a4"]
    assert waiting[2].position(2, 50_000) != []


@pytest.mark.parametrize("sealed", [False, True], ids=["open", "sealed"])
def test_half_open_sessions_are_bounded_for_each_identity_and_in_total(sealed):
    house = House(sealed)
    worker = house.works("a", 0)
    for number in range(400):
        now_us = 10_000 * number
        name = "bcdefghij"[number % 9]
        house.visitor(name).hello(now_us)
        crowd = house.visitor(name)
        crowd.hello(now_us)
        crowd.hello(now_us)
        waiting = [each for each in house.slave.contexts if each.session.state is SlaveState.HALF_OPEN]
        assert len(waiting) <= MOST_HALF_OPEN
        assert max(sum(1 for each in waiting if each.identity == one.identity) for one in waiting) <= (
            MOST_HALF_OPEN_EACH
        )
    assert len(waiting) == MOST_HALF_OPEN
    newcomer = house.visitor("a").join(4 * SECOND)
    assert newcomer.position(1, 4 * SECOND) != []
    assert worker.position(2, 4 * SECOND) != []


def test_an_entry_of_the_list_may_set_its_own_number_of_places():
    entries = [MasterEntry(name="a", public=KEYS["a"].public, most_sessions=1)]
    slave = make_slave(sealed=True, masters=entries)
    key = MasterKey(KEYS["a"], SLAVE.public)
    HandMaster(slave, sealed=True, key=key).work()
    refusal = HandMaster(slave, sealed=True, key=key, nonce=2, name="b").refused()
    assert refusal[1] == "all sessions that this master may have are taken; it may have 1 at once"


HALF_OPEN_US, KEEP_US = 600, 900


class Session:
    """What the table asks of a session, and of its context."""

    def __init__(self, number, now_us, identity=None, lasts_us=(HALF_OPEN_US, KEEP_US)):
        self.session, self.number, self.heard_us = self, number, now_us
        self.identity, self.scene, self.seated = identity or number % 5, object(), False
        self.request, self.lasts_us = SimpleNamespace(name="x"), lasts_us

    def silent_us(self, now_us):
        self.heard_us = min(self.heard_us, now_us)
        return now_us - self.heard_us

    def expires_us(self):
        return self.heard_us + self.lasts_us[self.seated]


@pytest.mark.plain
@pytest.mark.parametrize("seed", range(12))
def test_sessions_expire_as_a_look_at_all_of_them_says(seed):
    rng = np.random.default_rng(seed)
    table, now_us, expired = SessionTable(SessionSettings()), 1000, 0
    lasts_us = (HALF_OPEN_US, KEEP_US) if seed % 2 else (KEEP_US, HALF_OPEN_US)
    for number in range(3000):
        now_us += int(-rng.integers(1000) if rng.random() < 0.01 else rng.integers(40))
        table.see(now_us)
        sessions = list(table.by_number.values())
        for session in sessions:
            if rng.random() < 0.02:
                session.heard_us = now_us
            elif not session.seated and rng.random() < 0.01:
                session.heard_us = now_us
                table.seat(session)
            elif rng.random() < 0.002:
                table.remove(session)
        if rng.random() < 0.2:
            table.add(Session(number, now_us, lasts_us=lasts_us))
        sessions = list(table.by_number.values())
        due = [each for each in sessions if each.expires_us() <= now_us]
        next_us = table.next_expiry_us()
        assert (next_us is None) == (not sessions)
        assert all(next_us <= each.expires_us() for each in sessions)
        assert table.expired(now_us) == due
        expired += len(due)
        for session in due:
            table.remove(session)
    assert expired > 100


@pytest.mark.plain
def test_the_oldest_half_open_session_of_the_largest_crowd_makes_room():
    table, waiting = SessionTable(SessionSettings()), []
    crowds = ["lone", *("crowd" for _ in range(MOST_HALF_OPEN_EACH)), *(f"pair {n // 2}" for n in range(200))]
    for number, identity in enumerate(crowds[:MOST_HALF_OPEN]):
        assert table.surplus_half_open("newcomer") is None
        waiting.append(Session(number, number, identity))
        table.add(waiting[-1])
        assert (table.surplus_half_open("crowd") is None) is (number < MOST_HALF_OPEN_EACH)
    assert table.surplus_half_open("newcomer") is table.surplus_half_open("crowd") is waiting[1]
    table.seat(waiting[1])
    assert table.surplus_half_open("crowd") is None, "it is open, and one place is free"


HERE, THERE = ("192.0.2.1", 5000), ("192.0.2.66", 6000)


@pytest.fixture
def slave():
    return make_slave(sealed=True)


def test_a_master_that_is_removed_from_the_list_ends_and_is_not_served_again(slave):
    surgeon = HandMaster(slave, HERE, sealed=True).work()
    student = HandMaster(slave, THERE, sealed=True, nonce=2, key=OTHER_KEY).work()
    slave.serve_only(Roster([OTHER_ENTRY]), 1000)
    ((close, to),) = slave.datagrams_to_send()
    assert (surgeon._read(close).kind, to) == (Kind.CLOSE, HERE)
    assert HandMaster(slave, HERE, sealed=True, nonce=3).refused(2000).code is Code.KEY
    assert [context.address for context in slave.contexts] == [THERE]
    assert student.position(2, 60_000) != []


class Thief(noise.Initiator):
    """Holds the slave's private key, and poses as a master whose public key it knows."""

    def __init__(self, nonce, rng):
        super().__init__(bytes([9] * 32), SLAVE.public, NO_PSK, prologue(nonce, 0), rng)
        self._static = noise._Pair(self._static.private, MASTER.public)
        self._static_shared = noise._shared_secret(noise._pair(SLAVE.private), MASTER.public)


@pytest.mark.plain
def test_a_thief_of_the_slaves_key_forges_a_request_but_can_prove_no_session(slave):
    thief = HandMaster(slave, THERE, sealed=True, nonce=7, key=OTHER_KEY)
    attempt = thief.attempt
    attempt._initiator = Thief(7, slave._admission._rng)
    attempt._request = attempt._initiator.write(pack_body(REQUEST))
    attempt._mac = hello_mac(SLAVE.public, 7, 0, attempt._request)
    thief.hello()
    slave.receive_datagram(attempt.hello(thief.cookie), THERE, 0)
    ((welcome, _),) = slave.datagrams_to_send()
    (context,) = slave.contexts
    assert context.identity == MASTER.public
    with pytest.raises(PeerError, match="does not open"):
        attempt.read(unpack_welcome(unpack(welcome).body).grant)
    for key in (bytes(32), SLAVE.private, OTHER_MASTER.private):
        guessed = Seal(key, key).pack(Kind.POSITION, context.session.number, 1, pack_body((0, None, bytes(4))))
        assert thief.send(guessed, 1000) == []
    assert context.session.state is SlaveState.HALF_OPEN


def test_copies_of_true_positions_do_not_use_up_the_granted_rate(slave):
    master = HandMaster(slave, HERE, sealed=True).join()
    for step in range(1, 3001):
        master.position(step, 1000 * step)
        for _ in range(3):
            assert master.send(master.said[-1], 1000 * step) == []
    received = slave.contexts[0].session.received
    assert (received.duplicate, received.over_rate) == (9000, 0)


def test_a_copied_request_gets_its_sender_a_half_open_session_and_disturbs_nothing(slave):
    master = HandMaster(slave, HERE, sealed=True).join()
    positions = [master.pack(Kind.POSITION, step, (1000 * step, None, bytes(4))) for step in range(1, 51)]
    for step, data in enumerate(positions, start=1):
        master.send(data, 1000 * step)
    (context,) = slave.contexts
    copier = HandMaster(slave, THERE, sealed=True)
    copier.attempt = master.attempt
    assert [answer.kind for answer in copier.hello(51_000)] == [Kind.COOKIE], "the master's is of another address"
    slave.receive_datagram(copier.attempt.hello(copier.cookie), THERE, 51_000)
    ((welcome, to),) = slave.datagrams_to_send()
    assert (unpack(welcome).kind, to) == (Kind.WELCOME, THERE)
    for data in positions:  # no datagram of the running session proves the copied one
        copied = data.replace(master.session.to_bytes(4, "big"), unpack(welcome).session.to_bytes(4, "big"))
        slave.receive_datagram(copied, THERE, 51_000)
    slave.datagrams_to_send()
    assert slave.contexts[0] is context
    assert master.position(51, 100_000) != []
    assert [each.session.state for each in slave.contexts] == [SlaveState.OPEN, SlaveState.HALF_OPEN]
