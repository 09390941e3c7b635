"""``hn.Slave``, ``hn.ThreadedSlave``, ``hn.TickedSlave``: a slave inside another program."""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import KW_ONLY, dataclass
from socket import socket
from typing import Annotated, Any, TypeAlias

from hapticnet import options
from hapticnet.api.inputs import serve_class
from hapticnet.api.live import LOG, EventQueue, InThread, NodeView, OnLoop, Ticked
from hapticnet.codec import registry
from hapticnet.errors import SettingsError
from hapticnet.files import user_path
from hapticnet.node.events import SlaveEvent
from hapticnet.node.settings import OnError, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.options import Option, check_options, described
from hapticnet.protocol.settings import SessionSettings
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.runners import SlaveRunner, slave_report
from hapticnet.runtime.scene_port import find_live_source
from hapticnet.runtime.system import SystemEntropy, now_us, scheduling, waited_us
from hapticnet.runtime.trust import SlaveTrust, slave_trust
from hapticnet.runtime.udp import bound_address, host_of, is_loopback, listen, parse_host_port, text_of
from hapticnet.scene.base import HasStep, Touchable
from hapticnet.scene.sources import as_touchable

SceneLike: TypeAlias = str | HasStep | Callable[[], HasStep]
"""The name of a scene, an object with a method ``step``, or a function that makes one for each master."""


@described
@dataclass
class SlaveSetup(options.SharedSlaveOptions):
    """Parameters of a slave.

    They are checked when the slave opens.
    """

    scene: Annotated[
        SceneLike,
        Option(
            'What masters touch: the name of a scene (``"paper:SEED"``, a preset, a .toml file, ``"udp:PORT"``,'
            ' ``"FILE.py:Class"``), an object with a method ``step(sample)`` that returns the force [N], or a class or'
            " function that makes"
            " such an object for each master. An object is touched by one master at a time."
        ),
    ] = "paper:0"
    _: KW_ONLY
    key: options.KeyPath = None
    masters: options.MastersPath = None
    codecs: Annotated[
        Sequence[str | type[Any]],
        Option('Codecs of yours that masters may ask for: classes, ``"FILE.py:Class"`` or ``"package.module:Class"``.'),
    ] = ()
    keep_s: options.Keep = 30.0
    fastest_rate_hz: options.FastestRate = 10_000.0
    on_error: Annotated[
        OnError,
        Option(
            'What an exception in ``step`` does: ``"end"`` the session, or ``"pause"``, which answers with zero force'
            " until `resume`."
        ),
    ] = "end"

    def make(self) -> tuple[SlaveNode, socket]:
        """Return the node and a socket that listens; raise a HapticnetError if this is impossible."""
        check_options(self)
        self._closing: list[Callable[[], list[str]]] = []
        make_scene, most = self._scenes()
        for each in self.codecs:
            if isinstance(each, str):
                registry.parse_codec(each)
            else:
                serve_class(each)
        sock = listen(parse_host_port(self.listen, lowest_port=0))
        try:
            key, masters = (None if path is None else user_path(path) for path in (self.key, self.masters))
            loopback = is_loopback(sock.getsockname())
            trust = slave_trust(bound_address(sock), loopback, key, masters, self.insecure, str)
            if trust.guests is not None:
                self._closing.append(trust.guests.close)
            settings = SlaveSettings(
                fastest_rate_hz=self.fastest_rate_hz,
                on_error=self.on_error,
                announces=self.announce,
                session=SessionSettings(
                    most_sessions=most, most_per_identity=self.most_sessions_per_key, keep_us=round(self.keep_s * 1e6)
                ),
            )
            node = slave_node(make_scene, settings, trust)
        except BaseException:
            sock.close()
            raise
        return node, sock

    def _scenes(self) -> tuple[Callable[[], Touchable], int]:
        """Return the factory of scenes, and how many masters may be served at once."""
        given = self.scene
        if isinstance(given, str):
            source = find_live_source(given)
            source.prepare()
            for risk in source.risks:
                LOG.warning(risk)
            self._closing.append(source.close)
            return source.make, self.most_sessions
        if hasattr(given, "step") and not isinstance(given, type):
            touched = as_touchable(given)
            return lambda: touched, 1
        if not callable(given):
            raise SettingsError(f"scene is {given!r}; it must be text, an object with step(sample), or a function")
        make: Callable[[], Any] = given
        as_touchable(make())  # refuse it now instead of when a master joins
        return lambda: as_touchable(make()), self.most_sessions

    def close_scenes(self) -> None:
        """Close the user's objects that were made here, and log errors."""
        for close in self._closing:
            for fault in close():
                LOG.warning(fault)


def slave_node(make_scene: Callable[[], Touchable], settings: SlaveSettings, trust: SlaveTrust) -> SlaveNode:
    """Return a node that serves its scene to trusted masters, or their own scene to masters that have one."""
    entropy = SystemEntropy()
    return SlaveNode(
        lambda entry: make_scene() if (listed := trust.scene_of(entry)) is None else listed.make(),
        settings,
        entropy,
        doors=trust.doors(entropy),
        write_address=text_of,
        host_of=host_of,
        clock=now_us,
    )


class SlaveView(NodeView[SlaveNode, SlaveEvent]):
    """A running slave."""

    address: str = ""
    """The address where it listens, HOST:PORT; empty if it does not."""

    @property
    def connected(self) -> tuple[str, ...]:
        """Names of the masters that have a session now."""
        return tuple(context.session.request.name for context in self.node.contexts if context.seated)

    def resume(self) -> None:
        """Step failed and paused scenes again."""
        self.node.resume()


class _LiveSlave(SlaveSetup, SlaveView):
    """A slave on an event loop."""

    @asynccontextmanager
    async def _live(self) -> AsyncIterator[None]:
        self._node, sock = self.make()
        self.address = str(bound_address(sock))
        self._events = EventQueue[SlaveEvent]()
        self._overload = Overload(scheduling(), LOG.warning)
        runner = SlaveRunner(self._node, sock, watchers=[self._events], overload=self._overload, tell=LOG.warning)
        await runner.start()
        try:
            yield
        finally:
            await asyncio.shield(runner.finish("shutting down"))
            self.close_scenes()
            self._events.end()

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        return slave_report(node, self._overload)


@dataclass(eq=False)
class Slave(_LiveSlave, OnLoop[SlaveNode, SlaveEvent]):
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


@dataclass(eq=False)
class ThreadedSlave(_LiveSlave, InThread[SlaveNode, SlaveEvent]):
    """A slave in its own thread, for programs without asyncio. See `SlaveSetup` for the parameters.

    ::

        with hn.ThreadedSlave(my_engine) as slave:
            print(slave.address)

    ``step`` is called in that thread. Raises on entering what `Slave` raises.
    """


@dataclass(eq=False)
class TickedSlave(SlaveSetup, SlaveView, Ticked[SlaveNode, SlaveEvent]):
    """A slave without loop or thread: the program calls `tick` from its own loop. See `SlaveSetup`.

    ::

        slave = hn.TickedSlave(my_engine)
        ...                        # in the engine's loop, 1000 times a second:
        slave.tick()

    An answer waits for the next `tick`, so the force is up to a tick older. Raises what `Slave` raises.
    """

    def __post_init__(self) -> None:
        self._node, self._sock = self.make()
        self.address = str(bound_address(self._sock))
        self._events = EventQueue[SlaveEvent]()

    def tick(self) -> None:
        """Answer the datagrams that have arrived; each session gets the force at its newest position."""
        node, now = self.node, now_us()
        node.receive_datagrams(list(self._arrived()), now)
        due_us = node.next_timer_us()
        if due_us is not None and now >= due_us:
            node.tick(now)
        node.check(now, waited_us)
        self._send()
        node.account_sent(now)
        self._send()

    def _report(self, node: SlaveNode) -> dict[str, Any]:
        return slave_report(node, Overload(scheduling(), LOG.warning))

    def _part(self) -> None:
        self.node.close("shutting down", now_us())
        self._send()
        self.close_scenes()

    def _send(self) -> None:
        for data, address in self.node.datagrams_to_send():
            self._put(data, address)
        while (event := self.node.next_event()) is not None:
            self._events.note(event, now_us())
