"""Sessions of a person at a terminal, in real time: keys, a slave that dies, a device that is unplugged, Ctrl-C."""

import socket
import subprocess
import sys
import time

import pytest
from terminal import BACKSPACE, ENTER, ESCAPE, INTERRUPT, PATIENCE_S, Terminal

from hapticnet.errors import UnavailableError
from hapticnet_experiment.rows import LimitsRow, OrderRow
from hapticnet_experiment.screens import READ_US
from hapticnet_experiment.store import read_table
from tests.cli.test_cli_errors import ROOT

PLAN = """
name = "short"
[[condition]]
name = "2 JND"
multiplier = 2.0
[order]
breach_forces_n = [1.0, 1.3, 1.6]
trials = 1
practice = 0
practice_pairs = 0
least_delivered = 0.2
most_attempts = 20
[limits]
method = "up-down"
references_n = [1.0]
repetitions = 1
pairs = 5
stimulus_s = 0.3
gap_s = 0.1
tolerance = 1.0
"""
HAND = "time_s,position_m\n0,0\n0.2,0\n2.2,0.072\n2.6,0.072\n2.8,0\n"
MOVES_S = 3.0
READ_S = READ_US / 1e6 + 0.1

LOOSE = '''
"""A device that is unplugged while there is a file of this name."""

from pathlib import Path

import numpy as np

from hapticnet.device.simulated import PlantSettings
from hapticnet.device.simulated import SimulatedDevice


class Loose:
    description = "loose"
    status = "unplugged"

    def __init__(self):
        self._device = SimulatedDevice(PlantSettings(), np.random.default_rng(1))
        self._exchanges, self._gone = 0, False

    def exchange(self, displacement_m, now_us):
        reading = self._device.exchange(displacement_m, now_us)
        self._exchanges += 1
        if self._exchanges % 50 == 0:
            self._gone = Path("unplugged").exists()
        return None if self._gone else reading

    def report(self):
        return {}
'''

ORDER = ("experiment", "order", "--participant", "03", "--plan", "plan.toml", "--operator", "trace:hand.csv")


@pytest.fixture
def laboratory(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "hand.csv").write_text(HAND)
    (tmp_path / "loose.py").write_text(LOOSE)
    return tmp_path


def rows_of(laboratory, task="order"):
    (table,) = laboratory.glob(f"study/sub-03/ses-1/{task}/*.tsv")
    return read_table(table, OrderRow if task == "order" else LimitsRow)


def begin(terminal):
    terminal.expect("Instructions")
    terminal.type(ENTER)
    terminal.expect("I agree")
    terminal.type("y")
    terminal.expect("Hold your finger still")


def play(terminal):
    """Let the hand move, and answer; again while the trial does not count, as on a machine that is too busy."""
    outcomes = "comes again", "How did the tissues", "You have not felt"
    for _ in range(5):
        terminal.expect("Feel the three tissues")
        time.sleep(MOVES_S)
        terminal.type("12")
        terminal.expect("Your answer: 1 2")
        terminal.type("3" + ENTER)
        found = terminal.expect(*outcomes)
        patience_s = 0.0
        while found == "You have not felt" and patience_s < PATIENCE_S:  # the hand is not there yet
            time.sleep(0.5)
            patience_s += 0.5
            terminal.type(BACKSPACE + "3" + ENTER)
            found = terminal.expect(*outcomes)
        if found == "How did the tissues":
            return
        assert found == "comes again"
        time.sleep(READ_S)
        terminal.type(ENTER)
    raise AssertionError("no trial counts")


def test_a_session_at_the_terminal_with_an_escape_a_device_unplugged_and_a_slave_that_dies(laboratory):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"

    def start_slave():
        return subprocess.Popen(
            [sys.executable, "-m", "hapticnet", "slave", "-q", "--listen", address, "--scene",
             "hapticnet_experiment.scene:NamedTissues"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT,
        )  # fmt: skip

    slave = start_slave()
    try:
        with Terminal(*ORDER, "--connect", address, "--device", "loose.py:Loose", cwd=laboratory) as terminal:
            begin(terminal)
            terminal.expect("Feel the three tissues")
            terminal.type(ESCAPE)
            terminal.expect("it was stopped")
            time.sleep(READ_S)
            terminal.type(ENTER)
            terminal.expect("Feel the three tissues")
            time.sleep(0.5)
            (laboratory / "unplugged").touch()
            terminal.expect("a technical fault")
            (laboratory / "unplugged").unlink()
            time.sleep(READ_S)
            terminal.type(ENTER)
            terminal.expect("Feel the three tissues")
            time.sleep(0.5)
            slave.kill()
            slave.wait()
            terminal.expect("a technical fault")
            slave = start_slave()
            time.sleep(READ_S)
            terminal.type(ENTER)
            play(terminal)
            terminal.type("5")
            code, shown = terminal.end()
        assert code == 0, shown
        assert "2 JND" not in shown
        assert "correct" not in shown
    finally:
        slave.kill()
        slave.wait()
    rows = rows_of(laboratory)
    reasons = [row.reason for row in rows if row.event == "aborted"]
    assert reasons == ["the participant stopped", "the device was lost: unplugged", "the link was lost"]
    assert [row.rating for row in rows if row.event == "rating"] == [5]
    (trial,) = [row for row in rows if row.event == "trial"]
    assert (trial.order_answered, trial.condition) == ("123", "2 JND")
    assert trial.peak_sensed_1_n > 0.2
    assert sum(row.event == "meet" for row in rows) >= 4
    recordings = [file.stem for file in (laboratory / "study/sub-03/ses-1/order/recordings").iterdir()]
    assert f"trial-000-{trial.attempt}" in recordings


def test_ctrl_c_ends_a_session_at_once_and_another_process_goes_on_with_it(laboratory):
    with Terminal(*ORDER, cwd=laboratory) as terminal:
        terminal.expect("the consent is hapticnet's default")
        begin(terminal)
        terminal.expect("Feel the three tissues")
        terminal.type("1" + INTERRUPT)
        code, shown = terminal.end()
    assert code == 130
    assert "Traceback" not in shown
    assert "continue with --resume" in shown
    begun = ["begin", "consent", "meet", "started"]
    assert [row.event for row in rows_of(laboratory)] == begun
    with Terminal(*ORDER, "--resume", cwd=laboratory) as terminal:
        terminal.expect("The session goes on")
        time.sleep(1.1)
        terminal.type(ESCAPE)
        code, shown = terminal.end()
    assert code == UnavailableError.exit_code
    assert "the participant ended the session; every answer is stored, continue with --resume" in shown
    assert [row.event for row in rows_of(laboratory)] == [*begun, "aborted", "begin", "stopped"]


def test_a_jnd_is_measured_at_the_terminal_where_masking_noise_must_come_from_elsewhere(laboratory):
    (laboratory / "plan.toml").write_text("masking_noise = true\n" + PLAN)
    words = ("experiment", "limits", "--participant", "03", "--plan", "plan.toml")
    with Terminal(*words, cwd=laboratory) as terminal:
        terminal.expect("masking noise: only the page plays it")
        begin(terminal)
        for _ in range(5):
            terminal.expect("Which was stronger?")
            terminal.type("2")
        code, shown = terminal.end()
    assert code == 0, shown
    assert [row.answer for row in rows_of(laboratory, "limits") if row.event == "trial"] == ["2"] * 5
