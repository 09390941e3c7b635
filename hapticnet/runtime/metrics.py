"""``--metrics``: figures of a running node for Prometheus, served by a separate process."""

import asyncio
import json
import math
import os
from collections import Counter
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, Final, NamedTuple, TypeAlias, cast

from hapticnet.errors import UnavailableError
from hapticnet.node.events import MasterLeft, NodeEvent, SlaveEvent
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.nonblocking_log import STDERR
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.processes import SideProcess
from hapticnet.runtime.udp import HostPort, bound_address, listen_for_streams
from hapticnet.runtime.watching import Watcher

DROPPED: Final = ("late", "duplicate", "malformed", "stray", "too_old", "over_rate")  # fields of `Traffic`
END_WITHIN_S: Final = 1.0
Values: TypeAlias = dict[str, float | dict[str, float]]


class Metric(NamedTuple):
    """One metric: its name without the prefix ``hapticnet_``, and its value from a summed `Metrics`."""

    name: str
    kind: str  # counter, gauge or histogram
    meaning: str
    value: "Callable[[Metrics], Any]"  # a number, numbers by label, or a Distribution [µs]
    label: str = ""


def both_ways(sent: str, received: str) -> "Callable[[Metrics], Any]":
    """Return a getter of two totals by direction."""
    return lambda of: {"sent": of.totals[sent], "received": of.totals[received]}


def of_master(value: Callable[[MasterNode], Any]) -> "Callable[[Metrics], Any]":
    """Return a getter of a value of a master's node."""
    return lambda of: value(cast("MasterNode", of.node))


def of_slave(value: Callable[[SlaveNode], Any]) -> "Callable[[Metrics], Any]":
    """Return a getter of a value of a slave's node."""
    return lambda of: value(cast("SlaveNode", of.node))


COMMON: Final = (
    Metric("datagrams", "counter", "Datagrams sent to and received from peers.",
           both_ways("sent", "received"), "direction"),
    Metric("wire_bytes", "counter", "Bytes of these datagrams with UDP and IPv4 headers.",
           both_ways("sent_bytes", "received_bytes"), "direction"),
    Metric("datagrams_lost", "counter", "Datagrams of peers that did not arrive.", lambda of: of.totals["lost"]),
    Metric("datagrams_dropped", "counter", "Datagrams that arrived but were not used.",
           lambda of: {reason: of.totals[reason] for reason in DROPPED}, "reason"),
    Metric("queue_age_seconds", "histogram", "Time from arrival at this machine until a datagram is read.",
           lambda of: of.overload.port.queue.age if of.overload.port else None),
    Metric("step_seconds", "histogram", "Time of a step of scene, operator, device or a user's codec.",
           lambda of: of.node.times.all_took()),
    Metric("kernel_drops", "counter", "Datagrams that the system dropped because they were not read in time.",
           lambda of: of.overload.port.queue.count_drops() if of.overload.port else 0),
    Metric("events", "counter", "Events of the node, by name.", lambda of: dict(of.events), "event"),
    Metric("log_lines_left_out", "counter", "Lines that were not written to stderr.", lambda _: STDERR.left_out),
    Metric("realtime", "gauge", "1 under real-time scheduling (SCHED_FIFO), else 0.",
           lambda of: float(of.overload.is_realtime)),
)  # fmt: skip

MASTER: Final = (
    *COMMON,
    Metric("forces", "counter", "Force updates sent (slave) or received (master).",
           of_master(lambda node: {"received": node.session.received.by_kind[Kind.FORCE]}), "direction"),
    Metric("vibrations", "counter", "Frames of vibration sent (slave) or received (master).",
           of_master(lambda node: {"received": node.session.received.by_kind[Kind.VIBRATION]}), "direction"),
    Metric("ticks", "counter", "Ticks of the master.", of_master(lambda node: node.ticks)),
    Metric("ticks_missed", "counter", "Ticks skipped because the next was already due.",
           lambda of: of.overload.ticker.missed if of.overload.ticker else 0),
    Metric("tick_lateness_seconds", "histogram", "Delay from when a tick was due to its start.",
           lambda of: of.overload.ticker.lateness if of.overload.ticker else None),
    Metric("round_trip_seconds", "histogram", "Time from a position to its answer.",
           of_master(lambda node: node.session.round_trip)),
    Metric("force_age_seconds", "histogram", "Age of the force that is applied.", of_master(lambda node: node.age)),
    Metric("connected", "gauge", "1 in a session, else 0.", of_master(lambda node: float(node.session.streaming))),
    Metric("connections", "counter", "Sessions so far.", of_master(lambda node: node.connections)),
    Metric("paused", "gauge", "1 while the operator is not asked because it failed, else 0.",
           of_master(lambda node: float(node.paused is not None))),
    Metric("held_force_newtons", "gauge", "Norm of the force that is held, at this moment.",
           of_master(lambda node: math.hypot(*node.held_n))),
    Metric("target_force_newtons", "gauge", "Force requested of the device, at this moment.",
           of_master(lambda node: node.target_n)),
    Metric("sensed_force_newtons", "gauge", "Force sensed by the device, at this moment.",
           of_master(lambda node: node.sensed_n)),
    Metric("displacement_meters", "gauge", "Displacement of the device's platform, at this moment.",
           of_master(lambda node: node.displacement_m)),
)  # fmt: skip

SLAVE: Final = (
    *COMMON,
    Metric("forces", "counter", "Force updates sent (slave) or received (master).",
           lambda of: {"sent": of.totals["forces"]}, "direction"),
    Metric("vibrations", "counter", "Frames of vibration sent (slave) or received (master).",
           lambda of: {"sent": of.totals["vibrations"]}, "direction"),
    Metric("sessions", "gauge", "Sessions at this moment.", of_slave(lambda node: len(node.contexts))),
    Metric("steps", "counter", "Positions answered.", lambda of: of.totals["steps"]),
    Metric("draining", "gauge", "1 while new masters are refused because the slave is about to stop, else 0.",
           of_slave(lambda node: float(node.draining))),
    Metric("unknown_peers_datagrams", "counter", "Datagrams of no session.",
           of_slave(lambda node: {"received": node.unknown_peers.packets, "sent": node.to_unknown_peers.packets}),
           "direction"),
    Metric("throttled", "counter", "Requests for a session that were not read because there were too many.",
           of_slave(lambda node: node.hello_filter.throttled)),
)  # fmt: skip

TABLES: Final = {"master": MASTER, "slave": SLAVE}


class Metrics(Watcher[NodeEvent | SlaveEvent]):
    """The metrics of a master, or of all sessions of a slave together, served at `address`; port 0 means a free one.

    `tell` is called if the server fails. UnavailableError without prometheus-client, or if the address is taken.
    """

    name = "metrics"
    node: MasterNode | SlaveNode
    overload: Overload

    def __init__(
        self, node: MasterNode | SlaveNode, address: HostPort, overload: Overload, tell: Callable[[str], None]
    ) -> None:
        if find_spec("prometheus_client") is None:
            raise UnavailableError("--metrics needs prometheus-client (extra metrics): pip install prometheus-client")
        self._socket = listen_for_streams(address, f"cannot listen on {address} (TCP)")
        self.address = bound_address(self._socket)
        self.role = "master" if isinstance(node, MasterNode) else "slave"
        self.node = node
        self.overload = overload
        self.events: Counter[str] = Counter()
        self.totals: Counter[str] = Counter()
        self._ended: Counter[str] = Counter()  # of ended sessions
        self._tell = tell
        self._process: SideProcess | None = None
        self._turn = 0
        self._told = False

    async def start(self) -> None:
        """Start the serving process."""
        number = self._socket.fileno()
        arguments = str(number), self.role, str(os.getpid())
        self._process = SideProcess("hapticnet.runtime.metrics_server", *arguments, descriptors=[number])
        self._socket.close()
        self._process.put(json.dumps(self.table()).encode() + b"\n")
        self._send()

    def note(self, event: NodeEvent | SlaveEvent, now_us: int) -> None:  # noqa: ARG002
        """Count an event, and keep the totals of a slave's ended session."""
        self.events[type(event).__name__] += 1
        if isinstance(event, MasterLeft):
            self._ended.update(_totals(event.context.session, event.context.steps))

    def check(self, now_us: int) -> None:  # noqa: ARG002
        """Send the present values, and one of the distributions: all of them together would take too long."""
        self._send()

    async def stop(self) -> None:
        """End the serving process."""
        if self._process is not None:
            self._check_process(self._process)
            await asyncio.to_thread(self._process.finish, END_WITHIN_S)
            self._process.close()

    def table(self) -> list[list[str]]:
        """Return name, kind, meaning and label of each metric."""
        return [[metric.name, metric.kind, metric.meaning, metric.label] for metric in TABLES[self.role]]

    def values(self) -> Values:
        """Return the present values by name."""
        node = self.node
        if isinstance(node, MasterNode):
            self.totals = _totals(node.session, 0)
        else:
            self.totals = self._ended.copy()
            for context in node.contexts:
                self.totals.update(_totals(context.session, context.steps))
        return {metric.name: metric.value(self) for metric in TABLES[self.role] if metric.kind != "histogram"}

    def distributions(self) -> dict[str, Distribution | None]:
        """Return the distributions [µs] by name."""
        return {metric.name: metric.value(self) for metric in TABLES[self.role] if metric.kind == "histogram"}

    def _send(self) -> None:
        process = self._process
        if process is None or not self._check_process(process):
            return
        process.pump()
        if process.waiting_bytes:  # it is too far behind: skip this time
            return
        distributions = list(self.distributions().items())
        self._turn = (self._turn + 1) % len(distributions)
        name, distribution = distributions[self._turn]
        process.put(news(self.values(), **({} if distribution is None else {name: distribution})))
        process.pump()

    def _check_process(self, process: SideProcess) -> bool:
        """Return whether the serving process runs; if it has ended, report that once."""
        if (code := process.exit_code) is not None and not self._told:
            self._told = True
            self._tell(f"the process of --metrics has ended unexpectedly (exit code {code}); the run continues")
        return code is None


def news(values: Values, **distributions: Distribution) -> bytes:
    """Return the line with values and distributions, by name, for the serving process."""
    counts = {name: each.counts() for name, each in distributions.items()}
    return json.dumps([values, counts]).encode() + b"\n"


def _totals(session: Any, steps: int) -> Counter[str]:
    sent, received = session.sent, session.received
    return Counter(
        sent=sent.packets,
        sent_bytes=sent.wire_bytes,
        received=received.packets,
        received_bytes=received.wire_bytes,
        lost=received.lost,
        steps=steps,
        forces=sent.by_kind[Kind.FORCE],
        vibrations=sent.by_kind[Kind.VIBRATION],
        **{reason: getattr(received, reason) for reason in DROPPED},
    )
