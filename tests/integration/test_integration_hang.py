"""User code that does not return: one signal still ends the process, within a stated time and with a report."""

import signal

from hapticnet.runtime import signals
from tests.ready import wait_until

BOUND_S = (signals.TRIES + 1) * signals.PATIENCE_S + signals.CONCLUDE_S

OWN = """
import os, time

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
        while self.is_due():
            pass

    def is_due(self):
        self.calls += 1
        if self.calls == 100:
            open(f"{__file__}.{os.getpid()}", "w").close()
        return self.calls >= 100

class Waits(Loops):
    def hang(self):
        if self.is_due():
            time.sleep(600)

class Deaf(Loops):
    def hang(self):
        while self.is_due():
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


KINDS = {
    "Loops": (signal.SIGINT, r"Loops\.\w+ \(own\.py, line \d+\) did not return within 2 s"),
    "Waits": (signal.SIGTERM, r"Waits\.hang \(own\.py, line \d+\) did not return within 2 s"),
    "Deaf": (signal.SIGINT, r"Deaf\.\w+ \(own\.py, line \d+\) does not return"),
    "ClosesNever": (signal.SIGTERM, r"ClosesNever\.close \(own\.py, line \d+\) did not return within 2 s"),
}


def test_masters_and_slaves_whose_user_code_hangs_end_with_a_report(start, serve, slave, tmp_path):
    """All at once, because each takes seconds to end."""
    (tmp_path / "own.py").write_text(OWN)
    servers = {}
    for kind in KINDS:
        servers[kind], address = serve("--scene", f"{tmp_path}/own.py:{kind}", "--json")
        start("master", "--connect", address, "--duration", "60")
    masters = [
        start("master", "--connect", slave[1], option, f"{tmp_path}/own.py:Loops", "--json")
        for option in ("--operator", "--device")
    ]
    for server in servers.values():
        server.wait_for("joined")
    hanging = [server for kind, server in servers.items() if kind != "ClosesNever"] + masters
    wait_until(lambda: all((tmp_path / f"own.py.{process.process.pid}").exists() for process in hanging))
    for kind, (number, _) in KINDS.items():
        servers[kind].process.send_signal(number)
    for master in masters:
        master.process.send_signal(signal.SIGTERM)
    for kind, (_, said) in KINDS.items():
        assert servers[kind].process.wait(BOUND_S + 10.0) == 1
        servers[kind].wait_for(said)
        report = servers[kind].report()
        assert "does not return" in report["faults"][-1] or "did not return" in report["faults"][-1]
        assert report["sessions"]
    for master in masters:
        assert master.process.wait(BOUND_S + 10.0) in (1, 4)
        master.wait_for(r"Loops\.\w+ \(own\.py, line \d+\)")
        assert master.report()["faults"]
