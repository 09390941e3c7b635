"""Workers as one slave to its masters: who gets which session, what is counted over all, what continues."""

from itertools import count

import numpy as np
import pytest

from hapticnet.node.admission import SlaveSettings, ticket_of, worker_of
from hapticnet.node.compiled_slave import CompiledSlaveNode
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import OpenDoor, SealedDoor
from hapticnet.protocol.keys import MasterEntry, Roster
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED, Kind, unpack
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.workers.neighbourhood import Neighbourhood
from hapticnet.runtime.workers.presence import Presence
from hapticnet.runtime.workers.table import Table, shared_file
from hapticnet.scene.presets import paper_scene
from hapticnet.scene.scene import Scene
from tests.peers import ENTRY, OTHER_ENTRY, OTHER_KEY, SLAVE, HandMaster, Interned, events_of

SECOND = 1_000_000
SECRET = bytes(range(32))
NONCES = count(100)


class House:
    """Workers in this process. A HELLO arrives at the worker `door`; what has a session, at its own."""

    def __init__(self, workers, entries=(ENTRY, OTHER_ENTRY), banks=False, **settings):
        self.door = 0
        self.passed = 0
        self.ended = set()
        session = SessionSettings(**settings)
        self.table = Table(shared_file(workers, session.most_sessions), workers, session.most_sessions, SECRET)
        scene = paper_scene(1)
        self.nodes, self.presences = [], []
        for worker in range(workers):
            rng = np.random.default_rng(worker)
            more = {"addresses": Interned(), "is_compiled": False} if banks else {}
            neighbours = Neighbourhood(self.table, worker, session)
            node = (CompiledSlaveNode if banks else SlaveNode)(
                lambda _: Scene(scene.tissues, name=scene.name),
                SlaveSettings(session=session, workers=workers, worker=worker),
                rng,
                doors={OPEN: OpenDoor(), SEALED: SealedDoor(SLAVE.private, Roster(entries), rng)},
                host_of=lambda address: address[0],
                neighbours=neighbours,
                secret=SECRET,
                **more,
            )
            self.nodes.append(node)
            self.presences.append(Presence(node, self.table, worker, neighbours))
        self.refresh()

    def receive_datagram(self, data, address, now):
        session = unpack(data).session
        self.nodes[session % len(self.nodes) if session else self.door].receive_datagram(data, address, now)
        for _ in range(3):  # a HELLO is passed on twice at most
            for node, presence in zip(self.nodes, self.presences, strict=True):
                for event in events_of(node):
                    presence.note(event, now)
                for hello in node.hellos_to_pass_on():
                    self.passed += 1
                    self.nodes[hello.worker].receive_passed_on(hello, now)
        self.refresh()

    def refresh(self):
        """Let the table show which masters are silent, and how many sessions there are."""
        for worker, presence in enumerate(self.presences):
            if worker not in self.ended:
                presence.refresh()

    def end(self, worker):
        """Do what the parent does when a worker has ended."""
        self.ended.add(worker)
        self.table.clear(worker)

    def datagrams_to_send(self):
        return [each for node in self.nodes for each in node.datagrams_to_send()]

    def sessions(self):
        return [len(node.stations) for node in self.nodes]

    def steps_of(self, master):
        """Return how many positions of a master were answered."""
        (steps,) = [
            station.steps
            for node in self.nodes
            for station in node.stations
            if station.session.number == master.session
        ]
        return steps

    def master(self, host, *, door=0, **more):
        """Return a master that asks from a port of its own, and whose HELLOs arrive at a worker."""
        nonce = next(NONCES)
        self.door = door
        return HandMaster(self, (host, nonce), nonce=nonce, **more)


@pytest.mark.parametrize("workers", [2, 3, 7, 64])
def test_a_ticket_tells_its_worker_whatever_the_random_bytes(workers):
    for worker in range(workers):
        for first in range(256):
            ticket = ticket_of(worker, workers, bytes([first, 1, 2]))
            assert worker_of(ticket, workers) == worker
            assert ticket[1:] == b"\x01\x02"


def test_one_slave_leaves_tickets_as_they_are():
    assert all(ticket_of(0, 1, bytes([first])) == bytes([first]) for first in range(256))


def test_a_session_number_tells_its_worker_and_takes_five_bytes(sealed):
    house = House(3, most_per_identity=64)
    now = now_us()
    for number in range(30):
        joined = house.master(f"h{number}", door=number % 3, sealed=sealed, name=f"m{number}").work(now + number)
        assert joined.grant.session >= 1 << 16
    assert sum(house.sessions()) == 30
    for worker, node in enumerate(house.nodes):
        assert {station.session.number % 3 for station in node.stations} == {worker}


def test_sessions_spread_evenly_even_if_all_hellos_arrive_at_one_worker():
    house = House(4, most_sessions=64)
    now = now_us()
    for number in range(32):
        house.master(f"h{number}").work(now + number)
    assert sum(house.sessions()) == 32
    assert max(house.sessions()) - min(house.sessions()) <= 2


def test_sessions_spread_evenly_even_if_all_masters_have_the_same_name_and_host():
    house = House(2, most_per_identity=8, stale_after_us=60 * SECOND)
    now = now_us()
    for number in range(8):
        house.master("gateway").work(now + number)
    assert min(house.sessions()) >= 3


def test_a_cookie_of_one_worker_opens_at_another(sealed):
    house = House(2)
    asking = house.master("h", sealed=sealed)
    assert [answer.kind for answer in asking.hello(0)] == [Kind.COOKIE]
    house.door = 1
    assert [answer.kind for answer in asking.hello(0)] == [Kind.WELCOME]


def test_a_hello_that_is_repeated_gets_the_same_session_wherever_it_was_passed_on_to():
    house = House(3)
    now = now_us()
    for number in range(6):
        asking = house.master(f"h{number}").join(now)
        first = asking.grant.session
        assert [answer.kind for answer in asking.hello(now)] == [Kind.WELCOME]
        assert asking.grant.session == first
    assert sum(house.sessions()) == 6
    assert house.passed > 0


@pytest.mark.parametrize("ticketed", [True, False])
@pytest.mark.parametrize("door", [0, 1, 2])
@pytest.mark.parametrize("banks", [False, True])
@pytest.mark.filterwarnings("ignore:overflow")  # of a hash, where the bank is not compiled
def test_a_master_that_comes_back_finds_its_scene_at_whatever_worker_it_asks(sealed, ticketed, door, banks):
    house = House(3, banks=banks)
    now = now_us() - 3 * SECOND
    first = house.master("h", sealed=sealed, name="surgeon").work(now)
    house.master("other", sealed=sealed, name="somebody").work(now + 1)
    ticket = first.grant.ticket if ticketed else None  # both have been silent for three seconds
    again = house.master("h", door=door, sealed=sealed, name="surgeon", ticket=ticket).work(now_us())
    assert again.grant.resumed
    assert again.grant.session % 3 == first.grant.session % 3


def test_a_master_of_the_same_name_that_is_at_work_keeps_its_scene():
    house = House(2, stale_after_us=60 * SECOND)
    now = now_us()
    first = house.master("h", name="surgeon").work(now)
    second = house.master("h", name="surgeon").work(now + 10)
    assert not second.grant.resumed
    first.position(2, now + 20)
    assert house.steps_of(first) == 2
    assert house.sessions() == [1, 1]


@pytest.mark.parametrize("door", [0, 1, 2])
def test_the_places_of_all_workers_together_are_limited(door):
    house = House(3, most_sessions=4)
    now = now_us()
    for number in range(4):
        house.master(f"h{number}", door=number % 3).work(now + number)
    refusal = house.master("late", door=door).refused(now + 10)
    assert refusal[1:] == ("all 4 sessions of this slave are taken", Code.FULL)


@pytest.mark.parametrize("door", [0, 1, 2])
def test_the_places_of_one_identity_are_limited_over_all_workers(sealed, door):
    house = House(3, most_per_identity=2)
    now = now_us()
    for number in range(2):
        house.master("h", door=number, sealed=sealed).work(now + number)
    refusal = house.master("h", door=door, sealed=sealed, name="third").refused(now + 10)
    assert refusal[1:] == ("all 2 sessions that this master may have are taken", Code.FULL)
    other = {"key": OTHER_KEY} if sealed else {}
    house.master("other", door=door, sealed=sealed, **other).work(now + 20)


def test_a_master_of_the_list_may_have_seats_of_its_own_over_all_workers():
    house = House(2, entries=[MasterEntry(name="surgeon", public=ENTRY.public, most_sessions=1)])
    now = now_us()
    house.master("h", sealed=True).work(now)
    assert house.master("h", sealed=True, name="second").refused(now + 10).code is Code.FULL


def test_two_that_were_welcomed_at_once_do_not_both_get_the_last_place():
    house = House(2, most_sessions=1)
    now = now_us()
    first, second = house.master("a").join(now), house.master("b").join(now)
    assert {first.grant.session % 2, second.grant.session % 2} == {0, 1}
    first.position(1, now + 10)
    assert [answer.kind for answer in second.position(1, now + 20)] == [Kind.CLOSE]
    assert house.sessions().count(1) == 1


@pytest.mark.parametrize("door", [0, 1])
def test_a_silent_session_gives_way_at_whatever_worker_it_is(door):
    house = House(2, most_sessions=2, most_per_identity=2)
    past, now = now_us() - 5 * SECOND, now_us()
    silent = house.master("greedy", name="one").work(past)
    house.master("greedy", name="two").work(past + 10).position(2, now)
    newcomer = house.master("new", door=door).work(now)
    assert newcomer.grant.session % 2 == silent.grant.session % 2
    assert house.sessions() == [1, 1]


def test_the_requests_of_a_host_are_counted_at_one_worker_from_whatever_port_they_come():
    house = House(3, most_sessions=512, most_per_identity=512)
    granted = 0
    for number in range(60):
        asking = house.master("h", door=number % 3)
        asking.hello(0)
        asking.hello(0)
        granted += asking.grant is not None
    assert granted == 8, "REQUESTS_AT_ONCE of one host"
    assert sum(node.throttled for node in house.nodes) == 52


def test_a_worker_that_does_not_run_gets_no_hello():
    house = House(2, most_sessions=16)
    now = now_us()
    house.end(1)
    for number in range(6):
        assert house.master(f"h{number}").work(now + number).grant.session % 2 == 0
    assert house.sessions() == [6, 0]


def test_a_worker_that_is_stuck_gets_no_hello_either():
    house = House(3, most_sessions=16)
    house.ended.add(2)  # it does not show itself any more
    house.table.workers["seen_us"][2] -= 2 * SECOND
    now = now_us()
    for number in range(6):
        assert house.master(f"h{number}").work(now + number).grant.session % 3 != 2


def test_the_places_of_a_worker_that_has_ended_are_free():
    house = House(2, most_sessions=2)
    now = now_us()
    masters = [house.master(f"h{number}").work(now + number) for number in range(2)]
    masters.sort(key=lambda each: each.session % 2)
    assert house.sessions() == [1, 1]
    house.end(1)
    newcomer = house.master("new").work(now + 10)
    assert newcomer.grant.session % 2 == 0
    assert house.master("late").refused(now + 20).code is Code.FULL
    masters[0].position(2, now + 30)
    assert house.steps_of(masters[0]) == 2


def test_a_master_that_is_not_listed_is_refused_by_any_worker():
    house = House(3, entries=[])
    for door in range(3):
        assert house.master("h", door=door, sealed=True).refused(0).code is Code.KEY
