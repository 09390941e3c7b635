"""What a master and a slave inside another program are made of: their parameters, checked, and their nodes."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from hapticnet.api.inputs import as_codec
from hapticnet.checks import check_parameter
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.codec.plugins import checked_class
from hapticnet.device.base import Device
from hapticnet.device.user import HasExchange, UserDevice
from hapticnet.errors import SampleError, SettingsError
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.master import MasterNode
from hapticnet.node.master_settings import DeviceTakes, MasterSettings, OnError
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.user import HasSample, UserOperator
from hapticnet.protocol.handshake import Door, OpenDoor, SealedDoor
from hapticnet.protocol.key_files import load_key, load_roster
from hapticnet.protocol.keys import MasterEntry, MasterKey, parse_key
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.udp import (
    HostPort,
    SocketAddress,
    bound_address,
    host_of,
    is_loopback,
    listen,
    open_toward,
    parse_host_port,
)
from hapticnet.samples import PositionSample, Vector, checked_vector
from hapticnet.scene.base import Touchable
from hapticnet.scene.sources import as_touchable, find_source
from hapticnet.scene.user import HasStep

if TYPE_CHECKING:
    import socket

    from hapticnet.operator.base import Operator

PositionLike: TypeAlias = float | Sequence[float]
"""A position [m]: a number for one axis, or a sequence with a number for each."""

SceneLike: TypeAlias = str | HasStep | Callable[[], HasStep]
"""The name of a scene, an object with a method ``step``, or a function that makes one for each master."""


class Hand:
    """The position that a program has set last. Satisfies `operator.base.Operator`."""

    duration_us = None

    def __init__(self, position: PositionLike) -> None:
        self.position_m = as_position(position)
        self.axes = len(self.position_m)

    def move(self, position: PositionLike) -> None:
        """Set the position; raise SampleError if it is not finite or has another number of axes."""
        self.position_m = as_position(position, self.axes)

    def sample(self, t_us: int) -> PositionSample:
        """Return the position."""
        return PositionSample(t_us, self.position_m)


@dataclass
class MasterSetup:
    """Parameters of a master.

    Parameters
    ----------
    address
        Where the slave listens, HOST:PORT.
    codec, weber_fraction, floor_n, multiplier
        The feedback codec and the JND; see `make_codec`.
    rate_hz
        Positions per second.
    start
        Position [m] at the start: a number, or a sequence with a number for each of one to three axes.
    operator
        Any object with ``sample(t_us)`` that gives the positions instead of the program, and is told the force if it
        has ``feel(t_us, force_n)``.
    device
        A fingertip device: any object with ``exchange(displacement_m, now_us)``. None: the program takes the force.
    device_takes
        The axis of the force that the device renders, or ``"norm"``.
    key, peer_key
        This host's key file and the slave's public key (base64), for a sealed session.
    insecure
        Whether an open session with another host is allowed.
    name
        Name in the slave's report.
    max_age_s
        Forces that answer a position older than this are not applied [s].
    on_error
        What an exception of the operator does: ``"end"`` the session, or ``"pause"`` it until `resume`. The force goes
        to zero in both cases.
    connect_timeout_s
        How long to wait for the slave [s]; None: for ever.
    """

    address: str = "127.0.0.1:47800"
    _: KW_ONLY
    codec: str | Codec = "deadband"
    weber_fraction: float | None = None
    floor_n: float | None = None
    multiplier: float | None = None
    rate_hz: float = 1000.0
    start: PositionLike = 0.0
    operator: HasSample | None = None
    device: HasExchange | None = None
    device_takes: DeviceTakes = "x"
    key: str | Path | None = None
    peer_key: str | None = None
    insecure: bool = False
    name: str = "master"
    max_age_s: float = 1.0
    on_error: OnError = "end"
    connect_timeout_s: float | None = 10.0

    def make(self) -> "tuple[MasterNode, Hand | None, socket.socket, SocketAddress]":
        """Return the node, the hand that the program moves (None with an operator), a socket and the slave's address.

        Raises
        ------
        SettingsError, SampleError, FileError
            If a parameter cannot be used.
        UnavailableError
            If there is no such host.
        """
        check_choice("on_error", self.on_error, ("end", "pause"))
        check_choice("device_takes", self.device_takes, ("x", "y", "z", "norm"))
        check_parameter("max_age_s", self.max_age_s, 0.01, 60.0, "s")
        codec = served(
            as_codec(
                self.codec, weber_fraction=self.weber_fraction, floor_n=self.floor_n, multiplier=self.multiplier,
                parameters={},
            )
        )  # fmt: skip
        operator: Operator
        hand = None
        if self.operator is None:
            operator = hand = Hand(self.start)
        else:
            operator = UserOperator(self.operator)
        sock, address = open_toward(parse_host_port(self.address))
        try:
            settings = MasterSettings(
                codec=codec.name,
                parameters=registry.codec_parameters(codec),
                law=codec.law,
                rate_hz=self.rate_hz,
                name=self.name,
                key=self._keys(is_loopback(address)),
                on_error=self.on_error,
                device_takes=self.device_takes,
                session=SessionSettings(max_age_us=round(self.max_age_s * 1e6)),
            )
            node = MasterNode(operator, as_device(self.device), settings, SystemEntropy())
        except BaseException:
            sock.close()
            raise
        return node, hand, sock, address

    def _keys(self, loopback: bool) -> MasterKey | None:
        if (self.key is None) != (self.peer_key is None):
            raise SettingsError("a sealed session needs both: key, a key file, and peer_key, the slave's public key")
        if self.key is None or self.peer_key is None:
            if not (loopback or self.insecure):
                raise SettingsError(
                    f"{self.address} is another host, so the session needs key and peer_key; insecure=True allows a"
                    " session that is not encrypted"
                )
            return None
        return MasterKey(load_key(Path(self.key)), parse_key(self.peer_key, "peer_key"))


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


def as_position(position: PositionLike, axes: int | None = None) -> Vector:
    """Return a position as a vector; raise SampleError if it cannot be one, or has not `axes` axes."""
    values: Any = position if hasattr(position, "__len__") else (position,)  # arrays are no Sequence
    try:
        vector = checked_vector(values, "position")
    except (TypeError, ValueError) as error:
        raise SampleError(f"position is {position!r}; it must be a number [m], or one for each axis") from error
    if axes is not None and len(vector) != axes:
        raise SampleError(f"position has {len(vector)} axes; this master began with {axes}")
    return vector


def as_device(device: Any) -> Device | None:
    """Return a device of hapticnet as it is, and any other object with its results checked."""
    if device is None:
        return None
    own = type(device).__module__.startswith("hapticnet.")
    return device if own else UserDevice(device)


def served(codec: Codec) -> Codec:
    """Register a codec object's class, so that it can be asked for by name."""
    kind = type(codec)
    if kind not in registry.all_codecs().values():
        registry.register_codec(checked_class(kind, f"{kind.__module__}:{kind.__qualname__}"))
    return codec


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Raise SettingsError unless `value` is one of `choices`."""
    if value not in choices:
        raise SettingsError(f"{name} is {value!r}; choose from {', '.join(choices)}")


def address_of(sock: "socket.socket") -> str:
    """Return where a socket listens, HOST:PORT."""
    return str(bound_address(sock))


def _place(address: SocketAddress) -> str:
    return str(HostPort(address[0], address[1]))
