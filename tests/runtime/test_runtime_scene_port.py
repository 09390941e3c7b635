"""A scene in another program: its socket, and what a person is told about it."""

import json
import socket
import threading
import time
from contextlib import contextmanager, suppress

import pytest

import hapticnet as hn
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.node.events import SceneSaid
from hapticnet.runtime.hand_port import MOST_IN_A_PERIOD
from hapticnet.runtime.scene_port import find_live_source
from hapticnet.samples import PositionSample
from hapticnet.scene.sources import SceneSource, find_source
from tests.ready import wait_until


@pytest.fixture
def program():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


def port_of(sock):
    return sock.getsockname()[1]


def answer(sock, force_n):
    asked, sender = sock.recvfrom(512)
    asked = json.loads(asked)
    sock.sendto(json.dumps({"force_n": force_n, "t_us": asked["t_us"]}).encode(), sender)
    return asked


def test_a_position_is_sent_and_the_newest_answer_used_without_waiting(program):
    source = find_live_source(f"udp:{port_of(program)},axes=2")
    source.prepare()
    scene = source.make()
    assert (source.name, source.risks, scene.axes) == (f"udp:127.0.0.1:{port_of(program)}", (), 2)
    began = time.perf_counter()
    assert scene.step(PositionSample(1000, (0.01, 0.0))).force_n == (0.0, 0.0)
    assert time.perf_counter() - began < 0.1
    asked = answer(program, [1.0, 2.0])
    assert asked == {"position_m": [0.01, 0.0], "t_us": 1000}
    wait_until(lambda: scene.step(PositionSample(1000, (0.01, 0.0))).force_n == (1.0, 2.0))
    assert scene.report()["answers"] == 1
    assert source.close() == []
    assert scene.touched._sock.fileno() == -1


def test_each_master_has_its_own_sender_and_others_cannot_answer(program):
    source = find_live_source(f"udp:127.0.0.1:{port_of(program)}")
    one, other = source.make(), source.make()
    for scene in (one, other):
        scene.step(PositionSample(0, (0.01,)))
    senders = [program.recvfrom(512)[1] for _ in range(2)]
    assert senders[0] != senders[1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(100):
            stranger.sendto(b"[100.0]", senders[0])
    assert one.step(PositionSample(0, (0.01,))).force_n == (0.0,)
    assert one.report()["answers"] == 0
    source.close()


def test_a_flood_delays_no_step(program):
    scene = find_live_source(f"udp:{port_of(program)}").make()
    scene.step(PositionSample(0, (0.01,)))
    sender = program.recvfrom(512)[1]
    for _ in range(5 * MOST_IN_A_PERIOD):
        program.sendto(b"garbage", sender)
    scene.step(PositionSample(0, (0.01,)))
    assert scene.report()["malformed"] == MOST_IN_A_PERIOD


@contextmanager
def serving(sock, force_n):
    """Answer every position with this force, in a thread that ends with the block."""
    ending = threading.Event()
    sock.settimeout(0.05)

    def serve():
        while not ending.is_set():
            with suppress(TimeoutError):
                answer(sock, [force_n])

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def test_a_program_that_ends_and_comes_back_is_noticed(program):
    port = port_of(program)
    with (
        hn.ThreadedSlave(f"udp:{port}", listen="127.0.0.1:0") as slave,
        hn.ThreadedMaster(slave.address, codec="raw") as master,
    ):
        with serving(program, 1.5):
            wait_until(lambda: master.force_n == (1.5,))
        program.close()
        wait_until(lambda: master.force_n == (0.0,))
        late = f"the scene at 127.0.0.1:{port} does not answer within 20 ms; the force decays to zero"
        wait_until(lambda: any(getattr(each, "reason", None) == late for each in master.take_events()))
        assert late in [each.line for each in slave.take_events() if isinstance(each, SceneSaid)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
            again.bind(("127.0.0.1", port))
            with serving(again, 2.5):
                wait_until(lambda: master.force_n == (2.5,))
        report = slave.report()["sessions"][0]["scene_report"]
    assert report["lapses"] >= 1
    assert 0 < report["answers"] < report["asked"]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("udp:fast", SettingsError, "port 'fast' of address"),
        ("udp:no.such.host.invalid:1", UnavailableError, "no.such.host.invalid"),
    ],
)
def test_addresses_that_cannot_be_used_are_refused(text, error, message):
    with pytest.raises(error, match=message):
        find_live_source(text)


def test_other_hosts_are_warned_of_and_other_scenes_found():
    assert "decides the force" in find_live_source("udp:192.0.2.1:47901").risks[0]
    assert type(find_live_source("paper:1")) is SceneSource


def test_virtual_time_refuses_a_program():
    with pytest.raises(SettingsError, match="only a slave can ask it"):
        find_source("udp:47901")
