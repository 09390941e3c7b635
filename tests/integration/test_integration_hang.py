"""User code that does not return: one signal still ends the process, within a stated time and with a report."""

import signal
import time

import pytest

from hapticnet.runtime.signals import CONCLUDE_S, PATIENCE_S, TRIES

FAST = ("--no-real-time",)
BOUND_S = (TRIES + 1) * PATIENCE_S + CONCLUDE_S

OWN = """
import time

class Loops:
    calls = 0

    def step(self, sample):
        self.hang()
        return 1.0

    def sample(self, t_us):
        self.hang()
        return 0.01

    def apply(self, force_n, now_us):
        self.hang()

    def hang(self):
        self.calls += 1
        while self.calls > 100:
            pass

class Waits(Loops):
    def hang(self):
        self.calls += 1
        if self.calls > 100:
            time.sleep(600)

class Deaf(Loops):
    def hang(self):
        self.calls += 1
        while self.calls > 100:
            try:
                time.sleep(0.01)
            except BaseException:
                pass

class ClosesNever(Loops):
    def hang(self):
        pass

    def close(self):
        time.sleep(600)
"""


def ends(process, number):
    """Send a signal; return the exit code, if it comes in time."""
    time.sleep(0.5)  # by then it hangs
    process.process.send_signal(number)
    return process.process.wait(BOUND_S + 10.0)


@pytest.mark.parametrize(
    ("kind", "number", "said"),
    [
        ("Loops", signal.SIGINT, r"Loops\.hang \(own\.py, line \d+\) did not return within 2 s"),
        ("Waits", signal.SIGTERM, r"Waits\.hang \(own\.py, line \d+\) did not return within 2 s"),
        ("Deaf", signal.SIGINT, r"Deaf\.hang \(own\.py, line \d+\) does not return"),
        ("ClosesNever", signal.SIGTERM, r"ClosesNever\.close \(own\.py, line \d+\) did not return within 2 s"),
    ],
)
def test_a_slave_whose_scene_hangs_ends_with_a_report(start, tmp_path, kind, number, said):
    (tmp_path / "own.py").write_text(OWN)
    scene = f"{tmp_path}/own.py:{kind}"
    server = start("slave", "--listen", "127.0.0.1:0", "--scene", scene, "--json", *FAST)
    address = server.wait_for(r"listening on ([\d.]+:\d+)").group(1)
    start("master", "--connect", address, "--duration", "60", *FAST)
    server.wait_for("joined")
    assert ends(server, number) == 1
    server.wait_for(said)
    report = server.report()
    assert "does not return" in report["faults"][-1] or "did not return" in report["faults"][-1]
    assert report["sessions"]


@pytest.mark.parametrize("option", ["--operator", "--device"])
def test_a_master_whose_user_code_hangs_ends_with_a_report(start, slave, tmp_path, option):
    (tmp_path / "own.py").write_text(OWN)
    _, address = slave
    master = start("master", "--connect", address, option, f"{tmp_path}/own.py:Loops", "--json", *FAST)
    master.wait_for("connected to")
    assert ends(master, signal.SIGTERM) in (1, 4)
    master.wait_for(r"Loops\.hang \(own\.py, line \d+\)")
    assert master.report()["faults"]
