"""The events of a node for the program around it: a bounded queue, to be iterated or taken."""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator
from typing import Final, Generic, TypeVar

from hapticnet.runtime.watching import Watcher

LOG: Final = logging.getLogger("hapticnet")
"""Where a program finds what is worth a warning, such as a recording that meets a full disk."""

Event = TypeVar("Event")

EVENTS_KEPT: Final = 1000
"""Events that wait for a program; of more, the oldest are dropped."""


class EventQueue(Watcher[Event], Generic[Event]):
    """Events in the order in which they happened."""

    name = "events"

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._arrived: asyncio.Event | None = None
        self._over = False

    def note(self, event: Event, now_us: int) -> None:  # noqa: ARG002 - events have no time
        """Keep an event."""
        self._events.append(event)
        self._wake()

    def take(self) -> list[Event]:
        """Return the events since the last call. Can be called from another thread."""
        events: list[Event] = []
        while self._events:
            events.append(self._events.popleft())
        return events

    def end(self) -> None:
        """Let iterations end once all events are taken."""
        self._over = True
        self._wake()

    async def each(self) -> AsyncIterator[Event]:
        """Iterate over the events until the run has ended; one iteration at a time."""
        self._arrived = asyncio.Event()
        while True:
            while self._events:
                yield self._events.popleft()
            if self._over:
                return
            self._arrived.clear()
            await self._arrived.wait()

    def _wake(self) -> None:
        if self._arrived is not None:
            self._arrived.set()
