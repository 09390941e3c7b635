"""Slaves with several worker processes: killed and restarted workers, roaming, common limits, one report."""

import json
import os
import re
import select
import signal
import socket
import time
import urllib.request
from pathlib import Path

import pytest

from hapticnet.protocol.keys import MasterKey, PrivateKey, parse_key
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.clock import now_us
from tests.cli.test_cli_errors import REFUSED, THE_ERROR, UNAVAILABLE
from tests.integration.test_integration_keys import Keys
from tests.peers import HandMaster

FAST = ("--no-realtime", "--device", "none")
PATIENCE_S = 20.0
STEP = "    def step(self, sample):\n        return 0.0\n"


@pytest.fixture
def serve(start):
    """Return what starts a slave with workers, and returns it with its address."""

    def start_slave(*more, workers=2):
        own = ("--listen", "127.0.0.1:0", "--scene", "paper:1", "--no-realtime", "--json")
        process = start("slave", "--workers", str(workers), *own, *more)
        return process, process.wait_for(r"listening on ([\d.]+:\d+)").group(1)

    return start_slave


def workers_of(process):
    """Return the process numbers of a slave's workers, in order."""
    parent = process.process.pid
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(child) for child in children if b"slave_worker" in Path(f"/proc/{child}/cmdline").read_bytes()]


def until(condition):
    """Wait until a condition holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def joined(start, server, address, names, *more):
    """Return masters that have a session each. They come one after another, so each worker counts those before."""
    masters = []
    for name in names:
        run = ("--connect", address, "--name", name, "--duration", "60", "--json")
        masters.append(start("master", *run, *more, *FAST))
        server.wait_for(rf"'{name}'\)? joined from")
    return masters


class Wire:
    """The way of a `HandMaster` to a slave: real sockets, one for each of its addresses."""

    def __init__(self, address):
        host, port = address.split(":")
        self._target = host, int(port)
        self._sockets = {}

    def receive_datagram(self, data, address, now):  # noqa: ARG002 - real time
        if address not in self._sockets:
            self._sockets[address] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sockets[address].sendto(data, self._target)

    def datagrams_to_send(self):
        ready, _, _ = select.select(self._sockets.values(), [], [], 1.0)
        names = {sock: address for address, sock in self._sockets.items()}
        return [(sock.recv(2000), names[sock]) for sock in ready]

    def close(self):
        for sock in self._sockets.values():
            sock.close()


def test_sessions_are_shared_out_and_reported_together(start, serve):
    server, address = serve()
    masters = joined(start, server, address, ["a", "b", "c", "d"])
    for master in masters:
        assert master.end() == 0
    server.wait_for("left: the master closed", count=4)
    assert server.end() == 0
    report = server.report()
    assert sorted(session["master"] for session in report["sessions"]) == ["a", "b", "c", "d"]
    assert [worker["sessions"] for worker in report["workers"]] == [2, 2]
    assert {session["session"] % 2 for session in report["sessions"]} == {0, 1}
    assert sum(worker["steps"] for worker in report["workers"]) == sum(each["steps"] for each in report["sessions"])
    assert report["strangers"]["by_kind"]["hello"] == report["to_strangers"]["by_kind"]["cookie"] >= 4
    for line in server.said().splitlines():
        assert re.match(r"20\S+Z (info|warning) slave: ", line), "each line is whole, in the form of the slave"


def test_a_worker_that_is_killed_takes_only_its_own_sessions_and_these_go_on(start, serve):
    server, address = serve()
    masters = joined(start, server, address, ["a", "b", "c", "d"])
    victim, other = workers_of(server)
    os.kill(victim, signal.SIGKILL)
    server.wait_for(r"worker 0 ended \(SIGKILL\) with 2 sessions; it is started again")
    server.wait_for("joined from", count=6)
    until(lambda: len(workers_of(server)) == 2)
    assert workers_of(server)[0] == other
    for master in masters:
        assert master.end() == 0
    assert sorted(master.report()["connections"] for master in masters) == [1, 1, 2, 2]
    assert sum("link stale" in master.said() for master in masters) == 2, "only those of the killed worker"
    assert server.end() == 0
    report = server.report()
    assert [worker["restarts"] for worker in report["workers"]] == [1, 0]
    assert [worker["sessions_lost"] for worker in report["workers"]] == [2, 0]
    assert len(report["sessions"]) == 4, "those that were lost are not known any more"


def test_a_worker_that_is_stuck_is_killed_and_the_other_goes_on_serving(start, serve):
    server, address = serve()
    joined(start, server, address, ["a", "b"])
    stuck, other = workers_of(server)
    os.kill(stuck, signal.SIGSTOP)
    server.wait_for("worker 0 has been stuck for 10 s and is killed")
    server.wait_for(r"worker 0 ended \(SIGKILL\) with 1 session; it is started again")
    server.wait_for("joined from", count=3)
    assert other in workers_of(server)
    assert server.end() == 0
    assert [worker["restarts"] for worker in server.report()["workers"]] == [1, 0]


def test_a_sealed_master_roams_and_its_worker_knows_it(serve, tmp_path):
    keys = Keys(tmp_path)
    server, address = serve("--key", str(tmp_path / "slave.toml"), "--masters", str(keys.list), workers=3)
    private = PrivateKey(parse_key(re.search(r'private = "(.+)"', (tmp_path / "first.toml").read_text()).group(1), ""))
    wire = Wire(address)
    master = HandMaster(wire, 0, sealed=True, key=MasterKey(private, parse_key(keys.slave, "")), codec="raw")
    master.hello(now_us())
    master.hello(now_us())
    assert master.grant is not None
    for number in range(30):
        master.address = number  # a port of its own
        answers = master.position(1 + number, now_us(), t_us=1000 * number)
        assert [answer.kind for answer in answers] == [Kind.FORCE]
    wire.close()
    assert server.end() == 0
    (session,) = server.report()["sessions"]
    assert session["steps"] == 30
    assert server.report()["strangers"]["by_kind"] == {"hello": 1}


def test_a_master_that_was_restarted_finds_its_scene_at_whatever_worker(start, serve):
    server, address = serve(workers=3)
    _, master = joined(start, server, address, ["other", "surgeon"])
    for turn in range(1, 4):
        master.process.kill()
        master.process.wait()
        master = start("master", "--connect", address, "--name", "surgeon", "--duration", "60", *FAST)
        server.wait_for("'surgeon' left: its master goes on in a new session", count=turn)
    assert server.end() == 0
    chain = [each for each in server.report()["sessions"] if each["master"] == "surgeon"]
    assert [each["continues"] for each in chain] == [None, *(each["session"] for each in chain[:-1])]


def test_the_places_of_all_workers_together_are_limited(start, serve):
    server, address = serve("--most-sessions", "2", workers=3)
    joined(start, server, address, ["a", "b"])
    for _ in range(3):
        late = start("master", "--connect", address, "--name", "late", *FAST)
        assert late.process.wait(30) == REFUSED
        refusal = "refused the session: all 2 sessions of this slave are taken"
        assert THE_ERROR.sub("", late.said().splitlines()[-1]) == f"{address} {refusal}"
    assert server.end() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_workers_with_one_report(start, serve, number):
    server, address = serve()
    masters = joined(start, server, address, ["a", "b"])
    workers = workers_of(server)
    assert server.end(number) == 0
    assert [each["end_reason"] for each in server.report()["sessions"]] == ["the slave closed: shutting down"] * 2
    assert not any(Path(f"/proc/{worker}").exists() for worker in workers)
    for master in masters:
        master.wait_for("session ended|closed")


def test_workers_end_with_a_parent_that_is_killed_and_say_so_to_the_masters(start, serve):
    server, address = serve()
    (master,) = joined(start, server, address, ["a"])
    workers = workers_of(server)
    server.process.kill()
    server.process.wait()
    until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))
    master.wait_for("shutting down")


def test_a_duration_ends_the_slave_and_a_record_has_each_session_of_every_worker(start, serve, tmp_path):
    server, address = serve("--duration", "6", "--record", str(tmp_path / "records"), "--record-format", "mcap")
    joined(start, server, address, ["a", "b"])
    assert server.process.wait(30) == 0, server.said()
    files = sorted(file.name for file in (tmp_path / "records").iterdir())
    assert [name[:2] for name in files] == ["a-", "b-"]
    assert {int(name[2:10], 16) % 2 for name in files} == {0, 1}
    assert server.report()["recording"] == {"files": 2, "sessions_not_recorded": 0, "stopped": None}


def test_one_page_has_the_figures_of_all_workers_also_of_those_that_ended(start, serve):
    server, address = serve("--metrics", "127.0.0.1:0")
    url = re.search(r"http://\S+/metrics", server.said()).group()

    def figures():
        text = urllib.request.urlopen(url, timeout=5).read().decode()
        return dict(re.findall(r"^(hapticnet_\S+) (\S+)$", text, re.MULTILINE))

    joined(start, server, address, ["a", "b"])
    until(lambda: figures().get("hapticnet_sessions") == "2.0")
    until(lambda: float(figures()["hapticnet_steps_total"]) > 500)
    before = figures()
    assert [before[f'hapticnet_worker_sessions{{worker="{number}"}}'] for number in (0, 1)] == ["1.0", "1.0"]
    os.kill(workers_of(server)[0], signal.SIGKILL)
    until(lambda: figures()['hapticnet_worker_restarts_total{worker="0"}'] == "1.0")
    until(lambda: figures()['hapticnet_worker_up{worker="0"}'] == "1.0")
    after = figures()
    assert float(after["hapticnet_steps_total"]) >= float(before["hapticnet_steps_total"])
    assert float(after['hapticnet_events_total{event="MasterJoined"}']) >= 2
    assert urllib.request.urlopen(url.replace("metrics", "health"), timeout=5).status == 200
    assert server.end() == 0


def test_a_list_that_changes_is_read_again_by_every_worker(start, serve, tmp_path):
    keys = Keys(tmp_path)
    keys.list.write_text(keys.first_table + keys.second_table)
    server, address = serve("--key", str(tmp_path / "slave.toml"), "--masters", str(keys.list))
    joined(start, server, address, ["a"], *keys.of("first"))
    joined(start, server, address, ["b"], *keys.of("second"))
    keys.list.write_text(keys.first_table)
    server.process.send_signal(signal.SIGHUP)
    server.wait_for("the key is no longer served")
    assert len(re.findall("read .* again: 1 master$", server.said(), re.MULTILINE)) == 1
    keys.list.write_text("nonsense")
    server.process.send_signal(signal.SIGHUP)
    server.wait_for("the list of masters is unchanged")
    assert server.end() == 0
    reasons = [session["end_reason"] for session in server.report()["sessions"]]
    assert sorted(reasons) == ["the slave closed: shutting down", "the slave closed: the key is no longer served"]


def test_a_worker_that_ends_again_and_again_ends_the_slave_with_one_line(start, tmp_path):
    scene = tmp_path / "crash.py"
    scene.write_text("import os\n\n\nclass Scene:\n    def __init__(self):\n        os._exit(9)\n\n" + STEP)
    server = start("slave", "--workers", "2", "--listen", "127.0.0.1:0", "--scene", f"{scene}:Scene", "--no-realtime")
    assert server.process.wait(60) == UNAVAILABLE
    errors = [line for line in server.said().splitlines() if " error " in line]
    assert len(errors) == 1
    assert re.search(r"worker [01] ended 5 times within 5 s of its start; the last time: exit code 9$", errors[0])


def test_what_a_worker_cannot_do_is_said_once_with_the_exit_code_of_one_slave(start, tmp_path):
    scene = tmp_path / "wrong.py"
    scene.write_text("class Scene:\n    def __init__(self):\n        raise ValueError('no hardware')\n\n" + STEP)
    alone = start("slave", "--listen", "127.0.0.1:0", "--scene", f"{scene}:Scene", "--no-realtime")
    code = alone.process.wait(30)
    shared = start("slave", "--workers", "2", "--listen", "127.0.0.1:0", "--scene", f"{scene}:Scene", "--no-realtime")
    assert shared.process.wait(30) == code
    (line,) = shared.said().splitlines()
    assert THE_ERROR.sub("", line) == THE_ERROR.sub("", alone.said().splitlines()[-1])


def test_what_does_not_go_with_workers_is_refused_in_one_line(start, tmp_path):
    scene = tmp_path / "one.py"
    scene.write_text("class Scene:\n    shared = True\n\n" + STEP)
    listen = ("slave", "--workers", "2", "--listen", "127.0.0.1:0")
    for more, said in (
        (("--channel-out", "loss=5%"), "--channel-out emulates one network"),
        (("--scene", f"{scene}:Scene"), "is one scene for all masters"),
    ):
        server = start(*listen, *more)
        assert server.process.wait(30) == 2
        (line,) = server.said().splitlines()
        assert said in line
        assert "use --workers 1" in line


def test_systemd_hears_from_the_parent_alone(serve, tmp_path, monkeypatch):
    heard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    heard.bind(str(tmp_path / "notify"))
    heard.settimeout(PATIENCE_S)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    server, _ = serve()
    assert heard.recv(1000) == b"READY=1"
    assert heard.recv(1000) == b"WATCHDOG=1\nSTATUS=0 masters, 2 of 2 workers"
    assert server.end() == 0
    said = []
    while not said or said[-1] != b"STOPPING=1":
        said.append(heard.recv(1000))
    heard.setblocking(False)
    with pytest.raises(BlockingIOError):
        heard.recv(1000)
    heard.close()
    assert json.loads(server.output.read_text())["sessions"] == []
