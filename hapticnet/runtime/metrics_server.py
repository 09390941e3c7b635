"""The process of ``--metrics``: it reads figures from its standard input (their definitions first) and serves them.

``/metrics`` is for Prometheus; ``/health`` answers 503 if nothing has come for `STALE_S`, else 200.
"""

import json
import math
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from hapticnet import __version__
from hapticnet.protocol.stats import Distribution

EDGES_S: Final = (  # upper edges [s] of the buckets of histograms; the 1 ms of a tick is one of them
    0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0,
)  # fmt: skip

STALE_S: Final = 3.0  # time [s] without news after which the node counts as stuck: six intervals
CLIENT_TIMEOUT_S: Final = 5.0


class Figures(Collector):
    """The newest figures of a ``master`` or ``slave``; `table` has name, kind, meaning and label of each metric."""

    def __init__(self, role: str, table: list[list[str]]) -> None:
        self.heard_s = time.monotonic()
        self._role = role
        self._table = table
        self._values: dict[str, Any] = {}
        self._histograms: dict[str, dict[str, int]] = {}

    def take(self, line: bytes) -> None:
        """Process a line from `metrics.news`."""
        self.heard_s = time.monotonic()
        self._values, counts = json.loads(line)
        self._histograms |= counts

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics for Prometheus."""
        info = GaugeMetricFamily("hapticnet_info", "Version and role of this process.", labels=("version", "role"))
        info.add_metric((__version__, self._role), 1.0)
        yield info
        for name, kind, meaning, label in self._table:
            full_name, value = f"hapticnet_{name}", self._values.get(name)
            if kind == "histogram":
                buckets, sum_s = histogram(self._histograms.get(name, {}))
                yield HistogramMetricFamily(full_name, meaning, buckets=buckets, sum_value=sum_s)
            elif value is not None:
                make = CounterMetricFamily if kind == "counter" else GaugeMetricFamily
                family = make(full_name, meaning, labels=[label] if label else [])
                for of, each in value.items() if label else [("", value)]:
                    family.add_metric([of] if label else [], each)
                yield family


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
            """Ignore a client that has gone."""

    server = Server(sock.getsockname()[:2], Handler, bind_and_activate=False)
    server.socket.close()
    server.socket = sock
    return server


def main() -> None:
    """Serve until the standard input is closed."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a service manager sends it to all processes; the node ends this one
    descriptor, role, process_id = sys.argv[1:]
    figures, registry = Figures(role, json.loads(sys.stdin.buffer.readline())), CollectorRegistry()
    registry.register(figures)
    ProcessCollector(pid=lambda: int(process_id), registry=registry)  # of the node, not of this process
    server = serve(socket.socket(fileno=int(descriptor)), figures, registry)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for line in sys.stdin.buffer:
        if line.endswith(b"\n"):  # otherwise the node was killed while writing it
            figures.take(line)


if __name__ == "__main__":
    main()
