"""A slave from its options: its node, its watchers, its messages, and its report."""

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.api.slave import slave_node
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.cli.console import Console, check_outputs, deliver
from hapticnet.cli.given import SlaveOptions
from hapticnet.cli.watching import watch_for_programs
from hapticnet.codec.registry import parse_codec, register_installed_codecs
from hapticnet.control.couplings import register_installed_couplings
from hapticnet.errors import FileError, RunError, SettingsError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import check_folder
from hapticnet.node.events import (
    MasterJoined,
    MasterLeft,
    MasterRefused,
    ScenePaused,
    SceneResumed,
    SceneSaid,
    SlaveEvent,
)
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.node.step_times import StepsTooSlow
from hapticnet.options import RECORD_LIMIT
from hapticnet.protocol.keys import format_key
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings
from hapticnet.recordings.session.archive import check_format
from hapticnet.recordings.session.mcap_writer import DISTURBANCES
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.recorder import SlaveRecording
from hapticnet.runtime.runners import run_slave, slave_report
from hapticnet.runtime.scene_port import find_live_source
from hapticnet.runtime.signals import Rescue
from hapticnet.runtime.system import OTHER, now_us, policy, prefer_realtime, run
from hapticnet.runtime.trust import Guests, slave_trust
from hapticnet.runtime.udp import bound_address, is_loopback, parse_host_port, text_of
from hapticnet.runtime.udp import listen as listen_on
from hapticnet.runtime.watching import Watcher

if TYPE_CHECKING:
    from hapticnet.node.slave_context import SlaveContext

MOST_UNREAD: Final = 10  # most reasons for dropped HELLOs that are printed, each once: unknown peers choose them
MOST_FAILURES: Final = 10  # most failures of scenes and codecs that the report and the last line name


def serve(options: SlaveOptions) -> None:
    """Serve until the end, and deliver the report."""
    console = Console("slave", quiet=options.quiet, real_time=True)
    for fault in [*register_installed_codecs(), *register_installed_couplings()]:
        console.warn(f"not served: {fault}")
    for text in options.add_codec or ():
        parse_codec(text)  # whose import registers it
    if options.record_dir is not None:
        check_format(Path(f"session.{options.record_format}"))
        check_folder(options.record_dir)
    source = find_live_source(options.scene)
    source.prepare()
    chosen = {"--record-format": options.record_format != "csv", "--record-limit": options.record_limit != RECORD_LIMIT}
    unrecorded = options.record_dir is None
    console.warn_of_unused({name: (unrecorded and given, "it needs --record-dir") for name, given in chosen.items()})
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    for risk in source.risks:
        console.warn(risk)
    out = parse_channel(options.channel_out)
    sock = listen_on(parse_host_port(options.listen, lowest_port=0))
    address = bound_address(sock)
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(address, loopback, options.key, options.masters, options.insecure)
    settings = SlaveSettings(
        fastest_rate_hz=options.fastest_rate,
        announces=options.announce,
        record=options.record_dir is not None,
        record_datagrams=options.record_dir is not None,
        session=SessionSettings(
            most_sessions=options.most_sessions,
            most_per_identity=options.most_sessions_per_key,
            keep_us=round(options.keep * 1e6),
        ),
    )
    node = slave_node(source.make, settings, trust)
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([options.seed, 1]))
    recording: SlaveRecording | None = None
    if options.record_dir is not None:
        recording = SlaveRecording(
            node,
            options.record_dir,
            console.warn,
            suffix=f".{options.record_format}",
            limit_bytes=options.record_limit,
            channel_out=None if channel is None else out.describe(),
            about={"seed": options.seed, "provenance": provenance()},
        )
    check_outputs(options.report, inputs=[source.file, *trust.files])
    watchers: list[Watcher[SlaveEvent]] = [SlaveMessages(console, node, trust.guests)]
    if recording is not None:
        watchers.append(recording)
    for line in trust.lines():
        console.say(line)
    for line in trust.warnings(loopback):
        console.warn(line)
    scheduling = prefer_realtime() if options.real_time else OTHER
    overload = Overload(scheduling, console.warn)
    watchers += watch_for_programs(
        node, console, overload, metrics=options.metrics, status=lambda: status(node),
        stopping=lambda: node.draining,
    )  # fmt: skip
    terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]

    def on_hangup() -> None:
        if terminals and not any(map(os.isatty, terminals)):  # the terminal was closed: let this process end
            signal.raise_signal(signal.SIGTERM)
        else:
            read_masters(node, trust.guests, console)

    def conclude() -> None:
        """Deliver the report."""
        console.finish()
        recorder = None if recording is None else recording.recorder
        account = slave_report(
            node, overload, faults=[*rescue.faults, *console.faults], recorder=recorder, channel_out=channel
        )
        deliver(account, as_json=options.json, file=options.report, real_time=True)

    rescue = Rescue(conclude)
    try:
        run(
            run_slave(
                node,
                sock,
                channel=channel,
                duration_s=options.duration,
                drain_s=options.drain,
                watchers=watchers,
                overload=overload,
                tell=console.fault,
                on_listening=lambda: console.say(
                    f"listening on {address}, scene {source.name}{' with vibration' * source.vibrates},"
                    f" {policy(scheduling)}"
                ),
                on_hangup=on_hangup,
                rescue=rescue,
            )
        )
    finally:
        for fault in [*source.close(), *(() if trust.guests is None else trust.guests.close())]:
            console.warn(fault)
    rescue.done()
    try:
        conclude()
    finally:  # the reader of stdout may have gone
        if recording is not None:
            recording.recorder.check()
    faults = [*map(str, node.times.reported), *rescue.faults, *console.faults]
    if faults:
        raise RunError("; ".join(faults))


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


class SlaveMessages(Watcher[SlaveEvent]):
    """Messages about joining and leaving masters, and the status line; without `guests`, no sealed sessions."""

    name = "messages"

    def __init__(self, console: "Console", node: SlaveNode, guests: "Guests | None") -> None:
        self._console = console
        self._node = node
        self._guests = guests
        self._said_unkeyed = False
        self._said_unread: set[str] = set()
        self._failures: set[str] = set()
        self._said_draining = False

    def note(self, event: SlaveEvent, now_us: int) -> None:  # noqa: ARG002 - messages have their own time
        """Print the events."""
        failure = None
        if isinstance(event, MasterLeft):
            failure = event.context.failure
        elif isinstance(event, MasterRefused) and event.code is Code.FAILED:
            failure = event.reason
        if failure is not None and failure not in self._failures and len(self._failures) < MOST_FAILURES:
            self._failures.add(failure)
            self._console.faults.append(failure)
        disturbs = failure is not None or isinstance(event, MasterRefused) or type(event).__name__ in DISTURBANCES
        tell = self._console.warn if disturbs else self._console.say
        listed = self._listed(event) if isinstance(event, MasterRefused) else None
        tell(in_words(event, listed))

    def _listed(self, event: MasterRefused) -> str | None:
        """Return the listed name of a refused master; None if it is not listed."""
        entry = None if self._guests is None or event.public is None else self._guests.roster.find(event.public)
        return None if entry is None else entry.name

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Update the status line."""
        node = self._node
        if self._guests is not None and node.hello_filter.unkeyed and not self._said_unkeyed:
            self._said_unkeyed = True
            public = format_key(self._guests.own.public)
            self._console.warn(f"a master asks for a session with another slave's key; this slave's is {public}")
        if node.draining and not self._said_draining:
            self._said_draining = True
            self._console.say(f"stopping: takes no new masters; {node.session_count} may finish (--drain)")
        if node.unread_hello is not None:
            reason, address = node.unread_hello
            if reason not in self._said_unread and len(self._said_unread) < MOST_UNREAD:
                self._said_unread.add(reason)
                self._console.warn(f"a HELLO from {text_of(address)} was dropped: {reason}")
        self._console.status(status(node))


def status(node: SlaveNode) -> str:
    """Return the status line of a slave."""
    steps, packets = node.totals()
    masters = f"{node.session_count} master{'s' * (node.session_count != 1)}"
    return f"{masters}, {steps} steps, {packets} packets sent"


def in_words(event: SlaveEvent, listed: str | None = None) -> str:
    """Return an event in words for a person; `listed` is the listed name of a refused master."""
    if isinstance(event, MasterRefused):
        whose = "" if event.public is None else f" with the public key {format_key(event.public)}"
        own = repr(event.name) if listed is None else f"{listed!r} ({event.name!r})"
        return f"{own} from {text_of(event.address)}{whose} was refused: {event.reason}"
    if isinstance(event, StepsTooSlow):
        return str(event)
    session = event.context.session
    if isinstance(event, MasterJoined):
        request = session.request
        where = text_of(event.context.address)
        beside = ", with vibration" if event.context.vibrates else ""
        return f"{who(event.context)} joined from {where}: {request.codec}, asks for {request.rate_hz:g} Hz{beside}"
    if isinstance(event, ScenePaused):
        return f"{who(event.context)} feels nothing from now on: {event.reason}"
    if isinstance(event, SceneSaid):
        return f"{who(event.context)}: {event.line}"
    if isinstance(event, SceneResumed):
        return f"{who(event.context)} feels the scene again"
    if isinstance(event, MasterLeft):
        return f"{who(event.context)} left: {session.end_reason} ({event.context.steps} steps)"
    raise TypeError(event)


def who(context: "SlaveContext") -> str:
    """Return how to name a master: by its name in the list and its own name."""
    own = repr(context.session.request.name)
    return own if context.listed is None else f"{context.listed!r} ({own})"
