"""Sealed sessions of real processes on loopback: who gets in, who is told what, and a list that changes."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.test_cli_errors import REFUSED, THE_ERROR, UNAVAILABLE
from tests.ready import ROOT, hapticnet

FAST = ("--device", "none")


def make_key(path, name):
    """Make a key file; return the public key and the master's table for the slave's list."""
    done = hapticnet("key", "new", path, "--name", name)
    assert done.returncode == 0
    return done.stdout.strip(), done.stderr[done.stderr.index("[[master]]") :]


class Keys:
    """The files of a slave and two masters; the first master is in the list."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.slave, _ = make_key(folder / "slave.toml", "slave")
        self.first, self.first_table = make_key(folder / "first.toml", "first")
        self.second, self.second_table = make_key(folder / "second.toml", "second")
        self.list = folder / "masters.toml"
        self.list.write_text(self.first_table)

    def of_slave(self) -> tuple[str, ...]:
        return "--key", str(self.folder / "slave.toml"), "--masters", str(self.list)

    def of(self, name: str) -> tuple[str, ...]:
        return "--key", str(self.folder / f"{name}.toml"), "--peer-key", self.slave


@pytest.fixture
def keys(tmp_path):
    return Keys(tmp_path)


@pytest.fixture
def sealed(serve, keys) -> Callable[..., tuple]:
    """Return what starts a slave with the keys, and returns it with its address."""

    def start_slave(*more: str):
        return serve("--json", *keys.of_slave(), *more)

    return start_slave


def test_a_listed_master_plays_an_insertion_in_its_own_scene(start, sealed, keys):
    keys.list.write_text(keys.first_table + 'scene = "paper:3"\nfastest_rate_hz = 500\n')
    server, address = sealed("--scene", "paper:1")
    assert f"--peer-key {keys.slave}" in server.said()
    master = start("master", "--connect", address, *keys.of("first"), "--insertions", "1", "--json", *FAST)
    assert master.process.wait(30) == 0, master.said()
    assert "scene paper:3, 500 Hz granted" in master.said()
    assert master.report()["sealed"]
    assert server.end() == 0
    assert "'first' ('master') joined from" in server.said()
    (session,) = server.report()["sessions"]
    assert (session["sealed"], session["listed"], session["scene"]) == (True, "first", "paper:3")
    assert session["breaches"] == 3
    assert session["exceed_jnd_fraction"] == 0.0
    for private in ("slave.toml", "first.toml"):
        secret = (keys.folder / private).read_text().split('"')[1]
        assert secret not in server.said() + master.said() + server.output.read_text() + master.output.read_text()


def test_a_master_that_is_not_listed_is_refused_and_both_ends_say_which_key_to_add(start, sealed, keys):
    server, address = sealed()
    master = start("master", "--connect", address, *keys.of("second"), *FAST)
    assert master.process.wait(20) == REFUSED
    last = THE_ERROR.sub("", master.said().splitlines()[-1])
    assert last.startswith(f"{address} refused the session: ")
    assert f'public = "{keys.second}"' in last
    server.wait_for(f"public key {keys.second.replace('+', '[+]')} was refused")
    without_keys = start("master", "--connect", address, *FAST)
    assert without_keys.process.wait(20) == REFUSED
    assert "--peer-key" in without_keys.said().splitlines()[-1]


def test_a_slave_that_serves_both_serves_an_open_master_too(start, sealed, keys):
    server, address = sealed("--insecure")
    masters = [start("master", "--connect", address, *more, *FAST) for more in ((), keys.of("first"))]
    for master in masters:
        master.wait_for("connected to")
    server.wait_for("joined from", count=2)
    assert server.end() == 0
    assert sorted(session["sealed"] for session in server.report()["sessions"]) == [False, True]


def test_a_master_with_keys_never_falls_back_to_an_open_session(start, slave, keys):
    _, address = slave
    master = start("master", "--connect", address, *keys.of("first"), "--connect-timeout", "2", *FAST)
    master.wait_for("serves open sessions only")
    assert master.process.wait(20) == UNAVAILABLE
    assert "connected to" not in master.said()
    assert "serves open sessions only" in master.said().splitlines()[-1]


def test_a_wrong_peer_key_is_noticed_at_both_ends(start, sealed, keys):
    server, address = sealed()
    wrong = (*keys.of("first")[:3], keys.second)
    master = start("master", "--connect", address, *wrong, "--connect-timeout", "1", *FAST)
    assert master.process.wait(20) == UNAVAILABLE
    assert "is --peer-key what 'hapticnet key public' prints" in master.said().splitlines()[-1]
    server.wait_for(f"another slave's key; this slave's is {keys.slave.replace('+', '[+]')}")


def test_a_psk_must_be_the_same_at_both_ends(start, sealed, keys):
    psk = 'psk = "AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8="\n'
    with (keys.folder / "first.toml").open("a") as file:
        file.write(psk)
    server, address = sealed()
    master = start("master", "--connect", address, *keys.of("first"), "--connect-timeout", "2", *FAST)
    assert master.process.wait(20) == UNAVAILABLE
    assert "the same psk" in master.said().splitlines()[-1]
    keys.list.write_text(keys.first_table + psk)
    keys.list.chmod(0o600)
    server.process.send_signal(signal.SIGHUP)
    server.wait_for(r"again: 1 master\b")
    master = start("master", "--connect", address, *keys.of("first"), *FAST)
    master.wait_for("connected to")


def test_a_list_that_is_read_again_admits_and_ends_masters(start, sealed, keys):
    server, address = sealed()
    first = start("master", "--connect", address, *keys.of("first"), "--duration", "60", *FAST)
    first.wait_for("connected to")
    server.wait_for("'first' .* joined")
    keys.list.write_text("nonsense")
    server.process.send_signal(signal.SIGHUP)
    server.wait_for("the list of masters is unchanged: .*not a TOML file")
    keys.list.write_text(keys.second_table)
    server.process.send_signal(signal.SIGHUP)
    server.wait_for("'first' .* left: the slave closed: the key is no longer served")
    first.wait_for("session lost")
    first.wait_for("refuses a new session .*asking again")
    second = start("master", "--connect", address, *keys.of("second"), *FAST)
    second.wait_for("connected to")
    keys.list.write_text(keys.second_table + keys.first_table)
    server.process.send_signal(signal.SIGHUP)
    first.wait_for("connected to", count=2)
    server.wait_for("'first' .* joined", count=2)
    assert server.end() == 0


def test_a_slave_whose_terminal_is_closed_ends_with_its_report(keys, tmp_path):
    terminal, its_end = os.openpty()
    report = tmp_path / "slave.json"
    arguments = ["slave", "--listen", "127.0.0.1:0", *keys.of_slave()]
    process = subprocess.Popen(
        [sys.executable, "-m", "hapticnet", *arguments, "--report", report, "--no-real-time"],
        cwd=ROOT,
        stdin=its_end,
        stdout=subprocess.DEVNULL,
        stderr=its_end,
    )
    os.close(its_end)
    try:
        said = b""
        while b"listening on" not in said:
            said += os.read(terminal, 4096)
        os.close(terminal)
        process.send_signal(signal.SIGHUP)
        assert process.wait(20) == 0
    finally:
        process.kill()
    assert json.loads(report.read_text())["sessions"] == []


def test_hangup_of_a_slave_without_a_list_changes_nothing(start, slave):
    server, address = slave
    server.process.send_signal(signal.SIGHUP)
    server.wait_for("no list of masters")
    start("master", "--connect", address, *FAST).wait_for("connected to")


@pytest.fixture
def insertion(start, sealed, keys) -> Callable[..., tuple[dict, dict]]:
    """Return what plays an insertion through a link; it returns the session of the slave and the master's report."""

    def play(link: str, *options: str) -> tuple[dict, dict]:
        server, address = sealed("--scene", "paper:1")
        options = (*options, "--insertions", "1", "--json", "--channel-out", link, "--channel-in", link)
        master = start("master", "--connect", address, *keys.of("first"), *options, *FAST)
        assert master.process.wait(30) == 0, master.said()
        assert server.end() == 0
        (session,) = server.report()["sessions"]
        assert session["breaches"] == 3
        return session, master.report()

    return play


def test_the_contact_ahead_is_announced_over_a_real_network(insertion):
    session, report = insertion("delay=20ms,loss=2%", "--announced")
    account = session["announced"]
    assert account["models"] >= 1
    assert account["unusable"] == 0
    assert account["on_model"] > 0.5 * session["steps"]
    assert report["ticks_on_model"] > 0.5 * report["ticks"]
    assert session["sent"]["by_kind"]["force"] < 0.1 * session["steps"]


def test_positions_are_sent_when_they_matter_over_a_real_network(insertion):
    session, report = insertion("delay=10ms,loss=1%", "--positions", "line", "--codec", "adaptive-predictive")
    positions = report["positions"]
    assert session["between"] > 0.5 * positions["ticks"]
    assert positions["sent"] < 0.25 * positions["ticks"]
    assert report["connections"] == 1


FIPS_ONLY = """openssl_conf = init
[init]
alg_section = algorithms
[algorithms]
default_properties = fips=yes
"""


def test_where_openssl_has_not_the_algorithms_sealed_sessions_are_refused_and_open_ones_work(
    start, serve, keys, tmp_path
):
    """As in FIPS mode; this OpenSSL has no FIPS provider at all, so it is left with no algorithm."""
    (tmp_path / "openssl.cnf").write_text(FIPS_ONLY)
    without = ("env", f"OPENSSL_CONF={tmp_path / 'openssl.cnf'}")
    commands = (
        ("slave", "--listen", "127.0.0.1:0", *keys.of_slave()),
        ("master", "--connect", "127.0.0.1:9", *keys.of("first"), *FAST),
        ("key", "new", str(tmp_path / "new.toml")),
        ("key", "public", str(keys.folder / "slave.toml")),
    )
    started = [start(*arguments, prefix=without) for arguments in commands]
    _, address = serve(prefix=without)
    master = start("master", "--connect", address, "--duration", "0.2", *FAST, prefix=without)
    assert master.process.wait(20) == 0, master.said()
    for refused in started:
        assert refused.process.wait(20) == UNAVAILABLE
        assert "need X25519 and ChaCha20-Poly1305, and OpenSSL lacks one of them, as in FIPS mode" in refused.said()
        assert "Traceback" not in refused.said()
    assert not (tmp_path / "new.toml").exists()
