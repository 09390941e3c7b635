"""Metrics; and lines of the log: their level, their fields for programs, what they say of options and helpers."""

import json
import os
import signal
import socket
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.ready import hapticnet


def lines_of(process):
    return [json.loads(line) for line in process.said().splitlines()]


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        (["slave", "--bogus", "--log-json"], {}),
        (["slave", "--log-json", "--most-sessions", "many"], {}),
        (["slave", "--scene", "nowhere.toml", "--log-json"], {}),
        (["slave", "--bogus"], {"HAPTICNET_SLAVE_LOG_JSON": "1"}),
        (["slave", "--bogus", "--config", "rig.toml"], {}),
        (["slave", "--bogus", "--config=rig.toml"], {}),
        (["slave", "--rate", "NaN"], {"HAPTICNET_CONFIG": "rig.toml"}),
    ],
)
def test_what_is_wrong_with_options_is_told_in_json_too(arguments, environment, tmp_path, monkeypatch):
    (tmp_path / "rig.toml").write_text("[slave]\nlog-json = true\n")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    ended = hapticnet(*arguments, cwd=tmp_path)
    assert ended.returncode == 2 or "nowhere.toml" in arguments
    (line,) = map(json.loads, ended.stderr.splitlines())
    assert line["level"] == "error"
    assert line["message"]


def test_lines_about_masters_have_fields_for_programs(start, serve):
    server, address = serve("--scene", "paper:1", "--log-json")
    master = start("master", "--connect", address, "--name", "left", "--codec", "raw", "--log-json")
    master.wait_for("connected to")
    assert master.end() == 0
    server.wait_for("left: the master closed")
    assert server.end() == 0
    joined, left = (next(line for line in lines_of(server) if line.get("event") == event)
                    for event in ("MasterJoined", "MasterLeft"))  # fmt: skip
    assert (joined["master"], joined["codec"]) == (left["master"], left["codec"]) == ("left", "raw")
    assert joined["address"].startswith("127.0.0.1:")
    connected = next(line for line in lines_of(master) if line.get("event") == "Connected")
    assert (connected["master"], connected["address"], connected["codec"]) == ("left", address, "raw")


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
    master = start("master", "--page", "0.0.0.0:0", "--connect", "127.0.0.1:9", "--log-json")
    master.wait_for("other hosts can reach the page")
    hand = start("master", "--operator", "udp:0.0.0.0:0", "--connect", "127.0.0.1:9", "--log-json")
    hand.wait_for("can move the tool")
    for process, words in ((master, "other hosts can reach"), (hand, "can move the tool")):
        assert process.end() == 0
        (line,) = [line for line in lines_of(process) if words in line["message"]]
        assert line["level"] == "warning"
        assert not line["message"].startswith("warning")


def test_both_sides_serve_metrics_and_log_json(start, serve):
    watched = ("--metrics", "127.0.0.1:0", "--log-json", "--json", "--rate", "200")
    server, address = serve("--scene", "paper:1", *watched[:-2], "--no-real-time")
    master = start("master", "--connect", address, "--name", "left", "--duration", "2", *watched, "--device", "none")
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
    assert {"level", "time", "source", "message"} <= set.intersection(*map(set, lines_of(master)))


def test_a_metrics_address_in_use_is_one_line(start):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        process = start("slave", "--listen", "127.0.0.1:0", "--metrics", address)
        assert process.process.wait(20) == 4
    (line,) = process.said().splitlines()
    assert f"cannot listen on {address} (TCP): " in line
