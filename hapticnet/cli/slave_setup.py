"""A slave from its options: its node, what looks on, and its report."""

import os
import signal
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.checks import check_integer, check_parameter
from hapticnet.cli.console import Console, channel_account, check_outputs, deliver
from hapticnet.cli.slave_messages import SlaveMessages, place
from hapticnet.cli.trust import Guests, SlaveTrust, slave_trust
from hapticnet.cli.watching import watch_slave
from hapticnet.codec.registry import parse_codec, register_installed_codecs
from hapticnet.compiled import fast_extra_installed
from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import check_folder
from hapticnet.node.admission import SlaveSettings
from hapticnet.node.compiled_slave import CompiledSlaveNode
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import Door, OpenDoor, SealedDoor
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.recordings.session.archive import check_format
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.entropy import SystemEntropy
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
from hapticnet.runtime.session_recordings import SlaveRecording
from hapticnet.runtime.slave_run import run_slave
from hapticnet.runtime.udp import bound_address, host_of, is_loopback, parse_host_port
from hapticnet.runtime.udp import listen as listen_on
from hapticnet.runtime.udp_batch import SocketAddresses
from hapticnet.scene.sources import SceneSource, find_source

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.node.slave_events import SlaveEvent
    from hapticnet.protocol.keys import MasterEntry
    from hapticnet.runtime.watching import Watcher
    from hapticnet.scene.base import Touchable

MOST_SESSIONS: Final = 1_000_000
MOST_COMPILED: Final = 65_536
"""Most sessions of --compiled, which sets 27 kB of address space aside for each at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveOptions:
    """The options of ``hapticnet slave``."""

    listen: str
    scene: str
    duration: float | None
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
    metrics: str | None
    realtime: bool
    json: bool
    report: Path | None
    quiet: bool


def serve(options: SlaveOptions) -> None:
    """Serve until the end, and deliver the report."""
    console = Console("slave", quiet=options.quiet, real_time=True)
    for fault in register_installed_codecs():
        console.warn(f"not served: {fault}")
    check(options)
    source = find_source(options.scene)
    source.prepare()
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    out = parse_channel(options.channel_out)
    sock = listen_on(parse_host_port(options.listen, lowest_port=0))
    address = bound_address(sock)
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(address, loopback, options.key, options.masters, options.insecure)
    if options.compiled:
        console.say("compiling; the first time, this takes a quarter of a minute")
    node = make_node(options, source, trust)
    recording = record(options, node, console)
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([options.seed, 1]))
    check_outputs(options.report, inputs=[source.file, *trust.files])
    watchers: list[Watcher[SlaveEvent]] = [SlaveMessages(console, node, trust.guests)]
    if recording is not None:
        watchers.append(recording)
    for line in trust.lines():
        console.say(line)
    for line in trust.warnings(loopback):
        console.warn(line)
    scheduling = prefer_realtime() if options.realtime else OTHER
    overload = Overload(scheduling, console.warn)
    watchers += watch_slave(node, console, overload, stream=options.stream, metrics=options.metrics)
    before = terminals()

    def on_hangup() -> None:
        if not terminal_is_gone(before):
            read_masters(node, trust.guests, console)

    try:
        run(
            run_slave(
                node,
                sock,
                channel=channel,
                duration_s=options.duration,
                watchers=watchers,
                overload=overload,
                tell=console.warn,
                on_listening=lambda: console.say(f"listening on {address}, scene {source.name}, {policy(scheduling)}"),
                on_hangup=on_hangup,
            )
        )
    finally:
        for fault in [*source.close(), *(() if trust.guests is None else trust.guests.close())]:
            console.warn(fault)
    console.finish()
    account: dict[str, Any] = {"scheduling": scheduling, **node.report(), "overload": overload.report()}
    if recording is not None:
        account["recording"] = recording.recorder.report()
    if channel is not None:
        account["channel_out"] = channel_account(out, channel)
    try:
        deliver(account, as_json=options.json, file=options.report, real_time=True)
    finally:  # the reader of stdout may have gone
        if recording is not None:
            recording.recorder.check()


def check(options: SlaveOptions) -> None:
    """Check options; raise a HapticnetError that says which one is wrong."""
    for text in options.codec:
        if parse_codec(text)[1]:
            raise SettingsError(f"--codec {text}: omit the parameters; each master sends its own")
    check_parameter("--keep", options.keep, 1.0, 86_400.0, "s")
    most = MOST_COMPILED if options.compiled else MOST_SESSIONS
    check_integer("--most-sessions" + " with --compiled" * options.compiled, options.most_sessions, 1, most)
    if options.record is not None:
        check_format(Path(f"session.{options.record_format}"))
        check_folder(options.record)
    if not options.compiled:
        return
    for option, given in (("--record", options.record), ("--stream", options.stream)):
        if given is not None:
            raise SettingsError(f"{option} needs each sample, which --compiled does not keep; omit one of them")
    if not fast_extra_installed():
        raise UnavailableError("--compiled needs numba: pip install 'hapticnet[fast]'")
    try:
        import numba  # noqa: F401 - the bank uses it
    except ImportError as error:  # it is there, but does not fit to numpy
        raise UnavailableError(f"--compiled needs numba, which cannot be imported: {error}") from error


def make_node(options: SlaveOptions, source: SceneSource, trust: SlaveTrust) -> SlaveNode:
    """Return the node that serves."""
    guests, entropy = trust.guests, SystemEntropy()
    doors: dict[int, Door] = {OPEN: OpenDoor()} if trust.serves_open else {}
    if guests is not None:
        doors[SEALED] = SealedDoor(guests.own.private, guests.roster, entropy)

    def make_scene(entry: "MasterEntry | None") -> "Touchable":
        return (source if guests is None else guests.scene_of(entry, source)).make()

    settings = SlaveSettings(
        fastest_rate_hz=options.fastest_rate,
        announces=options.announce,
        record=options.record is not None,
        record_datagrams=options.record is not None,
        session=SessionSettings(
            most_sessions=options.most_sessions,
            most_per_identity=options.seats,
            keep_us=round(options.keep * 1e6),
        ),
    )
    make: Callable[..., SlaveNode] = SlaveNode
    if options.compiled:
        make = partial(CompiledSlaveNode, addresses=SocketAddresses())
    return make(make_scene, settings, entropy, doors=doors, write_address=place, host_of=host_of)


def record(options: SlaveOptions, node: SlaveNode, console: Console) -> SlaveRecording | None:
    """Return what records the sessions, if that is asked for."""
    if options.record is None:
        return None
    about = {
        "seed": options.seed,
        "scene": options.scene,
        "channel_out": options.channel_out,
        "provenance": provenance(),
    }
    suffix = f".{options.record_format}"
    return SlaveRecording(
        node, options.record, console.warn, suffix=suffix, limit_bytes=options.record_limit, about=about
    )


def read_masters(node: SlaveNode, guests: Guests | None, console: Console) -> None:
    """Read the list of masters again, report the outcome, and serve those that it names."""
    if guests is None:
        console.warn("this slave has no list of masters to read again")
        return
    try:
        guests.read()
    except (FileError, SettingsError) as error:
        console.warn(f"the list of masters is unchanged: {error}")
        return
    count = len(guests.roster)
    console.say(f"read {guests.file} again: {count} {'master' if count == 1 else 'masters'}")
    node.serve_only(guests.roster, now_us())


def terminals() -> list[int]:
    """Return which of the standard streams are terminals now."""
    return [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]


def terminal_is_gone(before: list[int]) -> bool:
    """Return whether a SIGHUP means that the terminal was closed; then let this process end."""
    if not before or any(os.isatty(descriptor) for descriptor in before):
        return False
    signal.raise_signal(signal.SIGTERM)
    return True
