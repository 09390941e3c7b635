"""The tables of sessions decide as a look at every session would, whatever has happened before."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from hapticnet.node import session_table
from hapticnet.node.session_table import NoSeatError, SessionTable
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import SlaveState

UNIT_US = 200
SETTINGS = SessionSettings(
    most_sessions=8,
    gives_way_us=40 * UNIT_US,
    stale_after_us=30 * UNIT_US,
    keepalive_us=5 * UNIT_US,
    keep_us=90 * UNIT_US,
    half_open_us=60 * UNIT_US,
)
MOST, MOST_EACH = 6, 3


class Session:
    """What the tables ask of a session."""

    def __init__(self, number, name, now_us):
        self.number = number
        self.request = SimpleNamespace(name=name)
        self.state = SlaveState.HALF_OPEN
        self.heard_us = now_us

    def silent_us(self, now_us):
        self.heard_us = min(self.heard_us, now_us)
        return now_us - self.heard_us

    def expires_us(self):
        half_open = self.state is SlaveState.HALF_OPEN
        return self.heard_us + (SETTINGS.half_open_us if half_open else SETTINGS.keep_us)


class Place:
    """What the tables ask of a context."""

    def __init__(self, number, identity, name, scene, now_us):
        self.session = Session(number, name, now_us)
        self.identity = identity
        self.scene = scene
        self.successors = {}
        self.seated = False

    @property
    def tickets(self):
        return (bytes([self.session.number % 256]), *self.successors)

    def is_own(self, ticket):
        return True if ticket == self.tickets[0] else self.successors.get(ticket)


def eviction_candidate(contexts, identity, most, now_us):
    """Decide as `SessionTable.eviction_candidate`, by a look at every session."""
    held = Counter(context.identity for context in contexts if context.session.state is SlaveState.OPEN)
    silent = [
        context
        for context in contexts
        if context.session.state is SlaveState.OPEN and context.session.silent_us(now_us) > SETTINGS.gives_way_us
    ]
    own = held[identity]
    if own >= most:
        candidates = [context for context in silent if context.identity == identity]
    elif held.total() >= SETTINGS.most_sessions:
        candidates = [context for context in silent if held[context.identity] > own]
    else:
        return None
    return max(candidates, key=lambda each: (held[each.identity], each.session.silent_us(now_us)), default="no seat")


def surplus_half_open(contexts, identity):
    """Decide as `SessionTable.surplus_half_open`, by a look at every session."""
    waiting = [context for context in contexts if context.session.state is SlaveState.HALF_OPEN]
    own = [context for context in waiting if context.identity == identity]
    if len(own) >= MOST_EACH:
        return own[0]
    if len(waiting) >= MOST:
        crowd, _ = Counter(context.identity for context in waiting).most_common(1)[0]
        return next(context for context in waiting if context.identity == crowd)
    return None


def to_continue(contexts, identity, name, ticket, now_us):
    """Decide as `SessionTable.to_continue`, by a look at every session."""
    for context in contexts:
        if context.identity != identity or context.session.state is not SlaveState.OPEN:
            continue
        if ticket is not None:
            is_own = context.is_own(ticket)
        else:
            is_own = False if context.session.request.name == name else None
        if is_own or (is_own is not None and context.session.silent_us(now_us) > SETTINGS.stale_after_us):
            return context, is_own
    return None


class History:
    """Sessions that come, open, are heard of and end at random."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.table = SessionTable(SETTINGS)
        self.now_us = 1000
        self.numbers = 0

    @property
    def contexts(self):
        return list(self.table.by_number.values())

    def chance(self, share):
        return self.rng.random() < share

    def one_of(self, contexts):
        return contexts[int(self.rng.integers(len(contexts)))] if contexts else None

    def step(self):
        self.now_us += UNIT_US * int(-self.rng.integers(100) if self.chance(0.01) else self.rng.integers(12))
        self.table.see(self.now_us)
        for context in self.contexts:
            if self.chance(0.2):
                context.session.silent_us(self.now_us)
                context.session.heard_us = self.now_us
        waiting = [each for each in self.contexts if each.session.state is SlaveState.HALF_OPEN]
        if (context := self.one_of(waiting)) is not None and self.chance(0.5):
            self.open(context)
        if (context := self.one_of(self.contexts)) is not None and self.chance(0.05):
            self.end(context)
        if self.chance(0.6):
            self.come()
        expired = [each for each in self.contexts if self.now_us >= each.session.expires_us()]
        next_us = self.table.next_expiry_us()
        assert next_us is None or all(next_us <= each.session.expires_us() for each in self.contexts)
        assert self.table.expired(self.now_us) == expired
        for context in expired:
            self.end(context)

    def ask(self):
        """Compare the answers to a random stranger; return what they are."""
        contexts, now_us = self.contexts, self.now_us
        identity, name = "abcdef"[int(self.rng.integers(6))], "xy"[int(self.rng.integers(2))]
        ticket = bytes([int(self.rng.integers(max(self.numbers - 20, 0), self.numbers + 1)) % 256])
        ticket = ticket if self.chance(0.5) else None
        most = int(self.rng.integers(1, 5))
        found = self.table.to_continue(identity, name, ticket, now_us)
        assert found == to_continue(contexts, identity, name, ticket, now_us)
        old = None if found is None else found[0]
        try:
            gives_way = self.table.eviction_candidate(identity, most, () if old is None else (old,), now_us)
        except NoSeatError:
            gives_way = "no seat"
        assert gives_way == eviction_candidate([each for each in contexts if each is not old], identity, most, now_us)
        assert self.table.surplus_half_open(identity) == surplus_half_open(contexts, identity)
        return identity, name, found, gives_way

    def come(self):
        identity, name, found, gives_way = self.ask()
        if gives_way == "no seat":
            return
        self.numbers += 1
        scene = object() if found is None else found[0].scene
        context = Place(self.numbers, identity, name, scene, self.now_us)
        if found is not None:
            found[0].successors[context.tickets[0]] = self.chance(0.5)
            if len(found[0].successors) > 3:
                del found[0].successors[next(iter(found[0].successors))]
        surplus = self.table.surplus_half_open(identity)
        if surplus is not None:
            self.end(surplus)
        self.table.add(context)

    def open(self, context):
        users = [e for e in self.contexts if e.session.state is SlaveState.OPEN and e.scene is context.scene]
        assert list(self.table.users_of(context.scene)) == users
        context.session.heard_us = self.now_us
        for user in users:
            self.end(user)
        context.session.state = SlaveState.OPEN
        self.table.seat(context)

    def end(self, context):
        context.session.state = SlaveState.CLOSED
        self.table.remove(context)


@pytest.mark.plain
@pytest.mark.parametrize("seed", range(12))
def test_the_tables_decide_as_a_look_at_every_session(monkeypatch, seed):
    monkeypatch.setattr(session_table, "MOST_HALF_OPEN", MOST)
    monkeypatch.setattr(session_table, "MOST_HALF_OPEN_EACH", MOST_EACH)
    history, answers = History(seed), Counter()
    for _ in range(1500):
        history.step()
        *_, found, gives_way = history.ask()
        answers["continues"] += found is not None
        answers["no seat" if gives_way == "no seat" else "free" if gives_way is None else "gives way"] += 1
    assert min(answers[each] for each in ("continues", "no seat", "free", "gives way")) > 10
    for context in history.contexts:
        history.end(context)
    assert len(history.table) == 0
    assert history.table.next_expiry_us() is None
