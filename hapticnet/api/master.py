"""``hn.Master``, ``hn.ThreadedMaster``, ``hn.TickedMaster``: a master inside another program."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from hapticnet.api.events import LOG, EventQueue
from hapticnet.api.master_setup import MasterSetup, PositionLike
from hapticnet.api.threads import LoopThread
from hapticnet.api.ticked import TickedSocket
from hapticnet.api.views import MasterView
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.node.events import NodeEvent
from hapticnet.node.master import MasterNode
from hapticnet.protocol.states import Ended
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.runners import MasterRun, MasterRunner, master_report
from hapticnet.runtime.system import now_us, scheduling, waited_us
from hapticnet.runtime.timer import either
from hapticnet.runtime.udp import DRAIN_US
from hapticnet.runtime.watching import Watcher
from hapticnet.samples import Vector


class _Exchanges(Watcher[NodeEvent]):
    """Those who wait for the force at a position that they have set."""

    name = "exchanges"

    def __init__(self, view: MasterView) -> None:
        self._view = view
        self._waiting: list[tuple[int, asyncio.Future[Vector]]] = []

    def add(self) -> "asyncio.Future[Vector]":
        """Return the force in the next tick in which a position is due: it sends the one that was set."""
        future: asyncio.Future[Vector] = asyncio.get_running_loop().create_future()
        self._waiting.append((self._view.node.positions_due + 1, future))
        return future

    def observe(self, now_us: int) -> None:  # noqa: ARG002 - positions are counted
        """Answer those whose position is on its way."""
        if not self._waiting:
            return
        node = self._view.node
        due = [future for count, future in self._waiting if count <= node.positions_due]
        self._waiting = [each for each in self._waiting if each[0] > node.positions_due]
        for future in due:
            if not future.done():
                future.set_result(node.held_n)

    def note(self, event: NodeEvent, now_us: int) -> None:  # noqa: ARG002 - only the end counts
        """Tell them that there will be no answer."""
        if isinstance(event, Ended):
            self.give_up(f"the session has ended: {event.reason}")

    def give_up(self, reason: str) -> None:
        """Tell all who wait that there will be no answer."""
        for _, future in self._waiting:
            if not future.done():
                future.set_exception(UnavailableError(reason))
        self._waiting.clear()


@dataclass(eq=False)
class Master(MasterSetup, MasterView):
    """A master on the program's own event loop (asyncio or uvloop). See `MasterSetup` for the parameters.

    ::

        async with hn.Master("host:47800", codec="deadband") as master:
            force_n = await master.exchange(0.012)

    Entering waits for a session. The session then lives in the background: positions are sent at `rate_hz` whether the
    program sets new ones or not, and a slave that goes away is asked again. Signals are left to the program.

    Raises
    ------
    SettingsError, SampleError, FileError
        On entering, if a parameter cannot be used.
    UnavailableError
        On entering, if there is no such host or no slave answers within `connect_timeout_s`.
    RefusedError
        On entering, if the slave refuses the session.
    """

    async def __aenter__(self) -> Self:
        with ExitStack() as opening:
            device, wire = opening.enter_context(self.opened_device())
            self._node, self._hand, sock, address = self.make(device)
            opening.callback(sock.close)
            self._events = EventQueue[NodeEvent]()
            self._exchanges = _Exchanges(self)
            stop = asyncio.Event()
            self._overload = Overload(scheduling(), LOG.warning)
            self._recording = self.recording(self._node)
            watchers: list[Watcher[NodeEvent]] = [self._events, self._exchanges]
            watchers += [] if self._recording is None else [self._recording]
            self._runner = MasterRunner(
                self._node, sock, address, stop=stop, wire=wire, watchers=watchers, overload=self._overload,
                tell=LOG.warning,
            )  # fmt: skip
            await self._runner.start()
            self._opened = opening.pop_all()
        try:
            if not await either(self._runner.connected, stop, self.connect_timeout_s):
                raise UnavailableError(
                    f"no session with {self.address} within {self.connect_timeout_s:g} s: is the slave running there?"
                )
            self._check_alive()
        except BaseException:
            await self._leave("the program gave up")
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._leave("done")

    async def exchange(self, position: PositionLike) -> Vector:
        """Set the position [m], wait until it is sent, and return the force [N] that is held then.

        A loop of calls runs at the rate of the session. The force is the answer to earlier positions.

        Raises
        ------
        SampleError
            If the position is not finite or has another number of axes.
        UnavailableError
            If the session has ended.
        """
        self._check_alive()
        self.position = position
        return await self._exchanges.add()

    def events(self) -> AsyncIterator[NodeEvent]:
        """Return the events, to be iterated with ``async for``: Connected, LinkStale, Failed and so on.

        The iteration ends with the session. At most 1000 events wait.
        """
        return self._events.each()

    def _report(self, node: MasterNode) -> dict[str, Any]:
        recorder = None if self._recording is None else self._recording.recorder
        return master_report(node, self._runner.account(node.end_reason), self._overload, recorder=recorder)

    async def _leave(self, reason: str) -> None:
        # The session is closed even if the program cancels this task.
        try:
            await asyncio.shield(self._runner.finish(reason))
        finally:
            self._opened.close()
        self._exchanges.give_up("the master was left")
        self._events.end()


@dataclass(eq=False)
class ThreadedMaster(MasterSetup, MasterView):
    """A master in a thread of its own, for programs without asyncio. See `MasterSetup` for the parameters.

    ::

        with hn.ThreadedMaster("host:47800") as master:
            master.position = 0.012
            print(master.force_n)

    `position` and `force_n` may be used at any time and do not wait. The thread shares the interpreter with the
    program: code that holds it for milliseconds delays positions. Raises on entering what `Master` raises.
    """

    def __enter__(self) -> Self:
        self._master = Master(**{name: getattr(self, name) for name in MasterSetup.__dataclass_fields__ if name != "_"})
        self._thread = LoopThread(self._master, f"hapticnet {self.name}")
        self._node, self._hand = self._master._node, self._master._hand
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.leave()

    def exchange(self, position: PositionLike) -> Vector:
        """Set the position [m], wait until it is sent, and return the force [N] that is held then.

        A loop of calls runs at the rate of the session. The force is the answer to earlier positions.

        Raises
        ------
        SampleError
            If the position is not finite or has another number of axes.
        UnavailableError
            If the session has ended.
        """
        return self._thread.wait_for(self._master.exchange(position))

    def _report(self, node: MasterNode) -> dict[str, Any]:
        return self._master._report(node)

    def take_events(self) -> list[NodeEvent]:
        """Return the events since the last call."""
        return self._master._events.take()

    def change(self, **changes: Any) -> None:
        """Ask for another codec or JND while the session runs; see `MasterView.change`."""

        async def change() -> None:
            self._master.change(**changes)

        self._thread.wait_for(change())


@dataclass(eq=False)
class TickedMaster(MasterSetup, MasterView):
    """A master without loop or thread: the program calls `tick` from its own timer. See `MasterSetup`.

    ::

        master = hn.TickedMaster("host:47800", rate_hz=500)
        ...                                   # in a timer callback, 500 times a second:
        force_n = master.tick(position)

    Nothing waits: there is a session some ticks after the slave is there (`connected`), and no force before. The timer
    must be as fast as `rate_hz`; calls that come sooner than that send no position.

    Raises
    ------
    SettingsError, SampleError, FileError
        If a parameter cannot be used.
    UnavailableError
        If there is no such host.
    """

    def __post_init__(self) -> None:
        if self.record is not None:
            raise SettingsError("record needs hn.Master or hn.ThreadedMaster, which have an event loop")
        self._opened = ExitStack()
        device, wire = self._opened.enter_context(self.opened_device())
        if wire is not None:
            self._opened.close()
            raise SettingsError("a serial device needs hn.Master or hn.ThreadedMaster, which have an event loop")
        self._node, self._hand, sock, self._slave = self.make(device)
        self._socket = TickedSocket(sock, "master")
        self._events = EventQueue[NodeEvent]()
        self._due_us = self._unknown_peers = 0

    @property
    def send_errors(self) -> int:
        """Datagrams that could not be sent or delivered."""
        return self._socket.errors

    def tick(self, position: PositionLike | None = None) -> Vector:
        """Set the position [m] if there is one, exchange datagrams, and return the force [N] that is held.

        The force is zero before there is a session and after it has ended; `ended` gives the reason.

        Raises
        ------
        SampleError
            If the position is not finite or has another number of axes.
        SettingsError
            If a position is given although an operator gives them.
        """
        if position is not None:
            self.position = position
        node = self.node
        end_us = now_us() + DRAIN_US
        for data, address in self._socket.arrived():
            now = now_us()
            if address == self._slave:
                node.receive_datagram(data, now)
            else:
                self._unknown_peers += 1
            if now >= end_us:
                break
        now = now_us()
        if 2 * (self._due_us - now) <= node.period_us:  # a timer that is early once is no faster timer
            self._due_us = (self._due_us if now - self._due_us < node.period_us else now) + node.period_us
            node.tick(now)
            self._send()
            node.drive(now)
        node.check(now, waited_us)
        self._send()
        return node.held_n

    def _report(self, node: MasterNode) -> dict[str, Any]:
        run = MasterRun(
            end_reason=node.end_reason,
            connected=node.connected,
            lateness=Distribution().report(),
            missed_ticks=None,
            send_errors=self.send_errors,
            unknown_peers=self._unknown_peers,
            port_openings=None,
            port_unwritten_bytes=None,
        )
        return master_report(node, run, Overload(scheduling(), LOG.warning))

    def take_events(self) -> list[NodeEvent]:
        """Return the events since the last call."""
        return self._events.take()

    def close(self) -> None:
        """End the session and close the socket. The slave is told, but its answer is not waited for."""
        if self._socket.is_open:
            self.node.close("done", now_us())
            self._send()
            self._socket.close()
            self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _send(self) -> None:
        for data in self.node.datagrams_to_send():
            self._socket.send(data, self._slave)
        while (event := self.node.next_event()) is not None:
            self._events.note(event, now_us())
