"""``hn.Slave``, ``hn.ThreadedSlave``, ``hn.TickedSlave``: a slave inside another program."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from hapticnet.api.events import LOG, EventQueue
from hapticnet.api.slave_setup import SlaveSetup, address_of
from hapticnet.api.threads import LoopThread
from hapticnet.api.ticked import TickedSocket
from hapticnet.api.views import SlaveView
from hapticnet.node.events import SlaveEvent
from hapticnet.node.slave import SlaveNode
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.runners import SlaveRunner, slave_report
from hapticnet.runtime.system import now_us, scheduling, waited_us


@dataclass(eq=False)
class Slave(SlaveSetup, SlaveView):
    """A slave on the program's own event loop. See `SlaveSetup` for the parameters.

    ::

        async with hn.Slave(my_robot, listen="0.0.0.0:47800", key="key.toml", masters="masters.toml") as slave:
            async for event in slave.events():
                print(event)

    ``step`` is called on the loop for each position and must not wait. Signals are left to the program.

    Raises
    ------
    SettingsError, FileError
        On entering, if a parameter cannot be used.
    UnavailableError
        On entering, if the address is taken or of another host.
    """

    async def __aenter__(self) -> Self:
        self._node, sock = self.make()
        self.address = address_of(sock)
        self._events = EventQueue[SlaveEvent]()
        self._overload = Overload(scheduling(), LOG.warning)
        self._runner = SlaveRunner(self._node, sock, watchers=[self._events], overload=self._overload, tell=LOG.warning)
        await self._runner.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.shield(self._runner.finish("shutting down"))
        self.close_scenes()
        self._events.end()

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        return slave_report(node, self._overload)

    def events(self) -> AsyncIterator[SlaveEvent]:
        """Return the events, to be iterated with ``async for``: MasterJoined, MasterLeft, ScenePaused and so on."""
        return self._events.each()


@dataclass(eq=False)
class ThreadedSlave(SlaveSetup, SlaveView):
    """A slave in a thread of its own, for programs without asyncio. See `SlaveSetup` for the parameters.

    ::

        with hn.ThreadedSlave(my_engine) as slave:
            print(slave.address)

    ``step`` is called in that thread. Raises on entering what `Slave` raises.
    """

    def __enter__(self) -> Self:
        self._slave = Slave(**{name: getattr(self, name) for name in SlaveSetup.__dataclass_fields__ if name != "_"})
        self._thread = LoopThread(self._slave, "hapticnet slave")
        self._node, self.address = self._slave._node, self._slave.address
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.leave()

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        return self._slave._report(node)

    def take_events(self) -> list[SlaveEvent]:
        """Return the events since the last call."""
        return self._slave._events.take()


@dataclass(eq=False)
class TickedSlave(SlaveSetup, SlaveView):
    """A slave without loop or thread: the program calls `tick` from its own loop. See `SlaveSetup`.

    ::

        slave = hn.TickedSlave(my_engine)
        ...                        # in the engine's loop, 1000 times a second:
        slave.tick()

    An answer waits for the next `tick`, so the force is up to a tick older. Raises what `Slave` raises.
    """

    def __post_init__(self) -> None:
        self._node, sock = self.make()
        self.address = address_of(sock)
        self._socket = TickedSocket(sock, "slave")
        self._events = EventQueue[SlaveEvent]()

    @property
    def send_errors(self) -> int:
        """Datagrams that could not be sent or delivered."""
        return self._socket.errors

    def tick(self) -> None:
        """Answer what has arrived; each session gets the force at its newest position."""
        node, now = self.node, now_us()
        node.receive_datagrams(list(self._socket.arrived()), now)
        due_us = node.next_timer_us()
        if due_us is not None and now >= due_us:
            node.tick(now)
        node.check(now, waited_us)
        self._send()
        node.account_sent(now)
        self._send()

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        return slave_report(node, Overload(scheduling(), LOG.warning))

    def take_events(self) -> list[SlaveEvent]:
        """Return the events since the last call."""
        return self._events.take()

    def close(self) -> None:
        """End every session and close the socket."""
        if self._socket.is_open:
            self.node.close("shutting down", now_us())
            self._send()
            self._socket.close()
            self.close_scenes()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _send(self) -> None:
        for data, address in self.node.datagrams_to_send():
            self._socket.send(data, address)
        while (event := self.node.next_event()) is not None:
            self._events.note(event, now_us())
