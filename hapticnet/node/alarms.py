"""The earliest of many times that mostly move later."""

from collections.abc import Callable, Hashable, Iterable
from heapq import heapify, heappop, heappush, heapreplace
from itertools import count
from typing import Final, Generic, TypeVar

SLACK: Final = 64
"""A heap is rebuilt when it has this many entries more than twice the number of items."""

MOST: Final = 1 << 62
"""More items than there can be."""

T = TypeVar("T", bound=Hashable)


class Alarms(Generic[T]):
    """Tell which of many items are due, without looking at the others.

    A heap holds a time for each item that is never later than its true time. A time that moves later is corrected only
    when it comes to the top; one that moves earlier must be noted.

    Parameters
    ----------
    when
        Returns the present true time of an item [µs]; None if it has none.
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

    def note_all(self, items: Iterable[T]) -> None:
        """Replace all items, with their true times."""
        times = ((item, self._when(item)) for item in items)
        self._set_us = {item: time_us for item, time_us in times if time_us is not None}
        self._rebuild()

    def due(self, now_us: int, most: int = MOST) -> list[T]:
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

    def not_before_us(self) -> int | None:
        """Return a time [µs] before which no item is due, at less cost than `earliest_us`; None without items."""
        while self._heap and self._set_us.get(self._heap[0][2]) != self._heap[0][0]:
            heappop(self._heap)
        return self._heap[0][0] if self._heap else None

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
