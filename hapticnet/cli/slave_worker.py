"""A worker of ``hapticnet slave --workers``: its parent starts it and talks to it over a socket pair.

Its arguments are file descriptors: the line to the parent, its socket, the table that the workers share, its inbox,
and the outboxes of all.
"""

import asyncio
import os
import signal
import socket
import sys
from typing import TYPE_CHECKING, Any, Final

from hapticnet.errors import HapticnetError, in_words
from hapticnet.runtime.log_lines import Form
from hapticnet.runtime.outlet import STDERR
from hapticnet.runtime.workers.link import Say, WorkerLine

if TYPE_CHECKING:
    from hapticnet.node.slave_events import SlaveEvent

INTERNAL: Final = 70
"""Exit code of a fault in hapticnet itself."""


def main() -> None:
    """Serve until the parent asks for the end, or is gone."""
    line_number, *numbers = map(int, sys.argv[1:])
    STDERR.form = Form.JSON  # the parent writes the lines in the form that was asked for
    line = WorkerLine(socket.socket(fileno=line_number))
    try:
        given = line.set_up()
    except (EOFError, OSError):
        return
    try:
        report = serve(given, line, numbers)
    except HapticnetError as error:
        line.finish(Say.FAILED, {"message": str(error), "exit_code": error.exit_code})
        sys.exit(error.exit_code)
    except Exception as error:
        if os.environ.get("HAPTICNET_TRACEBACK"):
            raise
        line.finish(Say.FAILED, {"message": f"internal error: {in_words(error)}", "exit_code": INTERNAL})
        sys.exit(INTERNAL)
    line.finish(Say.REPORT, report)


def serve(given: dict[str, Any], line: WorkerLine, numbers: list[int]) -> dict[str, Any]:
    """Serve with the settings that the parent has `given`; return the report."""
    from hapticnet.cli.console import Console
    from hapticnet.cli.slave_messages import SlaveMessages
    from hapticnet.cli.slave_setup import SlaveOptions, WorkerContext, find_scene, set_up, slave_settings
    from hapticnet.cli.trust import slave_trust
    from hapticnet.codec.registry import register_installed_codecs
    from hapticnet.runtime.metrics import SlaveFigures
    from hapticnet.runtime.overload import Overload
    from hapticnet.runtime.realtime import OTHER, policy, prefer_realtime, run
    from hapticnet.runtime.slave_run import run_slave
    from hapticnet.runtime.stream import SlaveStream
    from hapticnet.runtime.udp import bound_address, is_loopback, parse_host_port
    from hapticnet.runtime.watching import Watcher
    from hapticnet.runtime.workers.exchange import Exchange
    from hapticnet.runtime.workers.merge import news
    from hapticnet.runtime.workers.neighbourhood import Neighbourhood
    from hapticnet.runtime.workers.presence import Presence
    from hapticnet.runtime.workers.table import Table

    options = SlaveOptions.from_json(given["options"])
    worker, workers, secret = given["worker"], given["workers"], bytes.fromhex(given["secret"])
    udp, table_file, inbox, *outboxes = numbers
    sock = socket.socket(fileno=udp)
    table = Table(table_file, workers, options.most_sessions, secret)
    exchange = Exchange(socket.socket(fileno=inbox), [socket.socket(fileno=each) for each in outboxes])
    console = Console("slave", quiet=options.quiet, real_time=True)
    register_installed_codecs()  # the parent has told what is wrong with them
    source = find_scene(options)
    source.prepare()
    loopback = is_loopback(sock.getsockname())
    trust = slave_trust(bound_address(sock), loopback, options.key, options.masters, options.insecure)
    neighbours = Neighbourhood(table, worker, slave_settings(options).session)
    parts = set_up(options, source, trust, console, WorkerContext(worker, workers, neighbours, secret))
    node = parts.node
    scheduling = prefer_realtime() if options.realtime else OTHER
    # If SCHED_FIFO is refused, it is refused to all: only the first worker says so.
    overload = Overload(scheduling if worker == 0 else policy(scheduling), console.warn)
    figures = SlaveFigures(node, overload) if given["figures"] else None

    class News(Watcher["SlaveEvent"]):
        name = "news"

        def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
            line.say(Say.NEWS, news(node, figures))

    watchers: list[Watcher[SlaveEvent]] = [
        Presence(node, table, worker, neighbours),
        SlaveMessages(console, node, parts.guests),
        News(),
    ]
    if figures is not None:
        watchers.append(figures)
    if parts.recording is not None:
        watchers.append(parts.recording)
    if options.stream is not None:
        watchers.append(SlaveStream(node, parse_host_port(options.stream), console.warn))

    def take(said: Say) -> None:
        if said is Say.STOP:
            signal.raise_signal(signal.SIGTERM)
        elif said is Say.READ_AGAIN:
            signal.raise_signal(signal.SIGHUP)

    def on_listening() -> None:
        line.listen(asyncio.get_running_loop(), take)
        line.say(Say.READY, {"scene": source.name, "scheduling": policy(scheduling), "process": os.getpid()})

    try:
        run(
            run_slave(
                node,
                sock,
                exchange=exchange,
                watchers=watchers,
                overload=overload,
                tell=console.warn,
                on_listening=on_listening,
                on_hangup=lambda: parts.read_masters(lambda _: None, console.warn),  # the parent tells what it found
            )
        )
    finally:
        for fault in parts.close():
            console.warn(fault)
    console.finish()
    account = {"scheduling": scheduling, **node.report(), "overload": overload.report()}
    if parts.recording is not None:
        recorder = parts.recording.recorder
        incomplete = recorder.feed.fault
        account["recording"] = recorder.report() | {"fault": None if incomplete is None else str(incomplete)}
    line.say(Say.NEWS, news(node, SlaveFigures(node, overload)))
    return account | {"hellos_left_out": exchange.left_out}


if __name__ == "__main__":
    main()
