"""``--metrics``: figures of a running node for Prometheus, served by a process of its own."""

import asyncio
import json
import math
import os
from collections import Counter
from collections.abc import Callable
from importlib.util import find_spec
from typing import Final, Generic, TypeAlias

from hapticnet.errors import UnavailableError
from hapticnet.node.events import MasterLeft, NodeEvent, SlaveEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.node.slave_context import SlaveContext
from hapticnet.protocol.stats import Distribution, Traffic
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.nonblocking_log import STDERR
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.processes import SideProcess
from hapticnet.runtime.udp import HostPort, bound_address, listen_for_streams
from hapticnet.runtime.watching import Event, Watcher

DROPPED: Final = ("late", "duplicate", "malformed", "stray", "too_old", "over_rate")
"""Why datagrams that arrived are not used: the fields of `Traffic` of these names."""

MODULE: Final = "hapticnet.runtime.metrics_server"

END_WITHIN_S: Final = 1.0

Values: TypeAlias = dict[str, float | dict[str, float]]


class Metrics(Watcher[Event], Generic[Event]):
    """Base of the metrics of master and slave. `tell` is called with a line for the user if the serving process fails.

    Raises UnavailableError if prometheus-client is not installed, or the address is not available.
    """

    name = "metrics"
    role: str

    def __init__(self, address: HostPort, overload: Overload, tell: Callable[[str], None]) -> None:
        if find_spec("prometheus_client") is None:
            raise UnavailableError("--metrics needs prometheus-client (extra metrics): pip install prometheus-client")
        self._socket = listen_for_streams(address)
        self.address = bound_address(self._socket)  # where HTTP is served; port 0 takes a free one
        self._overload = overload
        self._tell = tell
        self._process: SideProcess | None = None
        self._events: Counter[str] = Counter()
        self._turn = 0
        self._told = False

    async def start(self) -> None:
        """Start the serving process."""
        number = self._socket.fileno()
        self._process = SideProcess(MODULE, str(number), self.role, str(os.getpid()), descriptors=[number])
        self._socket.close()
        self._send()

    def note(self, event: Event, now_us: int) -> None:  # noqa: ARG002
        """Count an event."""
        self._events[type(event).__name__] += 1

    def check(self, now_us: int) -> None:  # noqa: ARG002
        """Send the present values, and one of the distributions: all of them together would take too long."""
        self._send()

    async def stop(self) -> None:
        """End the serving process."""
        if self._process is not None:
            self._check_process(self._process)
            await asyncio.to_thread(self._process.finish, END_WITHIN_S)
            self._process.close()

    def values(self) -> Values:
        """Return the present values by name."""
        raise NotImplementedError

    def distributions(self) -> dict[str, Distribution | None]:
        """Return the distributions [µs] by name."""
        raise NotImplementedError

    @property
    def _queue_age(self) -> Distribution | None:
        port = self._overload.port
        return port.queue.age if port is not None else None

    def _common(self, totals: Counter[str]) -> Values:
        """Return the values by name that master and slave have."""
        port = self._overload.port
        return {
            "datagrams": {"sent": totals["sent"], "received": totals["received"]},
            "wire_bytes": {"sent": totals["sent_bytes"], "received": totals["received_bytes"]},
            "datagrams_lost": totals["lost"],
            "datagrams_dropped": {reason: totals[reason] for reason in DROPPED},
            "events": dict(self._events),
            "log_lines_left_out": STDERR.left_out,
            "realtime": float(self._overload.is_realtime),
            "kernel_drops": port.queue.count_drops() if port is not None else 0,
        }

    def _send(self) -> None:
        process = self._process
        if process is None or not self._check_process(process):
            return
        process.pump()
        if process.waiting_bytes:  # it is too far behind: leave this time out
            return
        distributions = list(self.distributions().items())
        self._turn = (self._turn + 1) % len(distributions)
        name, distribution = distributions[self._turn]
        process.put(news(self.values(), **({} if distribution is None else {name: distribution})))
        process.pump()

    def _check_process(self, process: SideProcess) -> bool:
        """Return whether the serving process runs; if it has ended, tell it once."""
        if (code := process.exit_code) is not None and not self._told:
            self._told = True
            self._tell(f"the process of --metrics has ended unexpectedly (exit code {code}); the run goes on")
        return code is None


class MasterMetrics(Metrics[NodeEvent]):
    """The metrics of a master."""

    role = "master"

    def __init__(self, node: MasterNode, address: HostPort, overload: Overload, tell: Callable[[str], None]) -> None:
        super().__init__(address, overload, tell)
        self._node = node

    def values(self) -> Values:
        """Return the present values by name."""
        node, ticker = self._node, self._overload.ticker
        totals = _totals(node.session.sent, node.session.received)
        return self._common(totals) | {
            "forces": {"received": node.session.received.by_kind[Kind.FORCE]},
            "ticks": node.ticks,
            "ticks_missed": ticker.missed if ticker is not None else 0,
            "connected": float(node.session.streaming),
            "connections": node.connections,
            "paused": float(node.paused is not None),
            "held_force_newtons": math.hypot(*node.held_n),
            "target_force_newtons": node.target_n,
            "sensed_force_newtons": node.sensed_n,
            "displacement_meters": node.displacement_m,
        }

    def distributions(self) -> dict[str, Distribution | None]:
        """Return the distributions [µs] by name."""
        node, ticker = self._node, self._overload.ticker
        return {
            "queue_age_seconds": self._queue_age,
            "step_seconds": node.times.all_took(),
            "tick_lateness_seconds": ticker.lateness if ticker is not None else None,
            "round_trip_seconds": node.session.round_trip,
            "force_age_seconds": node.age,
        }


class SlaveMetrics(Metrics[SlaveEvent]):
    """The metrics of a slave: of all its sessions together, so that no master can add names to them."""

    role = "slave"

    def __init__(self, node: SlaveNode, address: HostPort, overload: Overload, tell: Callable[[str], None]) -> None:
        super().__init__(address, overload, tell)
        self._node = node
        self._ended: Counter[str] = Counter()

    def note(self, event: SlaveEvent, now_us: int) -> None:
        """Count an event, and keep the account of a session that has ended."""
        super().note(event, now_us)
        if isinstance(event, MasterLeft):
            self._ended.update(_of_context(event.context))

    def values(self) -> Values:
        """Return the present values by name."""
        node = self._node
        totals = self._ended.copy()
        for context in node.contexts:
            totals.update(_of_context(context))
        return self._common(totals) | {
            "forces": {"sent": totals["forces"]},
            "sessions": len(node.contexts),
            "steps": totals["steps"],
            "draining": float(node.draining),
            "unknown_peers_datagrams": {"received": node.unknown_peers.packets, "sent": node.to_unknown_peers.packets},
            "throttled": node.hello_filter.throttled,
        }

    def distributions(self) -> dict[str, Distribution | None]:
        """Return the distributions [µs] by name."""
        return {"queue_age_seconds": self._queue_age, "step_seconds": self._node.times.all_took()}


def news(values: Values, **distributions: Distribution) -> bytes:
    """Return the line that tells the serving process values, and distributions by name."""
    counts = {name: each.counts() for name, each in distributions.items()}
    return json.dumps([values, counts]).encode() + b"\n"


def _totals(sent: Traffic, received: Traffic) -> Counter[str]:
    return Counter(
        sent=sent.packets,
        sent_bytes=sent.wire_bytes,
        received=received.packets,
        received_bytes=received.wire_bytes,
        lost=received.lost,
        **{reason: getattr(received, reason) for reason in DROPPED},
    )


def _of_context(context: SlaveContext) -> Counter[str]:
    totals = _totals(context.session.sent, context.session.received)
    totals.update(steps=context.steps, forces=context.session.sent.by_kind[Kind.FORCE])
    return totals
