"""Metrics; and lines of the log: what they say of options and helpers."""

import os
import signal
import socket
import urllib.request
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families


def test_options_without_effect_are_told_once(start, serve, tmp_path):
    (tmp_path / "own.py").write_text("class Spring:\n    def step(self, sample):\n        return 1.0\n")
    scene = f"{tmp_path}/own.py:Spring"
    server, address = serve("--scene", scene, "--record-format", "mcap")
    given = ("--announced", "--positions", "line", "--device", "none", "--first-touch", "--record-limit", "1000000")
    master = start("master", "--connect", address, *given)
    for option in ("--announced", "--positions line", "--first-touch", "--record-limit"):
        master.wait_for(f"warning master: {option} has no effect: ")
    assert master.end() == 0
    assert master.said().count("has no effect") == 4
    assert server.end() == 0
    assert server.said().count("warning slave: --record-format has no effect: it needs --record-dir") == 1


def test_a_process_beside_a_slave_that_died_is_told_once_in_log_report_and_exit_code(start):
    server = start("slave", "--listen", "127.0.0.1:0", "--metrics", "127.0.0.1:0", "--json")
    server.wait_for("listening on")
    (helper,) = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text().split()
    os.kill(int(helper), signal.SIGKILL)
    said = "warning slave: the process of --metrics has ended unexpectedly (exit code -9); the run continues"
    server.wait_for(said.replace("(", r"\(").replace(")", r"\)"))
    assert server.end() == 1
    assert server.said().count("warning slave: the process of --metrics") == 1
    assert server.report()["faults"] == [said.removeprefix("warning slave: ")]


def test_what_lets_other_hosts_in_is_a_warning(start):
    master = start("master", "--page", "0.0.0.0:0", "--connect", "127.0.0.1:9")
    hand = start("master", "--operator", "udp:0.0.0.0:0", "--connect", "127.0.0.1:9")
    master.wait_for("warning master: other hosts can reach the page")
    hand.wait_for("warning master: anyone who reaches .* can move the tool")
    for each in (master, hand):  # from then on it ends with a report
        each.wait_for("device ready")
    assert (master.end(), hand.end()) == (0, 0)


def test_both_sides_serve_metrics(start, serve):
    watched = ("--metrics", "127.0.0.1:0")
    server, address = serve("--scene", "paper:1", *watched, "--no-real-time")
    given = ("--name", "left", "--duration", "2", "--rate", "200", "--device", "none")
    master = start("master", "--connect", address, *given, *watched)
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


def test_a_metrics_address_in_use_is_one_line(start):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        process = start("slave", "--listen", "127.0.0.1:0", "--metrics", address)
        assert process.process.wait(20) == 4
    (line,) = process.said().splitlines()
    assert f"cannot listen on {address} (TCP): " in line
