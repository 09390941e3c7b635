"""What a slave inside another program is made of: its parameters, checked, and its node."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from hapticnet.api.events import LOG
from hapticnet.api.inputs import check_choice
from hapticnet.checks import check_integer, check_parameter
from hapticnet.codec import registry
from hapticnet.codec.plugins import checked_class
from hapticnet.errors import SettingsError
from hapticnet.files import user_path
from hapticnet.node.master_settings import OnError
from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_settings import Announces, SlaveSettings
from hapticnet.protocol.settings import SessionSettings
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.trust import slave_trust
from hapticnet.runtime.udp import HostPort, SocketAddress, bound_address, host_of, is_loopback, listen, parse_host_port
from hapticnet.scene.base import Touchable
from hapticnet.scene.sources import as_touchable, find_source
from hapticnet.scene.user import HasStep

if TYPE_CHECKING:
    import socket

MOST_SESSIONS: Final = 1_000_000

SceneLike: TypeAlias = str | HasStep | Callable[[], HasStep]
"""The name of a scene, an object with a method ``step``, or a function that makes one for each master."""


@dataclass
class SlaveSetup:
    """Parameters of a slave.

    Parameters
    ----------
    scene
        What masters touch: a scene's name (``"paper:SEED"``, a preset, a .toml file, ``"FILE.py:Class"``), an object
        with a method ``step(sample)`` that returns the force [N], or a class or function that makes such an object for
        each master. An object is touched by one master at a time.
    listen
        Where to listen, HOST:PORT; port 0 takes a free one.
    key, masters
        This host's key file and the list of masters that are served, for sealed sessions. Default where other hosts
        can reach `listen`: ~/.config/hapticnet/key.toml, and masters.toml beside the key.
    insecure
        Whether open sessions with other hosts are served.
    codecs
        Codecs of yours that masters may ask for: classes, ``"FILE.py:Class"`` or ``"package.module:Class"``.
    keep_s
        How long the scene of a silent master is kept [s].
    fastest_rate_hz
        Highest rate granted [Hz].
    most_sessions, most_sessions_per_key
        Sessions served at once, and those of one key (without keys, of one host), unless the list says.
    on_error
        What an exception in ``step`` does: ``"end"`` the session, or ``"pause"``, which answers with zero force until
        `resume`.
    announce
        What masters that ask for it are told of the contact ahead: what the scene declares with a method ``ahead()``
        (``"declared"``), what was measured of it (``"measured"``, one axis), or ``"nothing"``.
    """

    scene: SceneLike = "paper:0"
    _: KW_ONLY
    listen: str = "127.0.0.1:47800"
    key: str | Path | None = None
    masters: str | Path | None = None
    insecure: bool = False
    codecs: Sequence[str | type[Any]] = field(default_factory=tuple)
    keep_s: float = 30.0
    fastest_rate_hz: float = 10_000.0
    most_sessions: int = 64
    most_sessions_per_key: int = 16
    on_error: OnError = "end"
    announce: Announces = "declared"

    def make(self) -> "tuple[SlaveNode, socket.socket]":
        """Return the node and a socket that listens.

        Raises
        ------
        SettingsError, FileError
            If a parameter cannot be used.
        UnavailableError
            If the address is taken or of another host.
        """
        check_choice("on_error", self.on_error, ("end", "pause"))
        check_choice("announce", self.announce, ("declared", "measured", "nothing"))
        check_parameter("keep_s", self.keep_s, 1.0, 86_400.0, "s")
        check_integer("most_sessions", self.most_sessions, 1, MOST_SESSIONS)
        check_integer("most_sessions_per_key", self.most_sessions_per_key, 1, MOST_SESSIONS)
        self._closing: list[Callable[[], list[str]]] = []
        make_scene, most = self._scenes()
        for each in self.codecs:
            if isinstance(each, str):
                registry.parse_codec(each)
            elif each not in registry.all_codecs().values():
                registry.register_codec(checked_class(each, f"{each.__module__}:{each.__qualname__}"))
        sock = listen(parse_host_port(self.listen, lowest_port=0))
        entropy = SystemEntropy()
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
            node = SlaveNode(
                lambda entry: make_scene() if (listed := trust.scene_of(entry)) is None else listed.make(),
                settings,
                entropy,
                doors=trust.doors(entropy),
                write_address=_place,
                host_of=host_of,
                clock=now_us,
            )
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


def address_of(sock: "socket.socket") -> str:
    """Return where a socket listens, HOST:PORT."""
    return str(bound_address(sock))


def _place(address: SocketAddress) -> str:
    return str(HostPort(address[0], address[1]))
