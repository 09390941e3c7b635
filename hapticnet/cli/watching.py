"""The watchers that ``--metrics`` and systemd add to a master or a slave."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.node.events import NodeEvent, SlaveEvent
    from hapticnet.node.master import MasterNode
    from hapticnet.node.slave import SlaveNode
    from hapticnet.runtime.overload import Overload
    from hapticnet.runtime.watching import Watcher


def watch_master(
    node: "MasterNode", console: "Console", overload: "Overload", *, metrics: str | None
) -> "list[Watcher[NodeEvent]]":
    """Return what looks on at a master for other programs.

    Raise SettingsError if an address is invalid; UnavailableError if an extra is not installed, or an address is not
    available.
    """
    from hapticnet.cli.master_messages import status
    from hapticnet.runtime.metrics import MasterMetrics

    return [
        *_watch(MasterMetrics, node, console, overload, metrics),
        *_notifiers(lambda: status(node)),
    ]


def watch_slave(
    node: "SlaveNode", console: "Console", overload: "Overload", *, metrics: str | None
) -> "list[Watcher[SlaveEvent]]":
    """Return what looks on at a slave for other programs; raise as `watch_master` does."""
    from hapticnet.cli.slave_messages import status
    from hapticnet.runtime.metrics import SlaveMetrics

    return [
        *_watch(SlaveMetrics, node, console, overload, metrics),
        *_notifiers(lambda: status(node), lambda: node.draining),
    ]


def _notifiers(status: Callable[[], str], stopping: Callable[[], bool] = lambda: False) -> list[Any]:
    from hapticnet.runtime.systemd import Notifier, notify_socket

    path = notify_socket()
    return [] if path is None else [Notifier(path, status, stopping)]


def _watch(
    make_metrics: Any,
    node: Any,
    console: "Console",
    overload: "Overload",
    metrics: str | None,
) -> list[Any]:
    from hapticnet.runtime.udp import parse_host_port

    if metrics is None:
        return []
    served = make_metrics(node, parse_host_port(metrics, lowest_port=0), overload, console.fault)
    console.say(f"metrics on http://{served.address}/metrics")
    return [served]
