"""When scenes are stepped between positions that are sent only when they matter, and how often at most.

A line takes its master ten datagrams a second, and the slave as many steps as the session's rate says. Every step that
is not paid for by a datagram therefore counts toward a limit, for each identity and in all. Where a limit is reached,
the sessions of that identity, or all, are stepped at every second, third, … of their times, and all positions that
arrive are still answered.
"""

from collections.abc import Callable, Hashable
from heapq import heapify, heappop, heappush, heapreplace
from itertools import count
from math import ceil
from typing import Final, Generic, TypeVar

from hapticnet.node.slave_context import SlaveContext

SLACK: Final = 64
"""A heap is rebuilt when it has this many entries more than twice the number of items."""

T = TypeVar("T", bound=Hashable)


class Alarms(Generic[T]):
    """Tell which of many items are due, without looking at the others.

    A heap holds a time for each item that is never later than its true time. A time that moves later is corrected only
    when it comes to the top; one that moves earlier must be noted.

    `when`: returns the present true time of an item [µs]; None if it has none.
    """

    def __init__(self, when: Callable[[T], int | None]) -> None:
        self._when = when
        self._set_us: dict[T, int] = {}
        self._heap: list[tuple[int, int, T]] = []
        self._numbers = count()  # so that two of the same time are not compared

    def note(self, item: T) -> None:
        """Note that the time of an item may be earlier than before, or that the item is new."""
        time_us = self._when(item)
        if time_us is None:
            return
        set_us = self._set_us.get(item)
        if set_us is None or time_us < set_us:
            self._set_us[item] = time_us
            heappush(self._heap, (time_us, next(self._numbers), item))
            if len(self._heap) > 2 * len(self._set_us) + SLACK:
                self._rebuild()

    def forget(self, item: T) -> None:
        """Remove an item."""
        self._set_us.pop(item, None)

    def due(self, now_us: int, most: int) -> list[T]:
        """Remove and return the items that are due, at most so many: those that have been due for longest."""
        found: list[T] = []
        while len(found) < most and self._heap and self._heap[0][0] <= now_us:
            if self._put_right():
                _, _, item = heappop(self._heap)
                del self._set_us[item]
                found.append(item)
        return found

    def earliest_us(self) -> int | None:
        """Return the earliest true time [µs]; None if there is none."""
        while self._heap:
            if self._put_right():
                return self._heap[0][0]
        return None

    def _put_right(self) -> bool:
        """Return whether the time on top is true; if it is not, correct or remove it."""
        set_us, _, item = self._heap[0]
        if self._set_us.get(item) != set_us:
            heappop(self._heap)
            return False
        time_us = self._when(item)
        if time_us is None:
            heappop(self._heap)
            del self._set_us[item]
            return False
        if time_us <= set_us:
            return True
        self._set_us[item] = time_us
        heapreplace(self._heap, (time_us, next(self._numbers), item))
        return False

    def _rebuild(self) -> None:
        self._heap = [(time_us, next(self._numbers), item) for item, time_us in self._set_us.items()]
        heapify(self._heap)


EACH_HZ: Final = 4_000
"""Steps between positions a second for one identity: four usual sessions in full, and a quarter of a core."""

ALL_HZ: Final = 12_000
"""Steps between positions a second for all."""

MOST_AT_ONCE: Final = 8
"""Steps in a row before positions that have arrived meanwhile are answered: they wait for half a millisecond."""


class LineSteps:
    """The sessions whose scenes are stepped between positions."""

    def __init__(self) -> None:
        self._alarms = Alarms(_next_step_us)
        self._rates_hz: dict[SlaveContext, int] = {}
        self._asked_hz: dict[Hashable, int] = {}  # by identity
        self._all_hz = 0  # what the identities get, together, if that is not above the limit

    def note(self, context: SlaveContext) -> None:
        """Note that a session was answered, so that it is to be stepped at another time."""
        reckoning = context.reckoning
        if (
            reckoning is None or reckoning.next_step_us() is None
        ):  # it waits for a position, so others may be stepped more
            self.forget(context)
            return
        if context not in self._rates_hz:
            self._rates_hz[context] = rate_hz = ceil(context.grant.rate_hz)
            self._ask(context.identity, rate_hz)
        reckoning.every = ceil(self._asked_hz[context.identity] / EACH_HZ) * ceil(self._all_hz / ALL_HZ)
        self._alarms.note(context)

    def forget(self, context: SlaveContext) -> None:
        """Remove a session."""
        rate_hz = self._rates_hz.pop(context, None)
        if rate_hz is not None:
            self._ask(context.identity, -rate_hz)
            self._alarms.forget(context)

    def due(self, now_us: int) -> list[SlaveContext]:
        """Return the sessions to step now, those first that wait for longest; call `note` after each step."""
        return self._alarms.due(now_us, MOST_AT_ONCE)

    def earliest_us(self) -> int | None:
        """Return when a session is to be stepped next [µs]; None if there is none."""
        return self._alarms.earliest_us()

    def _ask(self, identity: Hashable, more_hz: int) -> None:
        """Note that an identity has sessions of more, or fewer, steps a second in all."""
        before_hz = self._asked_hz.get(identity, 0)
        after_hz = before_hz + more_hz
        self._all_hz += min(after_hz, EACH_HZ) - min(before_hz, EACH_HZ)
        if after_hz:
            self._asked_hz[identity] = after_hz
        else:
            del self._asked_hz[identity]


def _next_step_us(context: SlaveContext) -> int | None:
    return None if context.reckoning is None else context.reckoning.next_step_us()
