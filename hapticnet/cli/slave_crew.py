"""``hapticnet slave --workers``: the parent of the processes that serve, with console, metrics and report."""

import asyncio
import json
import signal
from datetime import datetime
from typing import Any, Final

from hapticnet.channel.spec import parse_channel
from hapticnet.checks import check_integer
from hapticnet.cli.console import Console, check_outputs, deliver
from hapticnet.cli.slave_setup import (
    COMPILING,
    SlaveOptions,
    SlaveRun,
    check_recordings,
    read_masters,
    terminal_is_gone,
    terminals,
)
from hapticnet.cli.trust import SlaveTrust, slave_trust
from hapticnet.errors import FileError, SettingsError
from hapticnet.runtime.log_lines import Level, LogLine, log_line
from hapticnet.runtime.outlet import STDERR
from hapticnet.runtime.realtime import run
from hapticnet.runtime.systemd import notify_socket
from hapticnet.runtime.udp import bound_address, is_loopback, parse_host_port
from hapticnet.runtime.waiting import Repeating, stop_on_signals
from hapticnet.runtime.watching import Watcher, Watchers
from hapticnet.runtime.workers.crew import Supervisor
from hapticnet.runtime.workers.group import MOST_WORKERS, open_group
from hapticnet.runtime.workers.merge import merged_report, recording_faults, status
from hapticnet.runtime.workers.serving import WorkersMetrics, WorkersNotifier
from hapticnet.scene.sources import SceneSource

MODULE: Final = "hapticnet.cli.slave_worker"


def serve(options: SlaveOptions, source: SceneSource, console: Console, how: SlaveRun) -> None:
    """Let workers serve until the end, and deliver their common report."""
    check_integer("--workers", how.workers, 1, MOST_WORKERS)
    if not parse_channel(options.channel_out).is_perfect:
        raise SettingsError(
            "--channel-out emulates one network for all sessions, but each worker would have its own: use --workers 1,"
            " or put 'hapticnet channel' before the slave"
        )
    if source.shared:
        raise SettingsError(
            f"{options.scene} is one scene for all masters (shared = True), but each worker would have its own: use"
            " --workers 1"
        )
    for note in source.notes:
        console.say(f"{source.file}: {note}")
    check_recordings(options)
    sockets = open_group(parse_host_port(how.listen, lowest_port=0), how.workers)
    address, loopback = bound_address(sockets[0]), is_loopback(sockets[0].getsockname())
    trust = slave_trust(address, loopback, options.key, options.masters, options.insecure)
    check_outputs(how.report, inputs=[source.file, *trust.files])
    for line in trust.lines():
        console.say(line)
    for line in trust.warnings(loopback):
        console.warn(line)
    if options.compiled:
        console.say(COMPILING)

    async def serve_all() -> Supervisor:
        given = {"options": options.to_json(), "figures": how.metrics is not None}
        supervisor = Supervisor(MODULE, sockets, options.most_sessions, given, _relay, console.warn)
        watchers: list[Watcher[Any]] = [_Status(supervisor, console)]
        if (path := notify_socket()) is not None:
            watchers.append(WorkersNotifier(supervisor, path))
        if how.metrics is not None:
            served = WorkersMetrics(supervisor, parse_host_port(how.metrics, lowest_port=0), console.warn)
            console.say(f"metrics on http://{served.address}/metrics")
            watchers.append(served)
        await _serve(supervisor, Watchers(watchers, console.warn), console, how.duration, str(address), trust)
        return supervisor

    supervisor = run(serve_all())
    console.finish()
    faults = recording_faults(supervisor.workers)
    try:
        deliver(merged_report(supervisor.workers), as_json=how.json, file=how.report, real_time=True)
    finally:
        if faults:
            raise FileError(f"the recordings are incomplete: {'; '.join(faults)}")


async def _serve(
    supervisor: Supervisor,
    watchers: Watchers[Any],
    console: Console,
    duration_s: float | None,
    address: str,
    trust: SlaveTrust,
) -> None:
    """Serve until a signal, the end of the duration, or a worker that ends again and again."""
    loop, before = asyncio.get_running_loop(), terminals()
    stop = stop_on_signals(loop)

    def on_hangup() -> None:
        if not terminal_is_gone(before) and read_masters(trust.guests, console.say, console.warn):
            supervisor.read_again()

    loop.add_signal_handler(signal.SIGHUP, on_hangup)
    stopped = asyncio.ensure_future(stop.wait())
    started = asyncio.ensure_future(supervisor.start())
    await asyncio.wait((started, stopped), return_when=asyncio.FIRST_COMPLETED)
    if not started.done():  # a signal came first
        started.cancel()
        await supervisor.stop()
        return
    started.result()
    await watchers.start()
    repeating = Repeating(loop, lambda: watchers.check(0))
    ready = supervisor.workers[0].ready or {}
    count = len(supervisor.workers)
    console.say(f"listening on {address}, scene {ready.get('scene')}, {ready.get('scheduling')}, {count} workers")
    failed = asyncio.ensure_future(supervisor.until_failure())
    try:
        await asyncio.wait((stopped, failed), timeout=duration_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        repeating.cancel()
        await supervisor.stop()
        stopped.cancel()
        await watchers.stop()
    if failed.done():
        console.finish()
        failed.result()
    failed.cancel()


class _Status(Watcher[Any]):
    """The status line."""

    name = "messages"

    def __init__(self, supervisor: Supervisor, console: Console) -> None:
        self._supervisor = supervisor
        self._console = console

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Update the status line."""
        self._console.status(status(self._supervisor.workers))


def _relay(text: str) -> None:
    """Write a line of a worker in the form of this process; lines of other programs, as they are."""
    try:
        fields = json.loads(text)
        line = LogLine(
            time_s=datetime.fromisoformat(fields["time"]).timestamp(),
            level=Level(fields["level"]),
            who=fields["source"],
            text=fields["message"],
            event=fields.get("event"),
        )
    except (ValueError, KeyError, TypeError):
        line = log_line(text, who="worker")
    STDERR.line(line, needed=line.level is Level.ERROR)
