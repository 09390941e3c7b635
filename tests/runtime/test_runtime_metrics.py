"""The figures for Prometheus: complete, as the node counts them, and readable by Prometheus's own parser."""

import json
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse

from hapticnet.protocol.stats import Distribution
from hapticnet.runtime import metrics as metrics_module
from hapticnet.runtime.metrics import TABLES, Metrics, news
from hapticnet.runtime.metrics_server import EDGES_S, STALE_S, Figures, histogram, serve
from hapticnet.runtime.overload import Overload
from hapticnet.runtime.udp import HostPort

ANY_PORT = HostPort("127.0.0.1", 0)


@pytest.fixture
def watched(loopback) -> Iterator[list[Metrics]]:
    """Return the metrics of a master and of its slave after two seconds in virtual time."""
    link = loopback(forward="loss=5%", feedback="loss=5%")
    overload = Overload("SCHED_FIFO 10", print)
    made = [Metrics(link.master, ANY_PORT, overload, print), Metrics(link.slave, ANY_PORT, overload, print)]
    link.run(2_000_000)
    yield made
    for each in made:
        each._socket.close()


def figures_of(metrics: Metrics) -> Figures:
    """Return what the serving process shows after all frames of a node."""
    figures = Figures(metrics.role, metrics.table())
    distributions = {name: each for name, each in metrics.distributions().items() if each is not None}
    figures.take(news(metrics.values(), **distributions))
    return figures


def get(url: str, accept: str = "") -> tuple[int, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers={"Accept": accept}), timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


@pytest.fixture
def server():
    """Return what serves figures, and the URL."""
    servers = []

    def start(figures: Figures) -> str:
        registry = CollectorRegistry()
        registry.register(figures)
        sock = socket.create_server(("127.0.0.1", 0))
        made = serve(sock, figures, registry)
        threading.Thread(target=made.serve_forever, daemon=True).start()
        servers.append(made)
        return f"http://127.0.0.1:{sock.getsockname()[1]}"

    yield start
    for each in servers:
        each.shutdown()
        each.server_close()


def test_every_metric_has_a_value_of_its_kind(watched):
    for metrics in watched:
        values, distributions = metrics.values(), metrics.distributions()
        for metric in TABLES[metrics.role]:
            if metric.kind == "histogram":
                assert isinstance(distributions[metric.name], Distribution | None)
            else:
                assert isinstance(values[metric.name], dict) == bool(metric.label)


def test_prometheus_reads_what_the_node_counted(watched, server):
    master, slave = watched
    url = server(figures_of(master))
    for parser, accept in ((parse, ""), (parse_openmetrics, "application/openmetrics-text; version=1.0.0")):
        code, text = get(f"{url}/metrics", accept)
        assert code == 200
        samples = {(each.name, *each.labels.values()): each.value for family in parser(text) for each in family.samples}
        node = master.node
        assert samples["hapticnet_ticks_total",] == node.ticks > 1900
        assert samples["hapticnet_datagrams_total", "sent"] == node.session.sent.packets
        assert samples["hapticnet_datagrams_lost_total",] == node.session.received.lost > 0
        assert samples["hapticnet_round_trip_seconds_count",] == node.session.round_trip.count > 0
        assert samples["hapticnet_connected",] == 1.0
    _, text = get(f"{server(figures_of(slave))}/metrics")
    samples = {(each.name, *each.labels.values()): each.value for family in parse(text) for each in family.samples}
    (context,) = slave.node.contexts
    assert samples["hapticnet_steps_total",] == context.steps > 1800
    assert samples["hapticnet_sessions",] == 1.0


def test_a_session_that_ends_stays_in_the_sums(loopback):
    link = loopback()
    metrics = Metrics(link.slave, ANY_PORT, Overload("SCHED_FIFO 10", print), print)
    link.run(500_000)
    before = metrics.values()
    link.slave.close("enough", link.now_us)
    while (event := link.slave.next_event()) is not None:
        metrics.note(event, link.now_us)
    after = metrics.values()
    assert after["sessions"] == 0
    assert after["steps"] == before["steps"] > 0
    assert after["datagrams"]["received"] == before["datagrams"]["received"]
    assert after["events"]["MasterLeft"] == 1
    metrics._socket.close()


def test_a_histogram_is_that_of_the_distribution():
    distribution = Distribution()
    for value_us in (10.0, 60.0, 900.0, 990.0, 3_000.0, 2_000_000.0):
        distribution.add(value_us)
    counts = json.loads(json.dumps(distribution.counts()))
    buckets, sum_s = histogram(counts)
    by_edge = dict(buckets)
    assert len(buckets) == len(EDGES_S) + 1
    assert (by_edge["5e-05"], by_edge["0.0001"], by_edge["0.001"], by_edge["0.005"]) == (1, 2, 4, 5)
    assert (by_edge["1.0"], by_edge["+Inf"]) == (5, 6)
    assert sum_s == pytest.approx(2.00496, rel=0.006)


def test_health_tells_whether_the_loop_still_runs(server):
    figures = Figures("master", [])
    url = server(figures)
    assert get(f"{url}/health") == (200, "ok\n")
    figures.heard_s -= STALE_S
    code, text = get(f"{url}/health")
    assert code == 503
    assert "nothing came from the master's loop for 3." in text
    figures.take(b"[{}, {}]\n")
    assert get(f"{url}/health")[0] == 200
    assert get(f"{url}/other")[0] == 404


def test_without_the_extra_there_is_one_clear_line(loopback, monkeypatch):
    monkeypatch.setattr(metrics_module, "find_spec", lambda _: None)
    with pytest.raises(metrics_module.UnavailableError, match=r"pip install prometheus-client"):
        Metrics(loopback().master, ANY_PORT, Overload("SCHED_FIFO 10", print), print)
