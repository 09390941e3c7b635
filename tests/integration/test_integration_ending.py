"""Signals to processes that are ending already, and user code that raises what a signal would."""

import signal
import time

import pytest

OWN = """
class Interrupts:
    calls = 0

    def step(self, sample):
        self.calls += 1
        if self.calls > 20:
            raise KeyboardInterrupt
        return 0.5


class InterruptsABound(Interrupts):
    def step(self, sample):
        return 0.5

    def stiffness_bound(self):
        raise KeyboardInterrupt


class ExitsInABound(InterruptsABound):
    def stiffness_bound(self):
        raise SystemExit
"""


def hammer(process):
    """Send signals of both kinds until a process has ended; return its exit code."""
    deadline = time.monotonic() + 30.0
    while process.process.poll() is None and time.monotonic() < deadline:
        for number in (signal.SIGINT, signal.SIGTERM):
            process.process.send_signal(number)
            time.sleep(0.0005)
    return process.process.wait(1.0)


@pytest.mark.parametrize("options", [(), ("--drain", "30")], ids=["plain", "drain"])
def test_no_number_of_signals_costs_a_slave_its_report_or_its_code(start, serve, options):
    slave, address = serve(*options, "--json")
    master = start("master", "--connect", address, "--duration", "60", "--json")
    slave.wait_for("joined")
    assert hammer(slave) == 0
    assert slave.report()["sessions"]
    assert hammer(master) == 0
    assert master.report()["ticks"] > 0


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("Interrupts", "Interrupts.step raised KeyboardInterrupt"),
        ("InterruptsABound", "InterruptsABound.stiffness_bound raised KeyboardInterrupt"),
        ("ExitsInABound", "ExitsInABound.stiffness_bound raised SystemExit"),
    ],
)
def test_a_scene_that_raises_what_a_signal_would_fails_like_any_other(start, serve, tmp_path, kind, said):
    (tmp_path / "own.py").write_text(OWN)
    slave, address = serve("--scene", f"{tmp_path}/own.py:{kind}", "--json")
    for _ in range(2):
        master = start("master", "--connect", address, "--positions", "line", "--json")
        assert master.process.wait(20) == 4
    assert slave.end() == 1
    sessions = slave.report()["sessions"]
    assert len(sessions) == 2
    assert all(said in each["end_reason"] for each in sessions)
