"""Slave, master and channel as processes on loopback. Wall-clock limits are loose: they only catch hanging."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from hapticnet.recordings.text import read_csv
from tests.cli.test_cli_errors import REFUSED, THE_ERROR, UNAVAILABLE
from tests.ready import children_of, is_running, wait_until

ROOT = Path(__file__).parents[2]


def test_an_insertion_over_loopback_and_every_packet_accounted_for(start, slave, tmp_path):
    server, address = slave
    report, record = tmp_path / "deep" / "master.json", tmp_path / "master.csv"
    master = start(
        "master", "--connect", address, "--insertions", "1", "--report", str(report), "--record", str(record)
    )
    assert master.process.wait(30) == 0, master.said()
    assert server.end() == 0
    account = json.loads(report.read_text())
    (session,) = server.report()["sessions"]
    assert session["end_reason"] == "the master closed: done"
    assert session["breaches"] == 3
    assert session["exceed_jnd_fraction"] == 0.0
    strangers = server.report()["unknown_peers"]["by_kind"]["hello"]  # those without a cookie, one if nothing is slow
    assert session["received"]["packets"] == account["sent"]["packets"] - strangers
    assert account["received"]["lost"] == 0
    assert account["connections"] == 1
    assert "packet_rate_reduction" not in master.output.read_text(), "the report is for a person without --json"
    table = read_csv(record)
    assert table["held_n"].max() > 4.0
    assert (np.diff(table["t_us"]) > 0).all()


def test_the_master_may_start_first_and_the_slave_may_die_and_come_back(start, free_address):
    master = start("master", "--connect", free_address, "--duration", "60", "--json")
    master.wait_for("asking")
    server = start("slave", "--listen", free_address)
    master.wait_for("connected to")
    server.process.kill()
    server.process.wait()
    master.wait_for("link stale")
    start("slave", "--listen", free_address).wait_for("joined from")
    master.wait_for("connected to", count=2)
    assert master.end() == 0
    assert master.report()["connections"] == 2


def test_the_master_may_die_and_come_back_to_its_scene(start, slave):
    server, address = slave
    first = start("master", "--connect", address, "--duration", "60", "--name", "surgeon")
    first.wait_for("connected to")
    server.wait_for("'surgeon' joined from")
    first.process.kill()
    time.sleep(1.0)  # a session that is alive is not taken over
    second = start("master", "--connect", address, "--duration", "60", "--name", "surgeon")
    server.wait_for("'surgeon' left: its master goes on in a new session")
    assert second.end() == 0
    assert server.end() == 0
    before, after = server.report()["sessions"]
    assert after["continues"] == before["session"]


def test_a_scene_is_kept_for_as_long_as_asked(start, serve):
    server, address = serve("--keep", "1")
    master = start("master", "--connect", address, "--duration", "60")
    server.wait_for("joined from")
    master.process.kill()
    server.wait_for("left: nothing arrived from the master")


def test_a_channel_inside_the_master_delays_and_loses_what_passes_through_it(start, slave):
    _, address = slave
    options = ("--duration", "0.8", "--rate", "500", "--channel-out", "delay=20ms,loss=5%", "--json")
    master = start("master", "--connect", address, *options)
    assert master.process.wait(30) == 0, master.said()
    report = master.report()
    assert report["round_trip"]["p50_us"] > 20_000
    assert report["channel_out"]["lost"] > 5
    assert report["channel_out"]["accepted"] == report["sent"]["packets"]


def test_a_slower_rate_is_granted_and_a_refusal_is_one_line_and_exit_code_5(start, serve):
    _, address = serve("--fastest-rate", "100", "--most-sessions", "1")
    first = start("master", "--connect", address, "--duration", "60")
    first.wait_for("100 Hz granted")
    second = start("master", "--connect", address)
    assert second.process.wait(30) == REFUSED
    refusal = "refused the session: all sessions of this slave are taken; it serves 1 at once"
    assert THE_ERROR.sub("", second.said().splitlines()[-1]) == f"{address} {refusal}"
    assert "Traceback" not in second.said()


def test_a_master_that_finds_no_slave_says_so_and_fails(start, free_address):
    master = start("master", "--connect", free_address, "--connect-timeout", "0.5")
    assert master.process.wait(30) == UNAVAILABLE
    assert THE_ERROR.sub("", master.said().splitlines()[-1]) == (
        f"no session with {free_address} within 0.5 s: is the slave running there?"
    )


def test_a_slave_behind_a_delay_still_says_that_it_closes(start, serve):
    server, address = serve("--channel-out", "delay=50ms")
    master = start("master", "--connect", address, "--duration", "60")
    master.wait_for("connected to")
    assert server.end() == 0
    master.wait_for("session lost .the slave closed: shutting down")


def test_a_demo_that_is_ended_ends_its_processes_first(tmp_path):
    command = [sys.executable, "-m", "hapticnet", "demo", "--out-dir", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT) as demo:
        next(line for line in demo.stderr if "condition 1" in line)
        wait_until(lambda: len(children_of(demo.pid)) == 2)
        children = children_of(demo.pid)
        demo.terminate()
        demo.communicate(timeout=20)
    assert demo.returncode == 128 + signal.SIGTERM
    assert not any(Path(f"/proc/{child}").exists() for child in children)


def test_a_child_ends_when_its_parent_is_killed():
    """As `master --device simavr` and the demo start theirs."""
    script = (
        "import time; from hapticnet.runtime.processes import Child;"
        "child = Child(['slave', '--listen', '127.0.0.1:0']); child.address();"
        "print(child._process.pid, flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=ROOT, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_running(child)
        parent.kill()
    wait_until(lambda: not is_running(child))
