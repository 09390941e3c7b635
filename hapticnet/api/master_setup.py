"""Parameters of a master inside another program, checked, and its node."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, cast

from hapticnet import options
from hapticnet.api.inputs import as_codec, serve_class
from hapticnet.api.live import LOG
from hapticnet.checks import axes_of
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.device.base import Device
from hapticnet.device.profile import Profile
from hapticnet.device.user import HasApply, HasExchange, UserActuator, as_user_device
from hapticnet.errors import SampleError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import user_path
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, OnError
from hapticnet.operator.base import HasSample, Operator, UserOperator
from hapticnet.operator.mapping import Mapping
from hapticnet.options import Option, check_options, described
from hapticnet.protocol.settings import SessionSettings
from hapticnet.recordings.session.archive import check_format
from hapticnet.runtime import devices
from hapticnet.runtime.recorder import MasterRecording
from hapticnet.runtime.system import SystemEntropy, now_us
from hapticnet.runtime.trust import master_key
from hapticnet.runtime.udp import SocketAddress, is_loopback, open_toward, parse_host_port
from hapticnet.samples import PositionSample, Vector, checked_vector

if TYPE_CHECKING:
    import socket

    from hapticnet.runtime.serial_port import Wire

PositionLike: TypeAlias = float | Sequence[float]
"""A position [m]: a number for one axis, or a sequence with a number for each."""


class Hand:
    """The position that a program set last. Satisfies `operator.base.Operator`."""

    duration_us = None
    clutched = False  # whether the clutch is open

    def __init__(self, position: PositionLike) -> None:
        self.position_m = as_position(position)
        self.axes = len(self.position_m)

    def move(self, position: PositionLike) -> None:
        """Set the position; raise SampleError if it is not finite or has another number of axes."""
        self.position_m = as_position(position, self.axes)

    def sample(self, t_us: int) -> PositionSample:
        """Return the position."""
        return PositionSample(t_us, self.position_m)


@described
@dataclass
class MasterSetup(options.SharedMasterOptions):
    """Parameters of a master.

    They are checked when the master opens.
    """

    address: options.Connect = "127.0.0.1:47800"
    _: KW_ONLY
    codec: Annotated[
        str | Codec, Option("The feedback codec: a name with or without parameters, or an object of `make_codec`.")
    ] = "deadband"
    weber_fraction: Annotated[float | None, Option("Weber fraction k: JND = k·|force|; None: the paper's.")] = None
    floor_n: Annotated[float | None, Option("Smallest JND [N]; None: the paper's.")] = None
    multiplier: Annotated[float | None, Option("Deadband threshold in JNDs; None: 1.")] = None
    rate_hz: options.Rate = 1000.0
    start: Annotated[
        PositionLike, Option("Position [m] at the start: a number, or one for each of one to three axes.")
    ] = 0.0
    operator: Annotated[
        HasSample | None,
        Option(
            "Any object with ``sample(t_us)`` that gives the positions instead of the program, and gets the force"
            " if it has ``feel(t_us, force_n)``."
        ),
    ] = None
    frame: options.FrameNumbers = None
    offset: options.OffsetNumbers = None
    device: Annotated[
        str | HasExchange | HasApply | None,
        Option(
            'A fingertip device: ``"serial:auto"``, ``"sim"`` or another text that ``hapticnet master --device``'
            " takes, or any object with ``exchange(displacement_m, now_us)`` or ``apply(force_n, now_us)``. None: the"
            " program takes the force."
        ),
    ] = None
    profile: Annotated[
        str | Path | None,
        Option("The device's calibration and finger, a file from ``hapticnet device calibrate``."),
    ] = None
    key: options.KeyPath = None
    max_age_s: options.MaxAge = 1.0
    on_error: Annotated[
        OnError,
        Option(
            'What an exception of the operator does: ``"end"`` the session, or ``"pause"`` it until `resume`. The'
            " force goes to zero in both cases."
        ),
    ] = "end"
    record: Annotated[
        str | Path | None, Option("Record every tick in this file, .mcap or .csv (docs/use/recordings.md).")
    ] = None
    record_limit_bytes: Annotated[int, Option("Stop recording before it takes more disk space than this [B].")] = (
        options.RECORD_LIMIT
    )
    connect_timeout_s: Annotated[float | None, Option("How long to wait for the slave [s]; None: for ever.")] = 10.0

    def make(
        self, device: Device | UserActuator | None
    ) -> "tuple[MasterNode, Hand | None, socket.socket, SocketAddress]":
        """Return the node, the hand that the program moves (None with an operator), a socket and the slave's address.

        Raise a HapticnetError if a parameter cannot be used or there is no such host.
        """
        hand, operator = self._operator()
        settings = self._settings()
        sock, address = open_toward(parse_host_port(self.address))
        try:
            # An open session names no key; on the command line, HAPTICNET_KEY may be for other slaves.
            is_open_to = is_loopback(address) and self.key is None
            key = None if self.key is None else user_path(self.key)
            keys = master_key(self.address, is_open_to, key, self.peer_key, self.insecure, str)
            settings = replace(settings, key=keys)
            node = MasterNode(operator, device, settings, SystemEntropy(), now_us)
        except BaseException:
            sock.close()
            raise
        return node, hand, sock, address

    @contextmanager
    def opened_device(self) -> "Iterator[tuple[Device | UserActuator | None, Wire | None]]":
        """Yield the device and its serial line, if there are any; raise a HapticnetError if it cannot be opened."""
        if self.device is None:
            yield None, None
        elif not isinstance(self.device, str):
            own = type(self.device).__module__.startswith("hapticnet.")
            yield (cast("Device", self.device) if own else as_user_device(self.device)), None
        else:
            with devices.real_time_device(self.device, self._profile(), 0, LOG.warning) as opened:
                yield opened

    def recording(self, node: MasterNode) -> MasterRecording | None:
        """Return the recorder of the node, if any."""
        if self.record is None:
            return None
        about = {
            "operator": "program" if self.operator is None else type(self.operator).__qualname__,
            "device": "none" if self.device is None else self.device if isinstance(self.device, str) else "program",
            "provenance": provenance(),
        }
        limit = self.record_limit_bytes
        return MasterRecording(node, user_path(self.record), LOG.warning, limit_bytes=limit, about=about)

    def _operator(self) -> tuple[Hand | None, Operator]:
        if self.operator is None:
            hand = Hand(self.start)
            return hand, hand
        return None, UserOperator(self.operator)

    def _settings(self) -> MasterSettings:
        """Return the settings of the node, except the key."""
        check_options(self)
        if self.record is not None:
            check_format(user_path(self.record))
        law = {"weber_fraction": self.weber_fraction, "floor_n": self.floor_n, "multiplier": self.multiplier}
        codec = as_codec(self.codec, **law, parameters={})
        serve_class(type(codec))
        return MasterSettings(
            codec=codec.name,
            parameters=registry.codec_parameters(codec),
            law=codec.law,
            record=self.record is not None,
            record_datagrams=self.record is not None,
            rate_hz=self.rate_hz,
            on_error=self.on_error,
            **self.of_node(),
            mapping=Mapping(
                scale=self.scale,
                force_scale=self.force_scale,
                frame_deg=tuple(self.frame or ()),
                offset_m=tuple(self.offset or ()),
            ),
            session=SessionSettings(max_age_us=round(self.max_age_s * 1e6)),
            control=devices.control_settings(self._profile()),
        )

    def _profile(self) -> Profile:
        return devices.load(None if self.profile is None else user_path(self.profile))


def as_position(position: PositionLike, axes: int | None = None) -> Vector:
    """Return a position as a vector; raise SampleError if it is invalid, or does not have `axes` axes."""
    values: Any = position if hasattr(position, "__len__") else (position,)  # arrays are not a Sequence
    try:
        vector = checked_vector(values, "position")
    except (TypeError, ValueError) as error:
        raise SampleError(f"position is {position!r}; it must be a number [m], or one for each axis") from error
    if axes is not None and len(vector) != axes:
        raise SampleError(f"position has {axes_of(len(vector))}; this master began with {axes}")
    return vector
