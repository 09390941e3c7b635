"""Watchers of a master or slave for other programs: metrics and systemd."""

from collections.abc import Callable
from typing import Any

from hapticnet.cli.console import Console
from hapticnet.runtime.metrics import Metrics
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.udp import parse_host_port
from hapticnet.runtime.watching import Notifier, notify_socket


def watch_for_programs(
    node: Any,
    console: Console,
    overload: Overload,
    *,
    metrics: str | None,
    status: Callable[[], str],
    stopping: Callable[[], bool] = lambda: False,
) -> list[Any]:
    """Return the watchers that serve `metrics` at an address, if given, and report the `status` to systemd.

    Raise SettingsError if the address is invalid; UnavailableError if an extra is not installed, or it is taken.
    """
    watchers: list[Any] = []
    if metrics is not None:
        watchers.append(Metrics(node, parse_host_port(metrics, lowest_port=0), overload, console.fault))
        console.say(f"metrics on http://{watchers[0].address}/metrics")
    if (path := notify_socket()) is not None:
        watchers.append(Notifier(path, status, stopping))
    return watchers
