"""Attacks on the real processes by someone on the path between them. Wall-clock limits are loose."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np
import pytest

from hapticnet.protocol.wire import Kind, pack, unpack
from hapticnet.recordings.text import read_csv
from tests.integration.conftest import Process, write_keys
from tests.integration.on_path import OnPath, drop, late, pass_on

FORCE_N = 2.0
SCENE = """
name = "one"

[[tissue]]
name = "one"
rest_position_m = {}
stiffness_n_per_m = {}
breach_force_n = {}
"""
GEL = SCENE.format(0.0, 100.0, 1e6)
SKIN = SCENE.format(0.02, 200.0, 3.0)
REST = {0.0: 0.02, 100.0: 0.02}
PIERCE = {0.0: 0.0, 0.3: 0.034, 0.8: 0.034, 0.9: 0.06, 1.1: 0.032, 100.0: 0.032}
"""Press the skin with 2.8 N for half a second, pierce it, and rest where it would press with 2.4 N if it were whole."""


@pytest.fixture(params=["open", "sealed"])
def keys(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the arguments of a slave and of a master that make their sessions open or sealed."""
    return write_keys(tmp_path) if request.param == "sealed" else ((), ())


class Operated:
    """A master process whose operator follows a trace, and what it felt."""

    def __init__(
        self,
        start: Callable[..., Process],
        address: str,
        folder: Path,
        keys: tuple[str, ...],
        trace: dict[float, float],
    ) -> None:
        rows = "\n".join(f"{t_s},{position_m}" for t_s, position_m in trace.items())
        (folder / "trace.csv").write_text(f"time_s,position_m\n{rows}\n")
        self._record = folder / "master.csv"
        operator = ("--operator", f"trace:{folder / 'trace.csv'}", "--record", str(self._record))
        arguments = (*operator, "--duration", "60", "--rate", "500", "--json", *keys)
        self.process = start("master", "--connect", address, *arguments)
        self.process.wait_for("connected to")
        self._connected_s = time.monotonic()

    def wait(self, seconds: float) -> float:
        """Let it play for a while; return the seconds since it was connected."""
        time.sleep(seconds)
        return time.monotonic() - self._connected_s

    def end(self) -> dict[str, np.ndarray]:
        """End the process; return its recording, with the time in seconds since the first force."""
        assert self.process.end(signal.SIGINT) == 0, self.process.said()
        table = read_csv(self._record)
        table["t_s"] = (table["t_us"] - table["t_us"][np.argmax(table["held_n"] > 0.1)]) / 1e6
        return table


@pytest.fixture
def play(start, serve, paths, keys, tmp_path):
    """Return what starts a slave with a scene and a master with a trace; it returns both, and the path between."""

    def both(scene: str, trace: dict[float, float]) -> tuple[Process, OnPath, Operated]:
        (tmp_path / "scene.toml").write_text(scene)
        server, address = serve("--scene", str(tmp_path / "scene.toml"), "--json", *keys[0])
        path = paths(address)
        return server, path, Operated(start, path.address, tmp_path, keys[1], trace)

    return both


def newest(datagrams: object, kind: Kind) -> bytes:
    return next(data for data in reversed(list(datagrams)) if unpack(data).kind is kind)  # type: ignore[call-overload]


def ahead(data: bytes, leap: int) -> bytes:
    """Return a datagram as it would be with a later sequence number, if nothing proved it."""
    true = unpack(data)
    return pack(true.kind, true.session, (true.sequence + leap) % 2**32, true.body, true.version)


@pytest.mark.parametrize(("victim", "leap"), [("master", 50), ("slave", 2_999)])
def test_one_datagram_with_a_sequence_far_ahead_deafens_nobody(play, victim, leap):
    """N1: a master was deaf for good, and a slave for 33 s."""
    server, path, master = play(GEL, REST)
    master.wait(0.5)
    if victim == "master":
        path.inject_to_master(ahead(newest(path.to_master, Kind.FORCE), leap))
    else:
        path.inject_to_slave(ahead(newest(path.to_slave, Kind.POSITION), leap))
    master.wait(1.5)
    felt = master.end()
    last_n = felt["held_n"][felt["t_s"] > felt["t_s"][-1] - 0.5]
    assert last_n.max() > 0.9 * FORCE_N, master.process.said()
    assert server.end() == 0


def with_another_nonce(hello: bytes) -> bytes:
    """Return a HELLO as its sender would ask for another session."""
    true = unpack(hello)
    fields = msgpack.unpackb(true.body)
    body = msgpack.packb([fields[0] ^ 0x5555, *fields[1:]])
    return pack(Kind.HELLO, 0, true.sequence, body, true.version)


def test_a_hello_in_the_name_of_a_master_does_not_touch_its_session(play):
    """N2: the session was replaced, tissue was whole again, and the finger was pressed."""
    server, path, master = play(SKIN, PIERCE)
    at_s = master.wait(1.5)
    forged = with_another_nonce(path.to_slave[0])
    for _ in range(20):
        path.inject_to_slave(forged)
        master.wait(0.02)
    master.wait(0.5)
    felt = master.end()
    assert felt["held_n"].max() > 2.5
    assert felt["held_n"][felt["t_s"] > at_s].max() == 0.0
    assert server.end() == 0
    (session,) = server.report()["sessions"]
    assert session["breaches"] == 1


@pytest.mark.parametrize("what", ["another port", "2 s of silence"])
def test_pierced_tissue_stays_pierced_when_a_master_comes_back(play, keys, what):
    """N2: any reconnection gave a new scene."""
    server, path, master = play(SKIN, PIERCE)
    at_s = master.wait(1.5)
    if what != "another port":
        path.forward = path.feedback = drop
        master.wait(float(what.split()[0]))
        path.forward = path.feedback = pass_on
    path.rebind()
    sealed = bool(keys[0])
    if not sealed:  # an open session belongs to its address
        master.process.wait_for("connected to", count=2)
    master.wait(0.5)
    felt = master.end()
    assert felt["held_n"][felt["t_s"] > at_s].max() == 0.0
    assert felt["t_s"][-1] > at_s + 0.1
    again = master.process.report()["connections"] - 1
    # A sealed session roams; but a request from the time of silence may arrive before a position does.
    assert again == 1 if not sealed else again <= (what != "another port")
    assert server.end() == 0
    first, *others = server.report()["sessions"]
    assert first["breaches"] == 1
    assert [(each["breaches"], each["continues"]) for each in others] == [(1, first["session"])] * again
    assert [first, *others][-1]["steps"] > 100


@pytest.mark.parametrize("keys", ["sealed"], indirect=True)
def test_forces_that_answer_positions_of_long_ago_are_not_applied(play):
    """N3: 645 forces that were 3 s old were applied as fresh."""
    _, path, master = play(GEL, REST)
    at_s = master.wait(0.5)
    path.feedback = late(1.5)
    master.process.wait_for("link too slow|link stale")
    until_s = master.wait(2.5)
    path.feedback = pass_on
    master.process.wait_for("link recovered|connected to", count=2)
    master.wait(0.5)
    felt = master.end()
    slow = (felt["t_s"] > at_s + 0.9) & (felt["t_s"] < until_s - 0.2)
    assert slow.sum() > 100
    assert (felt["held_n"][slow] == 0.0).all()
    assert felt["held_n"][-1] > 0.9 * FORCE_N
    assert np.diff(felt["held_n"]).max() < 1.1, "the force rises, and is not there at once"


@pytest.mark.parametrize("keys", ["sealed"], indirect=True)
def test_of_a_slave_that_was_stopped_no_old_force_is_applied(play):
    """N3: forces up to 10 s old were applied, in fast motion."""
    server, _, master = play(GEL, {0.0: 0.0, 100.0: 1.0})  # 1 N more each second
    master.wait(0.5)
    server.process.send_signal(signal.SIGSTOP)
    master.wait(2.0)
    server.process.send_signal(signal.SIGCONT)
    master.process.wait_for("link recovered|connected to", count=2)
    master.wait(1.0)
    felt = master.end()
    report = master.process.report()
    # A force is applied while the position it answers is younger than a second, and 0.3 s later it is released.
    assert report["age_of_applied_force"]["max_us"] < 1_350_000
    assert felt["held_n"][-1] == pytest.approx(100.0 * felt["position_m"][-1], rel=0.15)
