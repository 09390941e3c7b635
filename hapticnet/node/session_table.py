"""Who has a place at a slave, and who gives way when there are none left.

Strangers, too, cause each of these questions, so no answer may take longer because there are many sessions. Therefore
there is an index for each question.
"""

from collections.abc import Collection, Hashable, Iterable
from typing import Final, TypeVar

from hapticnet.errors import HapticnetError
from hapticnet.node.alarms import Alarms
from hapticnet.node.silence import Group, Silence
from hapticnet.node.slave_context import SlaveContext
from hapticnet.protocol.settings import SessionSettings
from hapticnet.scene.base import Touchable

MOST_HALF_OPEN: Final = 128
"""Half-open sessions at once. They take no seat; this bounds their memory."""

MOST_HALF_OPEN_EACH: Final = 16
"""Half-open sessions of one identity at once."""

_Key = TypeVar("_Key", bound=Hashable)


class NoSeatError(HapticnetError):
    """There is no place for another session of this identity."""


class SessionTable:
    """The present sessions of a slave.

    Attributes
    ----------
    by_number
        The sessions by their numbers, in the order in which they came. Read it only.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.by_number: dict[int, SlaveContext] = {}
        self._settings = settings
        self._came = 0
        self._order: dict[SlaveContext, int] = {}
        self._waiting: dict[Hashable, Group] = {}  # half-open sessions by identity
        self._waiting_count = 0
        self._open: dict[Hashable, Group] = {}  # open ones by identity
        self._open_count = 0
        self._named: dict[tuple[Hashable, str], Group] = {}
        self._ticketed: dict[bytes, Group] = {}
        self._tickets: dict[SlaveContext, tuple[bytes, ...]] = {}
        self._touched: dict[int, Group] = {}  # by the scene's `id`: a user's scene need not be hashable
        self._silence = Silence(self._open)
        self._expiry = Alarms[SlaveContext](lambda context: context.session.expires_us())
        self._now_us = 0
        self._went_back = False

    def __len__(self) -> int:
        return len(self.by_number)

    def see(self, now_us: int) -> None:
        """Note the time [µs], and whether the clock went back."""
        if now_us < self._now_us:
            self._went_back = True
        self._now_us = now_us

    def add(self, context: SlaveContext) -> None:
        """Add a half-open session."""
        self._came += 1
        self._order[context] = self._came
        self.by_number[context.session.number] = context
        self._waiting.setdefault(context.identity, {})[context] = self._came
        self._waiting_count += 1
        self._expiry.note(context)

    def seat(self, context: SlaveContext) -> None:
        """Give a session its seat: it is open now."""
        order = self._order[context]
        _discard(self._waiting, context.identity, context)
        self._waiting_count -= 1
        context.seated = True
        self._open.setdefault(context.identity, {})[context] = order
        self._open_count += 1
        self._named.setdefault((context.identity, context.session.request.name), {})[context] = order
        self._touched.setdefault(id(context.scene), {})[context] = order
        self.note_tickets(context)
        self._silence.note(context.identity, context)
        self._expiry.note(context)  # an open session may expire sooner than a half-open one

    def remove(self, context: SlaveContext) -> None:
        """Forget a session that has ended."""
        del self.by_number[context.session.number]
        del self._order[context]
        self._expiry.forget(context)
        if not context.seated:
            _discard(self._waiting, context.identity, context)
            self._waiting_count -= 1
            return
        _discard(self._open, context.identity, context)
        self._open_count -= 1
        _discard(self._named, (context.identity, context.session.request.name), context)
        _discard(self._touched, id(context.scene), context)
        for ticket in self._tickets.pop(context):
            _discard(self._ticketed, ticket, context)
        self._silence.note(context.identity)

    def note_tickets(self, context: SlaveContext) -> None:
        """Note the tickets that continue an open session, after `SlaveContext.tickets` has changed."""
        for ticket in self._tickets.get(context, ()):
            _discard(self._ticketed, ticket, context)
        self._tickets[context] = context.tickets
        for ticket in context.tickets:
            self._ticketed.setdefault(ticket, {})[context] = self._order[context]

    def in_order(self, contexts: Iterable[SlaveContext]) -> list[SlaveContext]:
        """Return present sessions in the order in which they came."""
        return sorted(contexts, key=self._order.__getitem__)

    def expired(self, now_us: int) -> list[SlaveContext]:
        """Return the sessions that have been silent for too long. They must be removed."""
        self._count_silence(now_us)
        return self.in_order(self._expiry.due(now_us))

    def next_expiry_us(self) -> int | None:
        """Return when to ask for expired sessions next [µs]; None if there is no session."""
        if self._went_back:
            self._count_silence(self._now_us)
        return self._expiry.not_before_us()

    def users_of(self, scene: Touchable) -> Collection[SlaveContext]:
        """Return the open sessions that touch a scene."""
        return self._touched.get(id(scene), {})

    def eviction_candidate(
        self, identity: Hashable, most: int, besides: Collection[SlaveContext], now_us: int
    ) -> SlaveContext | None:
        """Return the session that must end so that `identity` gets another one; None if there is a free place.

        A session whose master is silent gives way to another one of the same identity that holds all its places, or,
        when all places are taken, to an identity that holds fewer: first a session of the identity that holds most, and
        of these the one that has been silent for longest. So an identity with many places cannot shut out the others.

        Parameters
        ----------
        most
            Places that this identity may hold.
        besides
            Sessions of this identity that hold no place.

        Raises
        ------
        NoSeatError
            If no session may be ended.
        """
        self._count_silence(now_us)
        own = self._open.get(identity, {})
        without = sum(context in own for context in besides)
        held = len(own) - without
        if held >= most:
            silence = {context: context.session.silent_us(now_us) for context in own if context not in besides}
            longest = max(silence, key=lambda context: (silence[context], -own[context]), default=None)
            if longest is None or silence[longest] <= self._settings.gives_way_us:
                raise NoSeatError(f"all sessions that this master may have are taken; it may have {most} at once")
            return longest
        if self._open_count - without >= self._settings.most_sessions:
            found = self._silence.longest(held, now_us - self._settings.gives_way_us, identity)
            if found is None:
                most_sessions = self._settings.most_sessions
                raise NoSeatError(f"all sessions of this slave are taken; it serves {most_sessions} at once")
            return found
        return None

    def surplus_half_open(self, identity: Hashable) -> SlaveContext | None:
        """Return the half-open session that must end before another one of `identity` begins, or None."""
        own = self._waiting.get(identity, {})
        if len(own) >= MOST_HALF_OPEN_EACH:
            return next(iter(own))
        if self._waiting_count >= MOST_HALF_OPEN:
            firsts = [(len(group), next(iter(group))) for group in self._waiting.values()]
            return max(firsts, key=lambda each: (each[0], -self._order[each[1]]))[1]
        return None

    def to_continue(
        self, identity: Hashable, name: str, ticket: bytes | None, now_us: int
    ) -> tuple[SlaveContext, bool] | None:
        """Return the session whose scene a new one goes on with, and whether its own master asks; None without one.

        That is the session of the ticket, or the one that the session of the ticket was to continue; without a ticket,
        one of the same identity and name. Another master than its own (one that was restarted) gets only the scene of a
        session whose link is stale.
        """
        self._count_silence(now_us)
        group = self._named.get((identity, name), {}) if ticket is None else self._ticketed.get(ticket, {})
        found = [
            (order, context, is_own)
            for context, order in group.items()
            for is_own in [ticket is not None and bool(context.is_own(ticket))]
            if context.identity == identity
            and (is_own or context.session.silent_us(now_us) > self._settings.stale_after_us)
        ]
        if not found:
            return None
        _, context, is_own = min(found, key=lambda each: each[0])
        return context, is_own

    def _count_silence(self, now_us: int) -> None:
        """Let silence count from now, for all sessions, if the clock went back since the last call."""
        self.see(now_us)
        if not self._went_back:
            return
        self._went_back = False
        for context in self.by_number.values():
            context.session.silent_us(now_us)
        self._expiry.note_all(self.by_number.values())
        self._silence.sort_again()


def _discard(groups: dict[_Key, Group], key: _Key, context: SlaveContext) -> None:
    """Take a session out of one of the groups; remove the group if it was the last."""
    group = groups.get(key, {})
    group.pop(context, None)
    if not group:
        groups.pop(key, None)
