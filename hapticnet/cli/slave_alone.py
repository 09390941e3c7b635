"""``hapticnet slave`` in this process: one node serves all sessions."""

from typing import TYPE_CHECKING, Any

from hapticnet.cli.console import Console, channel_account, check_outputs, deliver
from hapticnet.cli.slave_messages import SlaveMessages
from hapticnet.cli.slave_setup import COMPILING, SlaveOptions, SlaveRun, set_up, terminal_is_gone, terminals
from hapticnet.cli.trust import slave_trust
from hapticnet.cli.watching import watch_slave
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
from hapticnet.runtime.slave_run import run_slave
from hapticnet.runtime.udp import bound_address, is_loopback, parse_host_port
from hapticnet.runtime.udp import listen as listen_on
from hapticnet.scene.sources import SceneSource

if TYPE_CHECKING:
    from hapticnet.node.slave_events import SlaveEvent
    from hapticnet.runtime.watching import Watcher


def serve(options: SlaveOptions, source: SceneSource, console: Console, how: SlaveRun) -> None:
    """Serve until the end, and deliver the report."""
    import numpy as np

    from hapticnet.channel.emulator import Emulator
    from hapticnet.channel.spec import parse_channel

    source.prepare()
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    out = parse_channel(options.channel_out)
    sock = listen_on(parse_host_port(how.listen, lowest_port=0))
    address = bound_address(sock)
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(address, loopback, options.key, options.masters, options.insecure)
    if options.compiled:
        console.say(COMPILING)
    parts = set_up(options, source, trust, console)
    node, recording = parts.node, parts.recording
    channel = None if out.is_perfect else Emulator[Any](out, np.random.default_rng([options.seed, 1]))
    check_outputs(how.report, inputs=[source.file, *trust.files])
    watchers: list[Watcher[SlaveEvent]] = [SlaveMessages(console, node, parts.guests)]
    if recording is not None:
        watchers.append(recording)
    before = terminals()

    def on_hangup() -> None:
        if not terminal_is_gone(before):
            parts.read_masters(console.say, console.warn)

    for line in trust.lines():
        console.say(line)
    for line in trust.warnings(loopback):
        console.warn(line)
    scheduling = prefer_realtime() if options.realtime else OTHER
    overload = Overload(scheduling, console.warn)
    watchers += watch_slave(node, console, overload, stream=options.stream, metrics=how.metrics)
    try:
        run(
            run_slave(
                node,
                sock,
                channel=channel,
                duration_s=how.duration,
                watchers=watchers,
                overload=overload,
                tell=console.warn,
                on_listening=lambda: console.say(f"listening on {address}, scene {source.name}, {policy(scheduling)}"),
                on_hangup=on_hangup,
            )
        )
    finally:
        for fault in parts.close():
            console.warn(fault)
    console.finish()
    account: dict[str, Any] = {"scheduling": scheduling, **node.report(), "overload": overload.report()}
    if recording is not None:
        account["recording"] = recording.recorder.report()
    if channel is not None:
        account["channel_out"] = channel_account(out, channel)
    try:
        deliver(account, as_json=how.json, file=how.report, real_time=True)
    finally:  # the reader of stdout may have gone
        if recording is not None:
            recording.recorder.check()
