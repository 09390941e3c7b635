"""What a slave inside another program is made of: its parameters, checked, and its node."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from hapticnet.api.inputs import check_choice
from hapticnet.checks import check_parameter
from hapticnet.codec import registry
from hapticnet.codec.plugins import checked_class
from hapticnet.errors import SettingsError
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.master_settings import OnError
from hapticnet.node.slave import SlaveNode
from hapticnet.node.station_settings import Announces
from hapticnet.protocol.handshake import Door, OpenDoor, SealedDoor
from hapticnet.protocol.key_files import load_key, load_roster
from hapticnet.protocol.keys import MasterEntry
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.udp import HostPort, SocketAddress, bound_address, host_of, is_loopback, listen, parse_host_port
from hapticnet.scene.base import Touchable
from hapticnet.scene.sources import as_touchable, find_source
from hapticnet.scene.user import HasStep

if TYPE_CHECKING:
    import socket

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
        This host's key file and the list of masters that are served, for sealed sessions.
    insecure
        Whether open sessions with other hosts are served.
    codecs
        Codecs of yours that masters may ask for: classes, ``"FILE.py:Class"`` or ``"package.module:Class"``.
    keep_s
        How long the scene of a silent master is kept [s].
    fastest_rate_hz
        Highest rate granted [Hz].
    most_sessions
        Sessions served at once.
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
        make_scene, most = self._scenes()
        for each in self.codecs:
            if isinstance(each, str):
                registry.parse_codec(each)
            elif each not in registry.all_codecs().values():
                registry.register_codec(checked_class(each, f"{each.__module__}:{each.__qualname__}"))
        sock = listen(parse_host_port(self.listen, lowest_port=0))
        entropy = SystemEntropy()
        try:
            doors = self._doors(entropy, is_loopback(sock.getsockname()))
            settings = SlaveSettings(
                fastest_rate_hz=self.fastest_rate_hz,
                on_error=self.on_error,
                announces=self.announce,
                session=SessionSettings(most_sessions=most, most_per_identity=most, keep_us=round(self.keep_s * 1e6)),
            )
            node = SlaveNode(
                lambda entry: self._listed(entry) or make_scene(),
                settings,
                entropy,
                doors=doors,
                write_address=_place,
                host_of=host_of,
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
            return source.make, self.most_sessions
        if hasattr(given, "step") and not isinstance(given, type):
            touched = as_touchable(given)
            return lambda: touched, 1
        if not callable(given):
            raise SettingsError(f"scene is {given!r}; it must be text, an object with step(sample), or a function")
        make: Callable[[], Any] = given
        as_touchable(make())  # refuse it now rather than when a master joins
        return lambda: as_touchable(make()), self.most_sessions

    def _listed(self, entry: MasterEntry | None) -> Touchable | None:
        """Return the scene that the list names for a master, if any."""
        if entry is None or entry.scene is None or self.masters is None:
            return None
        return find_source(entry.scene, Path(self.masters).parent).make()

    def _doors(self, entropy: SystemEntropy, loopback: bool) -> dict[int, Door]:
        if (self.key is None) != (self.masters is None):
            raise SettingsError("sealed sessions need both: key, a key file, and masters, the list of those served")
        doors: dict[int, Door] = {}
        if self.key is not None and self.masters is not None:
            roster = load_roster(Path(self.masters))
            doors[SEALED] = SealedDoor(load_key(Path(self.key)).private, roster, entropy)
        elif not (loopback or self.insecure):
            raise SettingsError(
                f"{self.listen} can be reached from other hosts, so sessions need key and masters; insecure=True serves"
                " anyone"
            )
        if not doors or self.insecure:
            doors[OPEN] = OpenDoor()
        return doors


def address_of(sock: "socket.socket") -> str:
    """Return where a socket listens, HOST:PORT."""
    return str(bound_address(sock))


def _place(address: SocketAddress) -> str:
    return str(HostPort(address[0], address[1]))
