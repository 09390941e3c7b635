"""Which session has been silent for longest, among those of the identities that hold most."""

from collections.abc import Hashable, Mapping
from heapq import heapify, heappop, heappush, heapreplace
from typing import TypeAlias

from hapticnet.node.alarms import SLACK
from hapticnet.node.slave_context import SlaveContext

Group: TypeAlias = dict[SlaveContext, int]
"""Sessions, with their place in the order in which they came."""


class Silence:
    """Find the session that gives way, without looking at those that are active.

    For each identity, a heap holds its sessions by when they were last heard of, or earlier. For each number of
    sessions that an identity may hold, a heap holds the identities by the first entries of their heaps. An entry is
    corrected when it comes to the top and would count as silent, so an active session is looked at once in that time.

    Parameters
    ----------
    held
        The open sessions of each identity. `note` must be called after each change.
    """

    def __init__(self, held: Mapping[Hashable, Group]) -> None:
        self._held = held
        self._sessions: dict[Hashable, list[tuple[int, int, SlaveContext]]] = {}
        self._levels: dict[int, list[tuple[int, int, Hashable]]] = {}
        self._members: dict[int, dict[Hashable, None]] = {}
        self._level_of: dict[Hashable, int] = {}

    def note(self, identity: Hashable, newcomer: SlaveContext | None = None) -> None:
        """Note that an identity has got or lost a session."""
        group = self._held.get(identity, {})
        self._leave(identity)
        if not group:
            self._sessions.pop(identity, None)
            return
        heap = self._sessions.setdefault(identity, [])
        if newcomer is not None:
            heappush(heap, (newcomer.session.heard_us, group[newcomer], newcomer))
        if len(heap) > 2 * len(group) + SLACK:
            self._sort(identity)
        self._enter(identity)

    def sort_again(self) -> None:
        """Rebuild all heaps after a clock went back: sessions may have been heard of earlier than noted."""
        for identity in self._held:
            self._leave(identity)
            self._sort(identity)
            self._enter(identity)

    def longest(self, more_than: int, before_us: int, besides: Hashable) -> SlaveContext | None:
        """Return the session to end for an identity that is `besides`; None if none is silent.

        Parameters
        ----------
        more_than
            Sessions that its identity must exceed.
        before_us
            It must have been heard of before this time.
        """
        for level in sorted((level for level in self._levels if level > more_than), reverse=True):
            heap, aside, found = self._levels[level], [], None
            while found is None and heap and heap[0][0] < before_us:
                heard_us, order, identity = heap[0]
                if self._level_of.get(identity) != level:
                    heappop(heap)
                elif identity == besides:
                    aside.append(heappop(heap))
                else:
                    first_us, first_order, first = self._first(identity, before_us)
                    if (first_us, first_order) == (heard_us, order):
                        found = first
                    else:
                        heapreplace(heap, (first_us, first_order, identity))
            for entry in aside:
                heappush(heap, entry)
            if found is not None:
                return found
        return None

    def _first(self, identity: Hashable, before_us: int) -> tuple[int, int, SlaveContext]:
        """Return the entry on top of an identity's heap; correct those that would count as silent."""
        heap, group = self._sessions[identity], self._held[identity]
        while True:
            heard_us, order, context = heap[0]
            if context not in group:
                heappop(heap)
            elif heard_us < before_us and context.session.heard_us != heard_us:
                heapreplace(heap, (context.session.heard_us, order, context))
            else:
                return heap[0]

    def _enter(self, identity: Hashable) -> None:
        group, (heard_us, order, _) = self._held[identity], self._sessions[identity][0]
        level = self._level_of[identity] = len(group)
        members = self._members.setdefault(level, {})
        members[identity] = None
        heap = self._levels.setdefault(level, [])
        heappush(heap, (heard_us, order, identity))
        if len(heap) > 2 * len(members) + SLACK:
            heap[:] = [(*self._sessions[each][0][:2], each) for each in members]
            heapify(heap)

    def _leave(self, identity: Hashable) -> None:
        level = self._level_of.pop(identity, None)
        if level is None:
            return
        del self._members[level][identity]
        if not self._members[level]:
            del self._members[level], self._levels[level]

    def _sort(self, identity: Hashable) -> None:
        group = self._held[identity]
        heap = self._sessions[identity] = [(each.session.heard_us, order, each) for each, order in group.items()]
        heapify(heap)
