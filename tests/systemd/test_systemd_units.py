"""The systemd units are valid, and the processes tell systemd what the units expect."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hapticnet.cli.settings import from_file
from hapticnet.cli.verbs import SERVICES
from tests.cli.test_cli_options import VERBS
from tests.integration.conftest import start  # noqa: F401 - a fixture

UNITS = Path(__file__).parents[2] / "systemd"


@pytest.mark.parametrize("unit", ["hapticnet-slave", "hapticnet-slave@", "hapticnet-master"])
def test_systemd_accepts_the_unit(tool_is_missing, tmp_path, unit):
    if shutil.which("systemd-analyze") is None:
        tool_is_missing("systemd-analyze is not installed")
    text = (UNITS / f"{unit}.service").read_text()
    (tmp_path / f"{unit}.service").write_text(text.replace("/opt/hapticnet/bin/hapticnet", sys.executable))
    file = tmp_path / f"{unit}{'east' if unit.endswith('@') else ''}.service"
    done = subprocess.run(["systemd-analyze", "verify", file], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("unit", "most"), [("hapticnet-slave", 2.0), ("hapticnet-master", 2.2)])
def test_a_service_may_do_little_besides_its_work(tool_is_missing, unit, most):
    if shutil.which("systemd-analyze") is None:
        tool_is_missing("systemd-analyze is not installed")
    threshold = f"--threshold={most * 10:g}"
    command = ["systemd-analyze", "security", "--offline=true", threshold, "--no-pager", UNITS / f"{unit}.service"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout.splitlines()[-1]


def test_every_call_of_a_service_is_permitted(tool_is_missing, tmp_path, start):  # noqa: F811
    """The filter of system calls must not end a service that does its work, with helper processes and SCHED_FIFO."""
    for tool in "systemd-analyze", "strace":
        if shutil.which(tool) is None:
            tool_is_missing(f"{tool} is not installed")
    traced = ("strace", "-f", "-qq", "-o")
    watched = ("--metrics", "127.0.0.1:0")
    slave = start("slave", "--listen", "127.0.0.1:0", *watched, prefix=(*traced, str(tmp_path / "slave")))
    address = slave.wait_for(r"listening on ([\d.]+:\d+)").group(1)
    master = start("master", "--connect", address, *watched, prefix=(*traced, str(tmp_path / "master")))
    master.wait_for("connected to")
    for process in master, slave:
        (traced_id,) = Path(f"/proc/{process.process.pid}/task/{process.process.pid}/children").read_text().split()[:1]
        os.kill(int(traced_id), signal.SIGTERM)
        process.process.wait(30)
    shown = subprocess.run(
        ["systemd-analyze", "syscall-filter", "--no-pager"], capture_output=True, text=True, check=True
    )
    groups, name = {}, ""
    for line in shown.stdout.splitlines():
        word = line.split("#")[0].strip()
        if line.startswith("@"):
            name = word
            groups[name] = set()
        elif word and name:
            groups[name].add(word)

    def calls(group):
        return {call for each in groups[group] for call in (calls(each) if each.startswith("@") else {each})}

    permitted = calls("@system-service") - calls("@privileged") | calls("@default")
    made = {
        found[1]
        for side in ("slave", "master")
        for line in (tmp_path / side).read_text().splitlines()
        if (found := re.match(r"\d+ +(?:<\.\.\. )?([a-z0-9_]+)[( ]", line)) and found[1] not in ("resumed",)
    }
    assert "sched_setscheduler" in made
    assert made <= permitted, made - permitted


def test_one_of_several_slaves_differs_from_a_single_one_in_its_name_and_its_files_only():
    one, several = ((UNITS / f"hapticnet-slave{at}.service").read_text().splitlines() for at in ("", "@"))
    changed = {line.partition("=")[0] for line in set(several) - set(one) if not line.startswith("#")}
    assert changed == {"Description", "ExecStart", "WorkingDirectory", "StateDirectory"}


@pytest.mark.parametrize("file", [UNITS / "hapticnet.toml", UNITS.parent / "docker" / "master.toml"], ids=str)
def test_the_configuration_of_the_services_sets_options_that_exist(file):
    assert from_file(file, {name: VERBS[(name,)] for name in SERVICES})["master"]["device"].startswith("serial:")


def test_a_slave_tells_systemd_that_it_is_ready_alive_and_stopping(start, tmp_path):  # noqa: F811
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(20.0)
        prefix = ("env", f"NOTIFY_SOCKET={tmp_path / 'notify'}")
        slave = start("slave", "--listen", "127.0.0.1:0", "--no-real-time", prefix=prefix)
        assert manager.recv(1000) == b"READY=1"
        watchdog, _, status = manager.recv(1000).partition(b"\n")
        assert watchdog == b"WATCHDOG=1"
        assert status == b"STATUS=0 masters, 0 steps, 0 packets sent"
        assert slave.end(signal.SIGTERM) == 0
        while (message := manager.recv(1000)).startswith(b"WATCHDOG=1"):
            pass
        assert message == b"STOPPING=1"
