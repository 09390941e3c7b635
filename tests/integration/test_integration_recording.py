"""What processes record, when they are killed and when the disk is full."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from hapticnet.node.recording import master_columns, slave_columns
from hapticnet.recordings.tables import read_csv
from tests.cli.test_cli_errors import THE_ERROR

FAST = ("--no-realtime",)
ROOT = Path(__file__).parents[2]
PATIENCE_S = 20.0


def address_of(slave):
    return slave.wait_for(r"listening on ([\d.]+:\d+)").group(1)


def rows_of(spool):
    """Read a spool file as docs/recordings.md says."""
    with spool.open("rb") as file:
        names = tuple(file.readline().decode().strip().split(","))
        data = file.read()
    return names, np.frombuffer(data[: len(data) // (8 * len(names)) * 8 * len(names)]).reshape(-1, len(names))


def test_processes_that_are_killed_leave_their_rows(start, tmp_path):
    folder, record = tmp_path / "slave", tmp_path / "master.csv"
    server = start("slave", "--listen", "127.0.0.1:0", "--record", str(folder), *FAST)
    master = start("master", "--connect", address_of(server), "--name", "one", "--record", str(record), *FAST)
    spool = tmp_path / "master.csv.unfinished"
    deadline = time.monotonic() + PATIENCE_S
    while not (folder.is_dir() and list(folder.iterdir()) and spool.exists() and len(rows_of(spool)[1]) > 500):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    for process in (server, master):
        assert process.end(signal.SIGKILL) == -signal.SIGKILL
    names, rows = rows_of(spool)
    assert names == master_columns(1)
    assert (np.diff(rows[:, 0]) > 0).all()
    (left,) = folder.iterdir()
    assert left.name.startswith("one-")
    assert left.name.endswith(".csv.unfinished")
    names, rows = rows_of(left)
    assert names == slave_columns(1)
    assert (np.diff(rows[:, 0]) > 0).all()


def test_a_full_disk_ends_the_recording_but_not_the_run(start, tmp_path):
    """A limit of the size of files stands for the disk; it is above that of the report."""
    folder, report = tmp_path / "slave", tmp_path / "slave.json"
    command = f"ulimit -f 24; exec {sys.executable} -m hapticnet slave --listen 127.0.0.1:0 --no-realtime"
    slave = subprocess.Popen(
        ["bash", "-c", f"{command} --record {folder} --report {report}"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
    )
    assert slave.stderr is not None
    address = next(slave.stderr).split("listening on ")[1].split(",")[0]
    for name in ("one", "two"):
        master = start("master", "--connect", address, "--name", name, "--duration", "2", "--rate", "500", *FAST)
        assert master.process.wait(PATIENCE_S) == 0, master.said()
    slave.send_signal(signal.SIGINT)
    _, said = slave.communicate(timeout=PATIENCE_S)
    assert slave.returncode == 3, "the user must not believe that the recordings are complete"
    assert said.count("recording stops: ") == 1
    assert "Traceback" not in said
    assert THE_ERROR.sub("", said.splitlines()[-1]).startswith("the recordings are incomplete: ")
    account = json.loads(report.read_text())
    assert [session["master"] for session in account["sessions"]] == ["one", "two"]
    assert account["recording"]["stopped"].endswith("File too large")


def test_what_is_recorded_has_a_limit(start, tmp_path):
    folder, record = tmp_path / "slave", tmp_path / "master.csv"
    limited = ("--record-limit", "40kB")
    server = start("slave", "--listen", "127.0.0.1:0", "--record", str(folder), "--json", *limited, *FAST)
    master = start(
        "master", "--connect", address_of(server), "--duration", "1.5", "--rate", "300", "--record", str(record),
        "--json", *limited, *FAST,
    )  # fmt: skip
    assert master.process.wait(PATIENCE_S) == 0, master.said()
    assert server.end() == 0, server.said()
    for process in (server, master):
        assert process.said().count("the limit of 40,000 bytes is reached (--record-limit)") == 1
        assert process.report()["recording"]["stopped"] is not None
    (file,) = folder.iterdir()
    for each in (file, record):
        assert each.stat().st_size <= 40_000
        assert len(read_csv(each)["t_us"]) > 10
