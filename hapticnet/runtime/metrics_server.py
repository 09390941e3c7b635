"""The process of ``--metrics``: it reads figures from its standard input and serves them over HTTP.

``/metrics`` is for Prometheus. ``/health`` answers 200 while the node's loop runs, and 503 if nothing has come from it
for `STALE_S`.
"""

import json
import math
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final, Literal, TypeAlias

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from hapticnet import __version__
from hapticnet.protocol.stats import Distribution

Kind: TypeAlias = Literal["counter", "gauge", "histogram"]

EDGES_S: Final = (
    0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0,
)  # fmt: skip
"""Upper edges [s] of the buckets of histograms; the 1 ms of a tick is one of them."""


@dataclass(frozen=True, slots=True)
class Description:
    """One metric, without the prefix ``hapticnet_``."""

    name: str
    kind: Kind
    meaning: str
    labels: tuple[str, ...] = ()  # names of its labels


COMMON: Final = (
    Description("datagrams", "counter", "Datagrams sent to and received from peers.", ("direction",)),
    Description("wire_bytes", "counter", "Bytes of these datagrams with UDP and IPv4 headers.", ("direction",)),
    Description("forces", "counter", "Force updates sent (slave) or received (master).", ("direction",)),
    Description("datagrams_lost", "counter", "Datagrams of peers that did not arrive."),
    Description("datagrams_dropped", "counter", "Datagrams that arrived and were not used.", ("reason",)),
    Description("queue_age_seconds", "histogram", "Time from arrival at this machine until a datagram is read."),
    Description("step_seconds", "histogram", "Time of a step of scene, operator, device or a user's codec."),
    Description("kernel_drops", "counter", "Datagrams that the system dropped because they were not read in time."),
    Description("events", "counter", "Events of the node, by name.", ("event",)),
    Description("log_lines_left_out", "counter", "Lines that were not written to stderr."),
    Description("realtime", "gauge", "1 under real-time scheduling (SCHED_FIFO), else 0."),
)

MASTER: Final = (
    *COMMON,
    Description("ticks", "counter", "Ticks of the master."),
    Description("ticks_missed", "counter", "Ticks skipped because the next was already due."),
    Description("tick_lateness_seconds", "histogram", "Delay from when a tick was due to its start."),
    Description("round_trip_seconds", "histogram", "Time from a position to its answer."),
    Description("force_age_seconds", "histogram", "Age of the force that is applied."),
    Description("connected", "gauge", "1 in a session, else 0."),
    Description("connections", "counter", "Sessions so far."),
    Description("paused", "gauge", "1 while the operator is not asked because it failed, else 0."),
    Description("held_force_newtons", "gauge", "Norm of the force that is held, at this moment."),
    Description("target_force_newtons", "gauge", "Force requested of the device, at this moment."),
    Description("sensed_force_newtons", "gauge", "Force sensed by the device, at this moment."),
    Description("displacement_meters", "gauge", "Displacement of the device's platform, at this moment."),
)

SLAVE: Final = (
    *COMMON,
    Description("sessions", "gauge", "Sessions at this moment."),
    Description("steps", "counter", "Positions answered."),
    Description("draining", "gauge", "1 while new masters are refused because the slave is to stop, else 0."),
    Description("unknown_peers_datagrams", "counter", "Datagrams of no session.", ("direction",)),
    Description("throttled", "counter", "Requests for a session that were not read because there were too many."),
)

TABLES: Final = {"master": MASTER, "slave": SLAVE}

STALE_S: Final = 3.0  # time [s] without news after which the node counts as stuck: six intervals

CLIENT_TIMEOUT_S: Final = 5.0


class Figures(Collector):
    """The newest figures of a ``master`` or ``slave``."""

    def __init__(self, role: str) -> None:
        self.heard_s = time.monotonic()
        self._role = role
        self._values: dict[str, Any] = {}
        self._histograms: dict[str, dict[str, int]] = {}

    def take(self, line: bytes) -> None:
        """Take in a line from `metrics.news`."""
        self.heard_s = time.monotonic()
        self._values, counts = json.loads(line)
        self._histograms |= counts

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics for Prometheus."""
        info = GaugeMetricFamily("hapticnet_info", "Version and role of this process.", labels=("version", "role"))
        info.add_metric((__version__, self._role), 1.0)
        yield info
        for metric in TABLES[self._role]:
            made = self._family(metric)
            if made is not None:
                yield made

    def _family(self, metric: Description) -> Metric | None:
        name = f"hapticnet_{metric.name}"
        if metric.kind == "histogram":
            buckets, sum_s = histogram(self._histograms.get(metric.name, {}))
            return HistogramMetricFamily(name, metric.meaning, buckets=buckets, sum_value=sum_s)
        value = self._values.get(metric.name)
        if value is None:
            return None
        kind = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
        family: Metric = kind(name, metric.meaning, labels=metric.labels)
        for label, each in value.items() if metric.labels else [((), value)]:
            family.add_metric((label,) if metric.labels else (), each)  # type: ignore[attr-defined]
        return family


def histogram(counts: dict[str, int]) -> tuple[list[tuple[str, float]], float]:
    """Return cumulative buckets [s] of `counts` of a `Distribution`, and the sum of its values to half a per cent."""
    ratio = Distribution.RATIO
    in_s = sorted((1e-6 * ratio ** (int(bucket) + 1), count) for bucket, count in counts.items())
    buckets = [(str(edge_s), float(sum(count for upper_s, count in in_s if upper_s <= edge_s * ratio**0.5)))
               for edge_s in EDGES_S]  # fmt: skip
    buckets.append(("+Inf", float(sum(count for _, count in in_s))))
    return buckets, sum(count * upper_s for upper_s, count in in_s) / math.sqrt(ratio)


def serve(sock: socket.socket, figures: Figures, registry: CollectorRegistry) -> ThreadingHTTPServer:
    """Return a server on a listening socket."""

    class Handler(BaseHTTPRequestHandler):
        timeout = CLIENT_TIMEOUT_S
        server_version = "hapticnet"
        sys_version = ""

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if path == "/metrics":
                encode, content_type = choose_encoder(self.headers.get("Accept", ""))
                self._answer(200, content_type, encode(registry))
            elif path == "/health":
                silent_s = time.monotonic() - figures.heard_s
                ok = silent_s < STALE_S
                text = "ok\n" if ok else f"nothing came from the {figures._role}'s loop for {silent_s:.1f} s\n"
                self._answer(200 if ok else 503, "text/plain; charset=utf-8", text.encode())
            else:
                self._answer(404, "text/plain; charset=utf-8", b"there are /metrics and /health\n")

        def log_message(self, *arguments: object) -> None:
            """Keep no access log."""

        def _answer(self, code: int, content_type: str, body: bytes) -> None:
            self.send_response(code)
            self.send_header("Content-Type", content_type)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    class Server(ThreadingHTTPServer):
        daemon_threads = True
        address_family = sock.family

        def handle_error(self, *arguments: object) -> None:
            """Let a client that has gone be."""

    server = Server(sock.getsockname()[:2], Handler, bind_and_activate=False)
    server.socket.close()
    server.socket = sock
    return server


def main() -> None:
    """Serve until the standard input is closed."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a service manager sends it to all processes; the node ends this one
    descriptor, role, process_id = sys.argv[1:]
    figures, registry = Figures(role), CollectorRegistry()
    registry.register(figures)
    ProcessCollector(pid=lambda: int(process_id), registry=registry)  # of the node, not of this process
    server = serve(socket.socket(fileno=int(descriptor)), figures, registry)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for line in sys.stdin.buffer:
        if line.endswith(b"\n"):  # else the node was killed in the middle of it
            figures.take(line)


if __name__ == "__main__":
    main()
