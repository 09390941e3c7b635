"""What a slave inside another program is made of: its parameters, checked, and its node."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from hapticnet import options
from hapticnet.api.events import LOG
from hapticnet.codec import registry
from hapticnet.codec.plugins import checked_class
from hapticnet.errors import SettingsError
from hapticnet.files import user_path
from hapticnet.node.settings import OnError, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.options import Option, check_options, described
from hapticnet.protocol.settings import SessionSettings
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.runtime.trust import SlaveTrust, slave_trust
from hapticnet.runtime.udp import HostPort, SocketAddress, bound_address, host_of, is_loopback, listen, parse_host_port
from hapticnet.scene.base import HasStep, Touchable
from hapticnet.scene.sources import as_touchable, find_source

if TYPE_CHECKING:
    import socket

SceneLike: TypeAlias = str | HasStep | Callable[[], HasStep]
"""The name of a scene, an object with a method ``step``, or a function that makes one for each master."""


@described
@dataclass
class SlaveSetup:
    """Parameters of a slave.

    They are checked when the slave opens.
    """

    scene: Annotated[
        SceneLike,
        Option(
            'What masters touch: the name of a scene (``"paper:SEED"``, a preset, a .toml file, ``"FILE.py:Class"``),'
            " an object with a method ``step(sample)`` that returns the force [N], or a class or function that makes"
            " such an object for each master. An object is touched by one master at a time."
        ),
    ] = "paper:0"
    _: KW_ONLY
    listen: options.Listen = "127.0.0.1:47800"
    key: options.KeyPath = None
    masters: options.MastersPath = None
    insecure: options.Insecure = False
    codecs: Annotated[
        Sequence[str | type[Any]],
        Option('Codecs of yours that masters may ask for: classes, ``"FILE.py:Class"`` or ``"package.module:Class"``.'),
    ] = ()
    keep_s: options.Keep = 30.0
    fastest_rate_hz: options.FastestRate = 10_000.0
    most_sessions: options.MostSessions = 64
    most_sessions_per_key: options.MostSessionsPerKey = 16
    on_error: Annotated[
        OnError,
        Option(
            'What an exception in ``step`` does: ``"end"`` the session, or ``"pause"``, which answers with zero force'
            " until `resume`."
        ),
    ] = "end"
    announce: options.Announce = "declared"

    def make(self) -> "tuple[SlaveNode, socket.socket]":
        """Return the node and a socket that listens.

        Raises
        ------
        SettingsError, FileError
            If a parameter cannot be used.
        UnavailableError
            If the address is taken or of another host.
        """
        check_options(self)
        self._closing: list[Callable[[], list[str]]] = []
        make_scene, most = self._scenes()
        for each in self.codecs:
            if isinstance(each, str):
                registry.parse_codec(each)
            elif each not in registry.all_codecs().values():
                registry.register_codec(checked_class(each, f"{each.__module__}:{each.__qualname__}"))
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
        """Return what makes a scene for each master, and how many masters may be served at once."""
        given = self.scene
        if isinstance(given, str):
            source = find_source(given)
            source.prepare()
            self._closing.append(source.close)
            return source.make, self.most_sessions
        if hasattr(given, "step") and not isinstance(given, type):
            touched = as_touchable(given)
            return lambda: touched, 1
        if not callable(given):
            raise SettingsError(f"scene is {given!r}; it must be text, an object with step(sample), or a function")
        make: Callable[[], Any] = given
        as_touchable(make())  # refuse it now rather than when a master joins
        return lambda: as_touchable(make()), self.most_sessions

    def close_scenes(self) -> None:
        """Close the objects of users that were made here, and log what goes wrong."""
        for close in self._closing:
            for fault in close():
                LOG.warning(fault)


def slave_node(make_scene: Callable[[], Touchable], settings: SlaveSettings, trust: SlaveTrust) -> SlaveNode:
    """Return a node that serves a scene to those it trusts, and to masters with a scene of their own that one."""
    entropy = SystemEntropy()
    return SlaveNode(
        lambda entry: make_scene() if (listed := trust.scene_of(entry)) is None else listed.make(),
        settings,
        entropy,
        doors=trust.doors(entropy),
        write_address=place,
        host_of=host_of,
        clock=now_us,
    )


def address_of(sock: "socket.socket") -> str:
    """Return where a socket listens, HOST:PORT."""
    return str(bound_address(sock))


def place(address: SocketAddress) -> str:
    """Return a socket's address as text."""
    return str(HostPort(address[0], address[1]))
