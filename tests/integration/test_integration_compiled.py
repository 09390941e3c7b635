"""A slave with --compiled as a process: masters, signals, reports, and what it refuses."""

import pytest

from hapticnet.node.bank import Bank
from hapticnet.protocol.repair import RepairSettings
from hapticnet.runtime.udp_batch import SocketAddresses

FAST = ("--no-real-time",)


@pytest.fixture(scope="module", autouse=True)
def _machine_code():
    """Compile here, where nothing waits: a process then finds the machine code."""
    Bank(1, RepairSettings(), SocketAddresses())


@pytest.fixture
def compiled(start):
    """Return a slave with --compiled on a free port, and its address."""
    process = start("slave", "--listen", "127.0.0.1:0", "--scene", "paper:1", "--compiled", "--json", *FAST)
    return process, process.wait_for(r"listening on ([\d.]+:\d+)").group(1)


def test_masters_of_all_kinds_play_an_insertion(start, compiled):
    server, address = compiled
    kinds = {
        "deadband": ("--codec", "deadband"),
        "raw": ("--codec", "raw"),
        "few": ("--codec", "deadband", "--positions", "line"),
        "motion": ("--codec", "motion-predictive"),
    }
    masters = [
        start("master", "--connect", address, "--name", name, "--insertions", "1", "--rate", "500", *options, *FAST)
        for name, options in kinds.items()
    ]
    assert [master.process.wait(60) for master in masters] == [0, 0, 0, 0], [master.said() for master in masters]
    assert server.end() == 0
    sessions = {session["master"]: session for session in server.report()["sessions"]}
    assert sessions.keys() == kinds.keys()
    for session in sessions.values():
        assert session["end_reason"] == "the master closed: done"
        assert session["breaches"] == 3
        assert session["exceed_jnd_fraction"] < 0.01


def test_a_signal_ends_it_with_the_account_of_present_sessions(start, compiled):
    server, address = compiled
    master = start("master", "--connect", address, "--duration", "60", *FAST)
    server.wait_for("joined from")
    assert server.end() == 0
    (session,) = server.report()["sessions"]
    assert session["end_reason"].startswith("the slave closed")
    assert session["steps"] > 0
    master.end()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--record-dir", "recordings"), "--record-dir needs each sample, which --compiled does not keep"),
        (("--stream", "127.0.0.1:9870"), "--stream needs each sample, which --compiled does not keep"),
    ],
)
def test_what_needs_each_sample_is_refused(start, options, message):
    server = start("slave", "--listen", "127.0.0.1:0", "--compiled", *options, *FAST)
    assert server.process.wait(30) == 2
    assert message in server.said()
    assert "Traceback" not in server.said()
