"""The parts of a slave from its options: for a single process, and for each of several workers."""

import os
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from hapticnet.cli.trust import Guests, SlaveTrust
from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.neighbours import Neighbours
from hapticnet.node.slave import SlaveNode
from hapticnet.scene.sources import SceneSource

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.runtime.session_recordings import SlaveRecording
    from hapticnet.scene.base import Touchable

COMPILING: Final = "compiling; the first time, this takes a quarter of a minute"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveOptions:
    """The options of ``hapticnet slave`` that its node, its recordings and its stream depend on."""

    scene: str
    key: Path | None
    masters: Path | None
    insecure: bool
    keep: float
    fastest_rate: float
    most_sessions: int
    seats: int
    announce: Literal["declared", "measured", "nothing"]
    codec: tuple[str, ...]
    compiled: bool
    channel_out: str
    seed: int
    record: Path | None
    record_format: str
    record_limit: int
    stream: str | None
    realtime: bool
    quiet: bool

    def to_json(self) -> dict[str, Any]:
        """Return the options as JSON can hold them."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "SlaveOptions":
        """Return the options that `to_json` was called for."""
        paths = {name: Path(values[name]) for name in ("key", "masters", "record") if values[name] is not None}
        return cls(**{**values, **paths, "codec": tuple(values["codec"])})


@dataclass(frozen=True, slots=True)
class SlaveRun:
    """The other options: where and how long the slave serves, and what it shows and reports."""

    listen: str
    duration: float | None
    metrics: str | None
    json: bool
    report: Path | None
    workers: int


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """What a node needs as one of several workers; `secret` makes the cookies of all."""

    worker: int
    workers: int
    neighbours: Neighbours
    secret: bytes


@dataclass(frozen=True, slots=True)
class Parts:
    """A node and what belongs to it."""

    node: SlaveNode
    source: SceneSource
    guests: Guests | None
    recording: "SlaveRecording | None"

    def close(self) -> list[str]:
        """Close the scenes; return what went wrong."""
        return [*self.source.close(), *(() if self.guests is None else self.guests.close())]

    def read_masters(self, say: Callable[[str], None], warn: Callable[[str], None]) -> None:
        """Read the list of masters again, report the outcome, and serve those that it names."""
        from hapticnet.runtime.clock import now_us

        if read_masters(self.guests, say, warn) and self.guests is not None:
            self.node.serve_only(self.guests.roster, now_us())


def find_scene(options: SlaveOptions) -> SceneSource:
    """Check options and return the source of scenes; raise a HapticnetError that says which option is wrong."""
    from hapticnet.checks import check_integer, check_parameter
    from hapticnet.codec.registry import parse_codec
    from hapticnet.compiled import fast_extra_installed
    from hapticnet.scene.sources import find_source

    for text in options.codec:
        if parse_codec(text)[1]:
            raise SettingsError(f"--codec {text}: omit the parameters; each master sends its own")
    check_parameter("--keep", options.keep, 1.0, 86_400.0, "s")
    most = MOST_COMPILED if options.compiled else MOST_SESSIONS
    check_integer("--most-sessions" + " with --compiled" * options.compiled, options.most_sessions, 1, most)
    if options.compiled:
        for option, given in (("--record", options.record), ("--stream", options.stream)):
            if given is not None:
                raise SettingsError(f"{option} needs each sample, which --compiled does not keep; omit one of them")
        if not fast_extra_installed():
            raise UnavailableError("--compiled needs numba: pip install 'hapticnet[fast]'")
    return find_source(options.scene)


def slave_settings(options: SlaveOptions, workers: int = 1, worker: int = 0) -> SlaveSettings:
    """Return the settings of a node."""
    from hapticnet.protocol.settings import SessionSettings

    return SlaveSettings(
        fastest_rate_hz=options.fastest_rate,
        announces=options.announce,
        record=options.record is not None,
        record_datagrams=options.record is not None,
        session=SessionSettings(
            most_sessions=options.most_sessions,
            most_per_identity=options.seats,
            keep_us=round(options.keep * 1e6),
        ),
        workers=workers,
        worker=worker,
    )


def set_up(
    options: SlaveOptions,
    source: SceneSource,
    trust: SlaveTrust,
    console: "Console",
    context: WorkerContext | None = None,
) -> Parts:
    """Return the parts of a slave; raise a HapticnetError that says which option is wrong."""
    from functools import partial

    from hapticnet.cli.slave_messages import place
    from hapticnet.experiment.provenance import provenance
    from hapticnet.node.compiled_slave import CompiledSlaveNode
    from hapticnet.protocol.handshake import Door, OpenDoor, SealedDoor
    from hapticnet.protocol.keys import MasterEntry
    from hapticnet.protocol.wire import OPEN, SEALED
    from hapticnet.runtime.entropy import SystemEntropy
    from hapticnet.runtime.session_recordings import SlaveRecording
    from hapticnet.runtime.udp import host_of
    from hapticnet.runtime.udp_batch import SocketAddresses

    if options.compiled:
        try:
            import numba  # noqa: F401 - the bank uses it
        except ImportError as error:  # it is there, but does not fit to numpy
            raise UnavailableError(f"--compiled needs numba, which cannot be imported: {error}") from error
    guests, entropy = trust.guests, SystemEntropy()
    doors: dict[int, Door] = {OPEN: OpenDoor()} if trust.serves_open else {}
    if guests is not None:
        doors[SEALED] = SealedDoor(guests.own.private, guests.roster, entropy)

    def make_scene(entry: MasterEntry | None) -> "Touchable":
        return (source if guests is None else guests.scene_of(entry, source)).make()

    make_node: Callable[..., SlaveNode] = SlaveNode
    if options.compiled:
        make_node = partial(CompiledSlaveNode, addresses=SocketAddresses())
    workers, worker = (1, 0) if context is None else (context.workers, context.worker)
    node = make_node(
        make_scene,
        slave_settings(options, workers, worker),
        entropy,
        doors=doors,
        write_address=place,
        host_of=host_of,
        neighbours=None if context is None else context.neighbours,
        secret=None if context is None else context.secret,
    )
    if options.record is None:
        return Parts(node, source, guests, None)
    check_recordings(options)
    about = {
        "seed": options.seed,
        "scene": options.scene,
        "channel_out": options.channel_out,
        "provenance": provenance(),
    }
    suffix, limit_bytes = f".{options.record_format}", options.record_limit // workers
    recording = SlaveRecording(node, options.record, console.warn, suffix=suffix, limit_bytes=limit_bytes, about=about)
    return Parts(node, source, guests, recording)


def check_recordings(options: SlaveOptions) -> None:
    """Check that sessions can be recorded as asked; raise a HapticnetError if not."""
    from hapticnet.files import check_folder
    from hapticnet.recordings.session.archive import check_format

    if options.record is not None:
        check_format(Path(f"session.{options.record_format}"))
        check_folder(options.record)


def read_masters(guests: Guests | None, say: Callable[[str], None], warn: Callable[[str], None]) -> bool:
    """Read the list of masters again and report the outcome; return whether the new list is used."""
    if guests is None:
        warn("this slave has no list of masters to read again")
        return False
    try:
        guests.read()
    except (FileError, SettingsError) as error:
        warn(f"the list of masters is unchanged: {error}")
        return False
    count = len(guests.roster)
    say(f"read {guests.file} again: {count} {'master' if count == 1 else 'masters'}")
    return True


def terminals() -> list[int]:
    """Return which of the standard streams are terminals now."""
    return [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]


def terminal_is_gone(before: list[int]) -> bool:
    """Return whether a SIGHUP means that the terminal was closed; then let this process end."""
    if not before or any(os.isatty(descriptor) for descriptor in before):
        return False
    signal.raise_signal(signal.SIGTERM)
    return True


MOST_SESSIONS = 1_000_000
MOST_COMPILED = 65_536
"""Most sessions of --compiled, which sets 27 kB of address space aside for each at once."""
