"""``--metrics`` and ``--log-json`` of real processes."""

import json
import signal
import socket
import urllib.request

from prometheus_client.parser import text_string_to_metric_families

FAST = ("--device", "none")


def test_both_sides_serve_metrics_and_log_json(start, serve):
    watched = ("--metrics", "127.0.0.1:0", "--log-json", "--json", "--rate", "200")
    server, address = serve("--scene", "paper:1", *watched[:-2], "--no-real-time")
    master = start("master", "--connect", address, "--name", "left", "--duration", "2", *watched, *FAST)
    master.wait_for("connected to")
    for process in (master, server):
        url = process.wait_for(r"metrics on (http://[\d.:]+)").group(1)
        with urllib.request.urlopen(f"{url}/health", timeout=10) as answer:
            assert answer.read() == b"ok\n"
        with urllib.request.urlopen(f"{url}/metrics", timeout=10) as answer:
            families = {family.name for family in text_string_to_metric_families(answer.read().decode())}
        assert {"hapticnet_datagrams", "hapticnet_events", "process_cpu_seconds"} <= families
    assert master.process.wait(30) == 0, master.said()
    assert server.end(signal.SIGTERM) == 0, server.said()
    lines = [json.loads(line) for line in master.said().splitlines()]
    assert {"level", "time", "source", "message"} <= set.intersection(*map(set, lines))
    assert "Connected" in [line.get("event") for line in lines]


def test_a_metrics_address_in_use_is_one_line(start):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        process = start("slave", "--listen", "127.0.0.1:0", "--metrics", address)
        assert process.process.wait(20) == 4
    (line,) = process.said().splitlines()
    assert f"cannot listen on {address} (TCP): " in line
