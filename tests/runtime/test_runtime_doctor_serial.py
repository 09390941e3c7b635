"""What the doctor says of serial ports, on folders that stand for /dev, /sys and /proc."""

import grp
import os
import pwd

import pytest

from hapticnet.runtime.doctor.finding import Machine, Verdict
from hapticnet.runtime.doctor.serial_ports import examine_serial, judge_ports
from hapticnet.runtime.serial_port import FoundPort, parse_serial

AUTO = parse_serial("serial:auto")


def port(number=0, likely="FTDI chip"):
    name = f"/dev/ttyUSB{number}"
    return FoundPort(
        path=f"/dev/serial/by-id/nano-{number}", name=name, description="", serial_number=None, likely=likely
    )


@pytest.fixture
def root(tmp_path):
    (tmp_path / "dev").mkdir()
    for number in range(2):
        (tmp_path / f"dev/ttyUSB{number}").touch(mode=0o660)
        os.chmod(tmp_path / f"dev/ttyUSB{number}", 0o660)
    return tmp_path


def machine(root, *, accessible=True, **environ):
    return Machine(root=root, environ=environ, access=lambda *_: accessible)


def findings(*arguments):
    return {finding.id.partition(".")[2]: finding for finding in judge_ports(*arguments)}


def command(finding):
    return finding.to_do[0].command


def test_no_port_is_a_problem_only_for_who_asks_for_one(root):
    assert [each.verdict for each in judge_ports(machine(root), [])] == [Verdict.ABSENT]
    assert [each.verdict for each in judge_ports(machine(root), [], AUTO)] == [Verdict.PROBLEM]
    (finding,) = judge_ports(machine(root), [port(likely=None)])
    assert (finding.verdict, finding.value) == (Verdict.ABSENT, "no serial port looks like an Arduino Nano")


def test_a_port_that_may_be_used_is_fine(root):
    found = findings(machine(root), [port()])
    assert found["device"].value == "/dev/serial/by-id/nano-0 (FTDI chip)"
    assert {each.verdict for each in found.values()} == {Verdict.OK}


def test_two_likely_ports_must_be_told_apart(root):
    found = findings(machine(root), [port(0), port(1)])
    assert found["device"].verdict is Verdict.WARNING
    assert command(found["device"]) == "hapticnet master --device serial:/dev/serial/by-id/nano-0 …"
    assert findings(machine(root), [port(0), port(1)], AUTO)["device"].verdict is Verdict.PROBLEM
    assert {"access:/dev/ttyUSB0", "access:/dev/ttyUSB1"} < set(found)


def test_a_named_port_that_is_missing_is_a_problem(root):
    found = findings(machine(root), [port()], parse_serial("serial:/dev/ttyACM9"))
    assert found["access:/dev/ttyACM9"].verdict is Verdict.PROBLEM
    assert found["access:/dev/ttyACM9"].value == "No such file or directory"
    assert "access:/dev/ttyUSB0" not in found


def test_a_named_port_is_found_by_its_link_too(root):
    assert "access:/dev/ttyUSB1" in findings(
        machine(root), [port(0), port(1)], parse_serial("serial:/dev/serial/by-id/nano-1")
    )


def group_of(root, gid):
    """Give the port to a group, which needs root; else return the group it has."""
    if os.geteuid() == 0:
        os.chown(root / "dev/ttyUSB0", 0, gid)
        return grp.getgrgid(gid)
    return grp.getgrgid((root / "dev/ttyUSB0").stat().st_gid)


def test_denied_permission_names_the_group_to_join(root):
    group = group_of(root, grp.getgrnam("dialout").gr_gid)
    denied = findings(machine(root, accessible=False), [port()])["access:/dev/ttyUSB0"]
    assert denied.verdict is Verdict.PROBLEM
    assert command(denied) == f"sudo usermod -aG {group.gr_name} $USER"
    account = pwd.getpwuid(os.getuid()).pw_name
    (root / "etc").mkdir()
    (root / "etc/group").write_text(f"other:x:1:\n{group.gr_name}:x:20:someone,{account}\n")
    joined = findings(machine(root, accessible=False), [port()])["access:/dev/ttyUSB0"]
    assert command(joined) == f"newgrp {group.gr_name}"


def test_a_port_without_a_group_is_given_one(root):
    os.chmod(root / "dev/ttyUSB0", 0o600)
    denied = findings(machine(root, accessible=False), [port()])["access:/dev/ttyUSB0"]
    assert command(denied) == "sudo chgrp dialout /dev/ttyUSB0 && sudo chmod 660 /dev/ttyUSB0"


def test_a_container_must_be_given_the_port(root):
    denied = findings(machine(root, accessible=False, container="docker"), [port()])["access:/dev/ttyUSB0"]
    assert command(denied).startswith("docker run --device /dev/ttyUSB0 --group-add ")


@pytest.mark.parametrize(("wait", "verdict"), [("16\n", Verdict.WARNING), ("1\n", Verdict.OK)])
def test_the_latency_timer_should_be_short(root, wait, verdict):
    setting = root / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
    setting.parent.mkdir(parents=True)
    setting.write_text(wait)
    finding = findings(machine(root), [port()])["latency:/dev/ttyUSB0"]
    assert (finding.verdict, finding.value) == (verdict, f"{wait.strip()} ms")
    if verdict is Verdict.WARNING:
        assert command(finding) == "echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
        assert setting.read_text() == wait


def process(root, number, name):
    (root / f"proc/{number}/fd").mkdir(parents=True)
    (root / f"proc/{number}/comm").write_text(f"{name}\n")


def test_a_program_that_uses_the_port_is_named(root):
    process(root, 4711, "screen")
    (root / "proc/4711/fd/3").symlink_to(root / "dev/ttyUSB0")
    finding = findings(machine(root), [port()])["access:/dev/ttyUSB0"]
    assert (finding.verdict, finding.value) == (Verdict.WARNING, "in use by screen (process 4711)")


def test_programs_that_take_ports_are_named(root):
    process(root, 1, "brltty")
    process(root, 2, "ModemManager")
    found = findings(machine(root), [])
    assert command(found["grabber:brltty"]) == "sudo apt-get remove brltty"
    assert found["grabber:ModemManager"].verdict is Verdict.WARNING


def test_no_port_is_opened(root, monkeypatch):
    opened = []
    monkeypatch.setattr("serial.Serial", lambda *arguments, **_: opened.append(arguments))
    (root / "dev/ttyUSB0").unlink()
    os.mkfifo(root / "dev/ttyUSB0")  # whoever opens it would wait
    assert findings(machine(root), [port()])["access:/dev/ttyUSB0"].verdict is Verdict.OK
    assert examine_serial(Machine())
    assert not opened
