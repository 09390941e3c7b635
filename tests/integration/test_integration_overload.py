"""A process that cannot keep up says so on its console and in its report."""

import signal
import socket
import time

from hapticnet.experiment.conditions import CONDITIONS
from hapticnet.experiment.demo import Played, disturbances

PATIENCE_S = 20.0
FAST = ("--no-realtime",)


def test_a_slave_that_was_stopped_tells_what_waited_and_what_was_dropped(start, slave):
    server, address = slave
    host, port = address.split(":")
    master = start("master", "--connect", address, "--rate", "200", "--duration", "60", *FAST)
    server.wait_for("joined")
    for number in (1, 2):  # before the first stop it may still be starting, which is no overload
        server.process.send_signal(signal.SIGSTOP)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for _ in range(10_000):  # more than fit into its buffer
                sock.sendto(b"x" * 40, (host, int(port)))
        master.wait_for("link stale", number)
        server.process.send_signal(signal.SIGCONT)
        master.wait_for("link recovered", number)
    server.wait_for(r"overloaded: the system dropped [\d,]+ datagrams that were not read in time")
    server.wait_for(r"overloaded: datagrams wait [\d.]+ ms until this process reads them")
    master.end()
    assert server.end() == 0
    overload = server.report()["overload"]
    assert overload["kernel_drops"] > 1000
    assert overload["queue_age_p99_us"] > 5000
    assert overload["missed_ticks"] is None
    assert overload["lines_left_out"] == 0


def test_a_master_that_was_stopped_tells_the_ticks_it_missed(start, slave):
    _, address = slave
    master = start("master", "--connect", address, "--duration", "60", "--json", *FAST)
    master.wait_for("connected to")
    deadline = time.monotonic() + PATIENCE_S
    while "ticks were missed within a second" not in master.said():
        assert time.monotonic() < deadline
        for number in (signal.SIGSTOP, signal.SIGCONT):
            master.process.send_signal(number)
            time.sleep(0.1)
    assert master.end() == 0
    assert "this machine was too busy for 1000 Hz: " in master.said()
    overload = master.report()["overload"]
    assert overload["missed_ticks"] > 50
    assert overload["missed_share"] > 0.01
    assert overload["scheduling"] == "SCHED_OTHER"


def test_a_demo_on_a_busy_machine_says_so():
    fast = {"queue_age_p99_us": 80.0, "missed_ticks": 3, "missed_share": 0.001, "kernel_drops": 0}
    slow = {"queue_age_p99_us": 80.0, "missed_ticks": 300, "missed_share": 0.1, "kernel_drops": 0}

    def played(overload, scheduling):
        master = {"overload": overload, "scheduling": scheduling}
        return Played(CONDITIONS[0], {}, master, fast | {"kernel_drops": 7}, {}, {})

    assert disturbances([played(slow, "SCHED_FIFO 10")]) == (
        f"{CONDITIONS[0].name}: 300 ticks (10.0%) were missed; slave: the system dropped 7 datagrams"
    )
    assert disturbances([played(fast, "SCHED_OTHER (refused)")]) == (
        "no real-time scheduling; slave: the system dropped 7 datagrams"
    )
