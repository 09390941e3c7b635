"""The earliest of many times that mostly move later."""

from collections.abc import Callable, Hashable, Iterable
from heapq import heapify, heappop, heappush, heapreplace
from itertools import count
from typing import Final, Generic, TypeVar

SLACK: Final = 64
"""Entries that are out of date and may stay in a heap, beside one for each that is in use."""

T = TypeVar("T", bound=Hashable)


class Alarms(Generic[T]):
    """Tell which of many things are due, without a look at the others.

    A heap holds one time for each that is never later than its true time. A time that moves later is put right only
    when it comes to the top; one that moves earlier must be noted.

    Parameters
    ----------
    when
        Returns the true time of one [µs], now; None if it has none.
    """

    def __init__(self, when: Callable[[T], int | None]) -> None:
        self._when = when
        self._set_us: dict[T, int] = {}
        self._heap: list[tuple[int, int, T]] = []
        self._numbers = count()  # so that two of the same time are not compared

    def note(self, item: T) -> None:
        """Take in that the time of one may be earlier than before, or that it is new."""
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
        """Take in that one is gone."""
        self._set_us.pop(item, None)

    def note_all(self, items: Iterable[T]) -> None:
        """Begin again with the true times of all."""
        times = ((item, self._when(item)) for item in items)
        self._set_us = {item: time_us for item, time_us in times if time_us is not None}
        self._rebuild()

    def due(self, now_us: int) -> list[T]:
        """Return all whose time has come, in no order. Those that stay must be noted again."""
        found = []
        while self._heap and self._heap[0][0] <= now_us:
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

    def not_before_us(self) -> int | None:
        """Return a time [µs] before which none is due, at less cost than `earliest_us`; None if there is none."""
        while self._heap and self._set_us.get(self._heap[0][2]) != self._heap[0][0]:
            heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def _put_right(self) -> bool:
        """Return whether the time on top is true; if not, it is not on top any more."""
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
