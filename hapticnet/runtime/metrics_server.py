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
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from hapticnet import __version__
from hapticnet.protocol.stats import Distribution
from hapticnet.runtime import metric_table
from hapticnet.runtime.frames import read_frames

STALE_S: Final = 3.0
"""Time [s] without news after which the node counts as stuck: six intervals."""

CLIENT_TIMEOUT_S: Final = 5.0


class Figures(Collector):
    """The newest figures of a node.

    Parameters
    ----------
    role
        ``master`` or ``slave``.
    """

    def __init__(self, role: str) -> None:
        self.heard_s = time.monotonic()
        self._role = role
        self._values: dict[str, Any] = {}
        self._histograms: dict[str, dict[str, int]] = {}

    def take(self, kind: int, body: bytes) -> None:
        """Take in a frame."""
        self.heard_s = time.monotonic()
        content = json.loads(body)
        if kind == 0:
            self._values = content
        else:
            self._histograms[content["name"]] = content["counts"]

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics for Prometheus."""
        info = GaugeMetricFamily("hapticnet_info", "Version and role of this process.", labels=("version", "role"))
        info.add_metric((__version__, self._role), 1.0)
        yield info
        for metric in metric_table.TABLES[self._role]:
            made = self._family(metric)
            if made is not None:
                yield made

    def _family(self, metric: metric_table.Metric) -> Metric | None:
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
    """Return the cumulative buckets of a histogram in seconds, and the sum of its values to half a per cent.

    Parameters
    ----------
    counts
        Counts of a `Distribution` by bucket.
    """
    ratio = Distribution.RATIO
    in_s = sorted((1e-6 * ratio ** (int(bucket) + 1), count) for bucket, count in counts.items())
    buckets = [(str(edge_s), float(sum(count for upper_s, count in in_s if upper_s <= edge_s * ratio**0.5)))
               for edge_s in metric_table.EDGES_S]  # fmt: skip
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
    for kind, body in read_frames(sys.stdin.buffer):
        figures.take(kind, body)


if __name__ == "__main__":
    main()
