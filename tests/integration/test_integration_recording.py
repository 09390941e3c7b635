"""What processes record, when they are killed and when the disk is full."""

import json
import signal
import time
from urllib.request import urlopen

import numpy as np

from hapticnet.cli.pages import address_of
from hapticnet.node.recording import master_columns, slave_columns
from hapticnet.recordings.session.reading import read_session
from hapticnet.recordings.session.sink import UNFINISHED
from hapticnet.recordings.text import read_csv
from tests.cli.test_cli_errors import THE_ERROR
from tests.integration.conftest import PATIENCE_S
from tests.ready import wait_until

MOST_LOST_US = 1_000_000
"""The bound is 0.3 s; on a machine that is busy with other tests, timers are late."""


def test_both_sides_record_and_their_files_join(start, serve, tmp_path):
    folder, record = tmp_path / "slave", tmp_path / "master.mcap"
    server, address = serve("--record-dir", str(folder), "--record-format", "mcap")
    master = start(
        "master", "--connect", address, "--name", "one", "--duration", "1", "--record", str(record),
        "--json", "--seed", "5",
    )  # fmt: skip
    assert master.process.wait(PATIENCE_S) == 0, master.said()
    assert server.end() == 0, server.said()
    (file,) = folder.iterdir()
    ours, theirs = read_session(record), read_session(file)
    assert tuple(ours.main) == master_columns(1)
    assert tuple(theirs.main) == slave_columns(1)
    assert set(theirs.main["t_us"]) <= set(ours.main["t_us"]), "both sides have the master's clock"
    assert len(theirs.main["t_us"]) == theirs.about["report"]["steps"] > 100
    assert abs(ours.unix_offset_us - theirs.unix_offset_us) < MOST_LOST_US
    assert ours.about["seed"] == 5
    assert ours.about["asked_at_start"]["law"]["weber_fraction"] == 0.05
    assert ours.about["report"]["sent"] == master.report()["sent"]
    assert len(ours.tables["datagram"]["t_us"]) == (
        master.report()["sent"]["packets"] + master.report()["received"]["packets"]
    )
    assert [event.name for event in ours.events] == ["DeviceFound", "Connected", "SettingsInForce", "Ended"]
    assert [event.name for event in theirs.events] == ["MasterJoined", "SettingsInForce", "MasterLeft"]
    assert theirs.about["request"]["name"] == "one"
    assert "ticket" not in json.dumps(ours.about | theirs.about)
    shown = start("replay", str(record), str(file), "--page", "127.0.0.1:0")
    link = shown.wait_for(r"watch it here: open (file://\S+\.html)")[1]
    with urlopen(address_of(link)) as answer:
        assert b"Time in the recording" in answer.read()
    assert shown.end() == 0, shown.said()


def test_processes_that_are_killed_leave_complete_files(start, serve, tmp_path):
    folder, record = tmp_path / "slave", tmp_path / "master.mcap"
    server, address = serve("--record-dir", str(folder), "--record-format", "mcap")
    master = start("master", "--connect", address, "--name", "one", "--record", str(record))
    unfinished = tmp_path / f"master.mcap{UNFINISHED}"
    wait_until(lambda: unfinished.exists() and unfinished.stat().st_size > 30_000)
    for process in (master, server):
        assert process.end(signal.SIGKILL) == -signal.SIGKILL
    wait_until(lambda: record.exists() and list(folder.glob("*.mcap")))
    (file,) = folder.glob("*.mcap")
    ours, theirs = read_session(record), read_session(file)
    assert (ours.is_whole, ours.complete) == (True, False), "the file is complete, its session is not"
    assert (theirs.is_whole, theirs.complete) == (True, False)
    assert (np.diff(ours.main["t_us"]) > 0).all()
    assert theirs.main["t_us"][-1] - ours.main["t_us"][-1] < MOST_LOST_US
    assert [event.name for event in theirs.events] == ["MasterJoined", "SettingsInForce"]


def test_a_full_disk_ends_the_recording_but_not_the_run(start, serve, tmp_path):
    """A limit of the size of files stands for the disk; it is above that of the report."""
    folder, report = tmp_path / "slave", tmp_path / "slave.json"
    # The limit would cut off compiled modules for all others.
    limited = ("env", "PYTHONDONTWRITEBYTECODE=1", "bash", "-c", 'ulimit -f 24; exec "$@"', "bash")
    slave, address = serve("--record-dir", str(folder), "--report", str(report), prefix=limited)
    for name in ("one", "two"):
        master = start("master", "--connect", address, "--name", name, "--duration", "60", "--rate", "500")
        slave.wait_for(f"'{name}' joined")
        slave.wait_for("recording stops: ")
        assert master.end() == 0, master.said()
    assert slave.end(signal.SIGINT) == 3, "the user must not believe that the recordings are complete"
    assert slave.said().count("recording stops: ") == 1
    assert "Traceback" not in slave.said()
    assert THE_ERROR.sub("", slave.said().splitlines()[-1]).startswith("the recordings are incomplete: ")
    account = json.loads(report.read_text())
    assert [session["master"] for session in account["sessions"]] == ["one", "two"]
    assert "File too large" in account["recording"]["stopped"]


def test_what_is_recorded_has_a_limit(start, serve, tmp_path):
    folder, record = tmp_path / "slave", tmp_path / "master.csv"
    limited = ("--record-limit", "60kB")
    server, address = serve("--record-dir", str(folder), "--json", *limited)
    master = start(
        "master", "--connect", address, "--duration", "60", "--rate", "500", "--record", str(record),
        "--json", *limited,
    )  # fmt: skip
    for process in (server, master):
        process.wait_for("the limit of 60,000 bytes for recordings is reached")
    time.sleep(0.3)  # what comes later is not recorded
    assert master.end() == 0, master.said()
    assert server.end() == 0, server.said()
    for process in (server, master):
        assert process.said().count("the limit of 60,000 bytes for recordings is reached") == 1
        assert process.report()["recording"]["stopped"] is not None
    for files in (folder.iterdir(), tmp_path.glob("master.*.csv"), [record]):
        assert sum(file.stat().st_size for file in files) <= 60_000
    assert len(read_csv(record)["t_us"]) > 10
