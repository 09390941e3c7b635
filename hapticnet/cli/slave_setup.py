"""A slave from its options: its node, what looks on, and its report."""

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.api.slave_setup import slave_node
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.cli.console import Console, check_outputs, deliver
from hapticnet.cli.slave_messages import SlaveMessages
from hapticnet.cli.watching import watch_slave
from hapticnet.codec.registry import parse_codec, register_installed_codecs
from hapticnet.errors import FileError, RunError, SettingsError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import check_folder
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.options import RECORD_LIMIT
from hapticnet.protocol.settings import SessionSettings
from hapticnet.recordings.session.archive import check_format
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.runners import run_slave, slave_report
from hapticnet.runtime.session_recordings import SlaveRecording
from hapticnet.runtime.signals import Rescue
from hapticnet.runtime.system import OTHER, now_us, policy, prefer_realtime, run
from hapticnet.runtime.trust import Guests, SlaveTrust, slave_trust
from hapticnet.runtime.udp import bound_address, is_loopback, parse_host_port
from hapticnet.runtime.udp import listen as listen_on
from hapticnet.scene.sources import SceneSource, find_source

if TYPE_CHECKING:
    from hapticnet.channel.settings import ChannelSettings
    from hapticnet.cli.slave import SlaveOptions
    from hapticnet.node.events import SlaveEvent
    from hapticnet.runtime.watching import Watcher

NOT_RECORDED: Final = "it needs --record-dir"


def serve(options: "SlaveOptions") -> None:
    """Serve until the end, and deliver the report."""
    console = Console("slave", quiet=options.quiet, real_time=True)
    for fault in register_installed_codecs():
        console.warn(f"not served: {fault}")
    check(options)
    source = find_source(options.scene)
    source.prepare()
    console.warn_of_unused(
        {
            "--record-format": (options.record_dir is None and options.record_format != "csv", NOT_RECORDED),
            "--record-limit": (options.record_dir is None and options.record_limit != RECORD_LIMIT, NOT_RECORDED),
        }
    )
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    out = parse_channel(options.channel_out)
    sock = listen_on(parse_host_port(options.listen, lowest_port=0))
    address = bound_address(sock)
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(address, loopback, options.key, options.masters, options.insecure)
    node = make_node(options, source, trust)
    recording = record(options, node, out, console)
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([options.seed, 1]))
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
    watchers += watch_slave(node, console, overload, metrics=options.metrics)
    before = terminals()

    def on_hangup() -> None:
        if not terminal_is_gone(before):
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
                on_listening=lambda: console.say(f"listening on {address}, scene {source.name}, {policy(scheduling)}"),
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


def check(options: "SlaveOptions") -> None:
    """Check options; raise a HapticnetError that says which one is wrong."""
    for text in options.add_codec or ():
        parse_codec(text)  # which makes it known
    if options.record_dir is not None:
        check_format(Path(f"session.{options.record_format}"))
        check_folder(options.record_dir)


def make_node(options: "SlaveOptions", source: SceneSource, trust: SlaveTrust) -> SlaveNode:
    """Return the node that serves."""
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
    return slave_node(source.make, settings, trust)


def record(options: "SlaveOptions", node: SlaveNode, out: "ChannelSettings", console: Console) -> SlaveRecording | None:
    """Return what records the sessions, if that is asked for; `out` is the network emulated for the answers."""
    if options.record_dir is None:
        return None
    return SlaveRecording(
        node,
        options.record_dir,
        console.warn,
        suffix=f".{options.record_format}",
        limit_bytes=options.record_limit,
        channel_out=None if out.is_perfect else out.describe(),
        about={"seed": options.seed, "provenance": provenance()},
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
