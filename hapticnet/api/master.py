"""``hn.Master``, ``hn.ThreadedMaster``, ``hn.TickedMaster``: a master inside another program."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from typing import Any

from hapticnet.api.inputs import as_codec, serve_class
from hapticnet.api.live import LOG, EventQueue, InThread, NodeView, OnLoop, Ticked
from hapticnet.api.master_setup import Hand, MasterSetup, PositionLike
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.errors import RefusedError, SettingsError, UnavailableError
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
    """Callers that wait for the force at a position they have set."""

    name = "exchanges"

    def __init__(self, node: MasterNode) -> None:
        self._node = node
        self._waiting: list[tuple[int, asyncio.Future[Vector]]] = []

    def add(self) -> "asyncio.Future[Vector]":
        """Return the force in the next tick that sends the position."""
        future: asyncio.Future[Vector] = asyncio.get_running_loop().create_future()
        self._waiting.append((self._node.positions_due + 1, future))
        return future

    def observe(self, now_us: int) -> None:  # noqa: ARG002 - positions are counted
        """Answer the callers whose position has been sent."""
        if not self._waiting:
            return
        sent = self._node.positions_due
        due = [future for count, future in self._waiting if count <= sent]
        self._waiting = [each for each in self._waiting if each[0] > sent]
        for future in due:
            if not future.done():
                future.set_result(self._node.felt_n)

    def note(self, event: NodeEvent, now_us: int) -> None:  # noqa: ARG002 - only the end counts
        """Fail the waiting callers."""
        if isinstance(event, Ended):
            self.give_up(f"the session has ended: {event.reason}")

    def give_up(self, reason: str) -> None:
        """Fail all waiting callers."""
        for _, future in self._waiting:
            if not future.done():
                future.set_exception(UnavailableError(reason))
        self._waiting.clear()


class MasterView(NodeView[MasterNode, NodeEvent]):
    """A running master: position of the tool, held force, and state of the session."""

    _hand: Hand | None = None

    @property
    def position(self) -> Vector | None:
        """Position [m] of the newest tick, one value for each axis; None before there is a session. Assign to move.

        Raises
        ------
        SampleError
            On assignment of a value that is not finite or has another number of axes.
        SettingsError
            On assignment if an operator gives the positions.
        """
        return self._hand.position_m if self._hand is not None else self.node.position_m

    @position.setter
    def position(self, position: PositionLike) -> None:
        if self._hand is None:
            _ = self.node  # which must be running
            raise SettingsError("an operator gives the positions of this master")
        self._hand.move(position)

    @property
    def clutch(self) -> bool:
        """Whether the clutch is open: the tool stays where it is, without a force, while the hand moves. Assign it.

        Raises
        ------
        SettingsError
            On assignment if an operator gives the positions: its own ``clutched`` counts.
        """
        return self._hand is not None and self._hand.clutched

    @clutch.setter
    def clutch(self, is_open: bool) -> None:
        if self._hand is None:
            _ = self.node  # which must be running
            raise SettingsError("an operator gives the positions of this master; it may have an attribute clutched")
        self._hand.clutched = bool(is_open)

    @property
    def force_n(self) -> Vector:
        """Force [N] in the hand, one value for each axis; it decays to zero when the link goes stale."""
        return self.node.felt_n

    @property
    def connected(self) -> bool:
        """Whether there is a session now, stale or not."""
        return self.node.session.streaming

    @property
    def state(self) -> str:
        """State of the session: connecting, established, stale, closing or closed."""
        return self.node.session.state.value

    @property
    def scene(self) -> str | None:
        """The slave's name for the scene; None before there is a session."""
        return self.node.scene_name

    @property
    def ended(self) -> str | None:
        """Why the session ended for good; None before that."""
        return self.node.end_reason

    @property
    def adaptations(self) -> tuple[str, ...]:
        """How the force is adapted to the device, in words: which axes it renders, and where it is clipped."""
        return tuple(self.node.adaptations)

    @property
    def paused(self) -> str | None:
        """Why the operator is paused; None if it is not."""
        return self.node.paused

    def change(
        self,
        *,
        codec: str | Codec | None = None,
        weber_fraction: float | None = None,
        floor_n: float | None = None,
        multiplier: float | None = None,
    ) -> None:
        """Ask for another codec or JND while the session runs. Omitted values and the scene do not change.

        `Connected` or `ChangeRefused` follows as an event.

        Raises
        ------
        SettingsError
            If there is no such codec, or a value is out of range.
        """
        now = self.node.codec
        if floor_n is not None:  # the person's, as everywhere here
            floor_n /= self.node.settings.mapping.force_scale
        law = {"weber_fraction": weber_fraction, "floor_n": floor_n, "multiplier": multiplier}
        if codec is None or isinstance(codec, str):
            law = {name: getattr(now.law, name) if value is None else value for name, value in law.items()}
        own = registry.codec_parameters(now) if codec is None or codec == now.name else {}
        chosen = as_codec(now.name if codec is None else codec, **law, parameters=own)
        serve_class(type(chosen))
        self.node.change(codec=chosen.name, parameters=registry.codec_parameters(chosen), law=chosen.law)

    def resume(self) -> None:
        """Ask the operator for positions again after `Paused`; the force rises from zero."""
        self.node.resume()

    def _check_alive(self) -> None:
        """Raise the error that ended the session, if it has ended."""
        node = self.node
        if node.refused:
            raise RefusedError(f"the slave refused the session: {node.end_reason}")
        if node.finished:
            raise UnavailableError(f"the session has ended: {node.failure or node.end_reason}")


class _LiveMaster(MasterSetup, MasterView):
    """A master on an event loop."""

    @asynccontextmanager
    async def _live(self) -> AsyncIterator[None]:
        with self.opened_device() as (device, wire):
            node, self._hand, sock, address = self.make(device)
            self._node = node
            with closing(sock):
                self._events = EventQueue[NodeEvent]()
                self._exchanges = _Exchanges(node)
                stop = asyncio.Event()
                self._overload = Overload(scheduling(), LOG.warning)
                self._recording = self.recording(node)
                watchers: list[Watcher[NodeEvent]] = [self._events, self._exchanges]
                watchers += [] if self._recording is None else [self._recording]
                self._runner = MasterRunner(
                    node, sock, address, stop=stop, wire=wire, watchers=watchers, overload=self._overload,
                    tell=LOG.warning,
                )  # fmt: skip
                await self._runner.start()
                reason = "the program gave up"
                try:
                    if not await either(self._runner.connected, stop, self.connect_timeout_s):
                        raise UnavailableError(
                            f"no session with {self.address} within {self.connect_timeout_s:g} s: is the slave running"
                            " there?"
                        )
                    self._check_alive()
                    reason = "done"
                    yield
                finally:
                    try:  # the session is closed even if the program cancels this task
                        await asyncio.shield(self._runner.finish(reason))
                    finally:
                        self._exchanges.give_up("the master was left")
                        self._events.end()

    async def _exchange(self, position: PositionLike) -> Vector:
        self._check_alive()
        self.position = position
        return await self._exchanges.add()

    def _report(self, node: MasterNode) -> dict[str, Any]:
        recorder = None if self._recording is None else self._recording.recorder
        return master_report(node, self._runner.account(node.end_reason), self._overload, recorder=recorder)


@dataclass(eq=False)
class Master(_LiveMaster, OnLoop[MasterNode, NodeEvent]):
    """A master on the program's own event loop (asyncio or uvloop). See `MasterSetup` for the parameters.

    ::

        async with hn.Master("host:47800", codec="deadband") as master:
            force_n = await master.exchange(0.012)

    Entering waits for a session. The session then lives in the background: positions are sent at `rate_hz` whether the
    program sets new ones or not, and a slave that disappears is asked again. Signals are left to the program.

    Raises
    ------
    SettingsError, SampleError, FileError
        On entering, if a parameter cannot be used.
    UnavailableError
        On entering, if there is no such host or no slave answers within `connect_timeout_s`.
    RefusedError
        On entering, if the slave refuses the session.
    """

    async def exchange(self, position: PositionLike) -> Vector:
        """Set the position [m], wait until it is sent, and return the force [N] held then.

        A loop of calls runs at the rate of the session. The force is the answer to earlier positions.

        Raises
        ------
        SampleError
            If the position is not finite or has another number of axes.
        UnavailableError
            If the session has ended.
        """
        return await self._exchange(position)


@dataclass(eq=False)
class ThreadedMaster(_LiveMaster, InThread[MasterNode, NodeEvent]):
    """A master in its own thread, for programs without asyncio. See `MasterSetup` for the parameters.

    ::

        with hn.ThreadedMaster("host:47800") as master:
            master.position = 0.012
            print(master.force_n)

    `position` and `force_n` may be used at any time and do not wait. The thread shares the interpreter with the
    program: code that holds it for milliseconds delays positions. Raises on entering what `Master` raises.
    """

    def exchange(self, position: PositionLike) -> Vector:
        """Set the position [m], wait until it is sent, and return the force [N]; see `Master.exchange`."""
        return self._wait_for(self._exchange(position))

    def change(self, **changes: Any) -> None:
        """Ask for another codec or JND while the session runs; see `MasterView.change`."""

        async def change() -> None:
            MasterView.change(self, **changes)

        self._wait_for(change())


@dataclass(eq=False)
class TickedMaster(MasterSetup, MasterView, Ticked[MasterNode, NodeEvent]):
    """A master without loop or thread: the program calls `tick` from its own timer. See `MasterSetup`.

    ::

        master = hn.TickedMaster("host:47800", rate_hz=500)
        ...                                   # in a timer callback, 500 times a second:
        force_n = master.tick(position)

    Nothing waits: the session begins some ticks after the slave appears (`connected`); the force is 0 before. The timer
    must be as fast as `rate_hz`; calls that come sooner send no position.

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
        with ExitStack() as opening:
            device, wire = opening.enter_context(self.opened_device())
            if wire is not None:
                raise SettingsError("a serial device needs hn.Master or hn.ThreadedMaster, which have an event loop")
            self._node, self._hand, self._sock, self._slave = self.make(device)
            self._opened = opening.pop_all()
        self._events = EventQueue[NodeEvent]()
        self._due_us = self._unknown_peers = 0

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
        for data, address in self._arrived():
            now = now_us()
            if address == self._slave:
                node.receive_datagram(data, now)
            else:
                self._unknown_peers += 1
            if now >= end_us:
                break
        now = now_us()
        if 2 * (self._due_us - now) <= node.period_us:  # one early call does not make a faster timer
            self._due_us = (self._due_us if now - self._due_us < node.period_us else now) + node.period_us
            node.tick(now)
            self._send()
            node.drive(now)
        node.check(now, waited_us)
        self._send()
        return node.felt_n

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

    def _part(self) -> None:
        self.node.close("done", now_us())
        self._send()
        self._opened.close()

    def _send(self) -> None:
        for data in self.node.datagrams_to_send():
            self._put(data, self._slave)
        while (event := self.node.next_event()) is not None:
            self._events.note(event, now_us())
