"""What masters and slaves inside other programs share: their events, and the three ways to run them."""

import asyncio
import logging
import threading
from collections import deque
from collections.abc import AsyncIterator, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager
from socket import socket
from types import TracebackType
from typing import Any, Final, Generic, Self, TypeVar

from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.runtime.system import loop_factory
from hapticnet.runtime.udp import DRAIN_AT_MOST, READ_BYTES, SocketAddress
from hapticnet.runtime.watching import Event, Watcher

LOG: Final = logging.getLogger("hapticnet")
"""Logger of warnings, such as a full disk during a recording."""

EVENTS_KEPT: Final = 1000  # events that wait for a program; beyond that, the oldest are dropped

Node = TypeVar("Node", MasterNode, SlaveNode)
Result = TypeVar("Result")


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


class NodeView(Generic[Node, Event]):
    """A running node, or none."""

    _node: Node | None = None
    _events: EventQueue[Event]

    @property
    def node(self) -> Node:
        """The node itself, for anything not offered here; its interface may change.

        Raises
        ------
        UnavailableError
            If it is not running.
        """
        if self._node is None:
            raise UnavailableError(f"this {type(self).__name__} is not running; enter it with 'with' or 'async with'")
        return self._node

    def report(self) -> dict[str, Any]:
        """Return the account, as the command prints it with ``--json``.

        Missing values are None, such as a master's `end_reason` while it runs.

        Raises
        ------
        UnavailableError
            If it is not running.
        """
        return {**self._report(self.node), "provenance": provenance()}

    def _report(self, node: Node) -> dict[str, Any]:
        raise NotImplementedError


class Live(NodeView[Node, Event]):
    """A node on an event loop."""

    def _live(self) -> AbstractAsyncContextManager[None]:
        """Return the context that runs the node on the running loop."""
        raise NotImplementedError


class OnLoop(Live[Node, Event]):
    """A node on the program's own event loop, entered with ``async with``."""

    async def __aenter__(self) -> Self:
        self._living = self._live()
        await self._living.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._living.__aexit__(kind, error, trace)

    def events(self) -> AsyncIterator[Event]:
        """Return the events, to be iterated with ``async for``; docs/refer/api.md names them.

        The iteration ends with the run. At most 1000 events wait.
        """
        return self._events.each()


class InThread(Live[Node, Event]):
    """A node on an event loop in its own thread, entered with ``with``.

    The thread is a daemon: a program that ends without leaving it still ends.
    """

    def __enter__(self) -> Self:
        self._entered: Future[None] = Future()
        self._thread: threading.Thread = threading.Thread(
            target=self._run, name=f"hapticnet {type(self).__name__}", daemon=True
        )
        self._thread.start()
        try:
            self._entered.result()
        except BaseException as error:
            if not self._entered.done():  # Ctrl-C while waiting
                self._loop.call_soon_threadsafe(self._task.cancel)
            self._thread.join()
            raise error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._left.set)
        self._thread.join()

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._events.take()

    def _wait_for(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Run a coroutine on the loop, wait for it, and return its result."""
        if not self._thread.is_alive():
            work.close()
            raise UnavailableError("this master or slave has ended; enter it again")
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=loop_factory()) as runner:
                self._loop = runner.get_loop()
                runner.run(self._stay())
        except asyncio.CancelledError:
            pass
        except BaseException as error:
            if self._entered.done():
                raise
            self._entered.set_exception(error)

    async def _stay(self) -> None:
        self._left = asyncio.Event()
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - for the type checker: this is a task
        self._task = task
        async with self._live():
            self._entered.set_result(None)
            await self._left.wait()


class Ticked(NodeView[Node, Event]):
    """A node without loop or thread, on a non-blocking socket."""

    send_errors = 0
    """Datagrams that could not be sent or delivered; they count as lost."""

    _sock: socket

    def close(self) -> None:
        """End every session and close the socket. Notify the other side, but do not wait for its answer."""
        if self._sock.fileno() >= 0:
            self._part()
            self._sock.close()

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._events.take()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _part(self) -> None:
        """End every session."""
        raise NotImplementedError

    def _arrived(self) -> Iterator[tuple[bytes, SocketAddress]]:
        """Yield the datagrams that have arrived, with their senders; raise SettingsError if the socket is closed."""
        if self._sock.fileno() < 0:
            raise SettingsError(f"this {type(self).__name__} is closed")
        for _ in range(DRAIN_AT_MOST):
            try:
                yield self._sock.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an earlier datagram could not be delivered
                self.send_errors += 1

    def _put(self, data: bytes, address: SocketAddress) -> None:
        try:
            self._sock.sendto(data, address)
        except OSError:
            self.send_errors += 1
