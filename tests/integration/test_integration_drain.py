"""A slave that is stopped with --drain lets its masters finish, and takes no new ones."""

import signal

import pytest


@pytest.fixture
def server(serve):
    return serve("--drain", "60", "--json")


def test_a_running_master_finishes_and_a_new_one_is_refused_for_now(start, server):
    slave, address = server
    first = start("master", "--connect", address, "--duration", "60", "--json")
    slave.wait_for("joined")
    slave.process.send_signal(signal.SIGTERM)
    slave.wait_for("stopping: takes no new masters; 1 may finish")
    first.wait_for("the slave says: this slave is about to stop")
    late = start("master", "--connect", address, "--name", "late", "--connect-timeout", "3")
    late.wait_for(r"the slave refuses a new session \(this slave is about to stop.*; asking again in 1 s")
    assert late.process.wait(20) == 4
    assert slave.process.poll() is None
    assert first.end() == 0
    assert slave.process.wait(20) == 0
    assert first.report()["end_reason"] == "stopped"
    report = slave.report()["sessions"]
    assert [each["end_reason"] for each in report] == ["the master closed: stopped"]
    assert first.report()["received"]["by_kind"]["notice"] >= 1


def test_a_slave_without_masters_does_not_wait(server):
    assert server[0].end() == 0
    assert "may finish" not in server[0].said()
