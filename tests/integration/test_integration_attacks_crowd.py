"""Attacks on the real processes by strangers, by many of them, and by masters gone bad. Wall-clock limits are loose."""

import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hapticnet.node.settings import MasterSettings
from hapticnet.protocol.messages import Hello, Request, pack_hello
from hapticnet.protocol.wire import pack_body
from hapticnet.recordings.text import read_csv
from hapticnet.runtime.system import now_us
from tests.integration.conftest import Process
from tests.integration.on_path import drop, late, pass_on
from tests.integration.unknown_peers import Client, Forger, pump

ELSEWHERE = "127.0.0.66"
"""A host from which nobody works; all of 127/8 is this machine."""

STRANGER = Request("deadband", {}, 0.0, 0.01, 1.0, 1000.0, 1, "stranger")


@pytest.fixture
def clients() -> Iterator[Callable[..., Client]]:
    """Return a maker of masters in this process, each on a socket of its own."""
    made: list[Client] = []

    def make(*arguments: object, **settings: object) -> Client:
        made.append(Client(*arguments, **settings))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for client in made:
        client.close()


def run_for(seconds: float, *pumps: Callable[[], None]) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        for each in pumps:
            each()
        time.sleep(0.0005)


def forged_hello(number: int) -> bytes:
    return pack_hello(Hello(number, b"", pack_body(STRANGER)), 0)


def memory_mb(process: Process) -> float:
    pages = Path(f"/proc/{process.process.pid}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_a_newcomer_gets_in_through_a_flood_of_forged_requests(start, slave, paths):
    """N5: at 1,000 a second and 80 ms of round trip, 31 connections in 5 s and not one answer to a position."""
    _, address = slave
    path = paths(address)
    path.forward = path.feedback = late(0.04)
    flood = Forger(address, forged_hello, per_s=1_000.0)
    run_for(0.5, flood.pump)
    newcomer = start("master", "--connect", path.address, "--duration", "1", "--rate", "200", "--json")
    while newcomer.process.poll() is None:
        run_for(0.02, flood.pump)
    flood.close()
    assert newcomer.process.wait(1) == 0
    report = newcomer.report()
    assert report["connections"] == 1
    assert report["round_trip"]["count"] > 10


def test_one_host_cannot_take_all_seats(start, slave, clients, paths, tmp_path):
    """N7: 64 ports of one host shut all others out, and a master that lost its link for 1.6 s ended."""
    _, address = slave
    path = paths(address)
    record = tmp_path / "master.csv"
    arguments = ("--connect", path.address, "--duration", "60", "--rate", "200", "--record", str(record), "--json")
    master = start("master", *arguments)
    master.wait_for("connected to")
    crowd = [clients(address, host=ELSEWHERE, settings=MasterSettings(rate_hz=20.0)) for _ in range(64)]
    pump(crowd, lambda: sum(each.node.connected for each in crowd) >= 64, within_s=2.0)
    assert sum(each.node.connected for each in crowd) >= 8
    path.forward = path.feedback = drop
    pump(crowd, lambda: False, within_s=1.6)
    path.forward = path.feedback = pass_on
    pump(crowd, lambda: False, within_s=1.5)
    assert master.process.poll() is None, master.said()
    newcomer = start("master", "--connect", address, "--duration", "0.5", "--rate", "200", "--json")
    while newcomer.process.poll() is None:
        pump(crowd, lambda: False, within_s=0.02)
    assert newcomer.process.wait(1) == 0, newcomer.said()
    assert newcomer.report()["round_trip"]["count"] > 5
    assert master.end() == 0
    assert master.report()["round_trip"]["count"] > 100
    assert len(read_csv(record)["t_us"]) > 100


def test_a_master_that_finds_no_seat_any_more_writes_its_report_and_recording(start, serve, clients, paths, tmp_path):
    """N7: it ended without either."""
    server, address = serve("--most-sessions", "1")
    path = paths(address)
    record, report = tmp_path / "master.csv", tmp_path / "master.json"
    arguments = ("--connect", path.address, "--duration", "60", "--rate", "200", "--record", str(record))
    master = start("master", *arguments, "--report", str(report))
    master.wait_for("connected to")
    time.sleep(0.5)  # for a hundred samples
    path.forward = path.feedback = drop
    server.end()
    other = start("slave", "--listen", address, "--most-sessions", "1")
    other.wait_for("listening on")
    rival = clients(address, host=ELSEWHERE, settings=MasterSettings(rate_hz=50.0))
    assert pump([rival], lambda: rival.node.session.round_trip.count > 0, within_s=5.0)
    path.forward = path.feedback = pass_on
    assert pump([rival], lambda: "refuses a new session" in master.said(), within_s=8.0), master.said()
    assert master.end() == 0
    assert json.loads(report.read_text())["connections"] == 1
    assert len(read_csv(record)["t_us"]) > 100


def test_sessions_that_come_and_go_cost_neither_files_nor_memory_without_end(serve, tmp_path):
    """N8: 16,797 sessions of one step in 8 s, as many files, and 118 MB more."""
    folder = tmp_path / "recordings"
    server, address = serve("--record-dir", str(folder), "--json")
    before_mb = memory_mb(server)
    came = 0
    end_s = time.monotonic() + 3.0
    while time.monotonic() < end_s:
        client = Client(address, host=ELSEWHERE)
        if pump([client], lambda: client.node.session.sent.by_kind[4] > 0, within_s=0.05):  # noqa: B023 - used at once
            came += 1
        client.node.close("gone", now_us())
        client.send()
        client.close()
    assert came > 5
    assert memory_mb(server) - before_mb < 15.0
    assert server.end() == 0
    assert len(server.report()["sessions"]) < 40
    assert 0 < len(list(folder.glob("*.about.json"))) < 40


@pytest.mark.parametrize(
    "arguments",
    [
        ("slave", "--listen", "127.0.0.1:0", "--scene", "{endless}.toml"),
        ("master", "--connect", "127.0.0.1:9", "--operator", "trace:{endless}"),
        ("compare", "{endless}"),
    ],
)
def test_an_endless_file_is_refused_in_one_line(start, tmp_path, arguments):
    """N10: MemoryError."""
    endless = tmp_path / "endless"
    endless.symlink_to("/dev/zero")
    endless.with_suffix(".toml").symlink_to("/dev/zero")
    process = start(*(argument.format(endless=endless) for argument in arguments))
    assert process.process.wait(30) == 3
    assert "Traceback" not in process.said()
    assert process.said().count("\n") == 1
    assert str(endless) in process.said()


def test_no_number_of_a_slave_follows_from_its_seed(start, clients):
    """N12: session numbers came from a generator whose outputs tell its state."""
    numbers = []
    for _ in range(2):
        server = start("slave", "--listen", "127.0.0.1:0", "--seed", "7", "--json")
        client = clients(server.wait_for(r"listening on ([\d.]+:\d+)").group(1))
        assert pump([client], lambda: client.node.session.round_trip.count > 0, within_s=5.0)  # noqa: B023
        assert server.end() == 0
        numbers.append(server.report()["sessions"][0]["session"])
    assert numbers[0] != numbers[1]
