"""Serial ports: who may use them, who does, and how long an adapter waits. No port is opened: that resets a Nano."""

import contextlib
import grp
import os
import pwd
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hapticnet.runtime.doctor.finding import Finding, Machine, Step, Verdict
from hapticnet.runtime.serial_port import FoundPort, SerialSpec, find_ports

SHORT_WAIT_MS: Final = 1
"""What an FTDI chip should wait for more bytes [ms]; its default is 16."""

GRABBERS: Final = {
    "brltty": ("It takes USB adapters for Braille displays, and their ports disappear.", "sudo apt-get remove brltty"),
    "ModemManager": (
        "It looks for modems on serial ports, and writes to them.",
        "sudo systemctl disable --now ModemManager",
    ),
}
"""Programs that take serial ports, what they do, and what stops them."""

FIND: Final = Step("Plug it in, and list the ports:", "hapticnet device find")


def examine_serial(machine: Machine, wanted: SerialSpec | None = None) -> list[Finding]:
    """Return the findings about serial ports; `wanted` is the one that will be used, if that is known."""
    return judge_ports(machine, find_ports(), wanted)


def judge_ports(machine: Machine, ports: Sequence[FoundPort], wanted: SerialSpec | None = None) -> list[Finding]:
    """Judge the wanted port or those that may be the device, and programs that take ports."""
    findings = [_judge_choice(machine, ports, wanted)]
    for port in _candidates(ports, wanted):
        findings += [_judge_access(machine, port), *_judge_wait(machine, port)]
    running = {machine.text(path) for path in machine.glob("/proc/[0-9]*/comm")}
    return [*findings, *(_judge_grabber(name) for name in GRABBERS if name in running)]


def _candidates(ports: Sequence[FoundPort], wanted: SerialSpec | None) -> list[FoundPort]:
    if wanted is None or wanted.path is None:
        return [port for port in ports if port.likely]
    named = [port for port in ports if wanted.path in (port.path, port.name)]
    # A port that is not listed, such as a pseudo-terminal, may exist all the same.
    return named or [FoundPort(path=wanted.path, name=wanted.path, description="", serial_number=None, likely=None)]


def _judge_choice(machine: Machine, ports: Sequence[FoundPort], wanted: SerialSpec | None) -> Finding:
    likely = [port for port in ports if port.likely]
    named = "serial.device", "Device"
    if wanted is not None and wanted.path is not None:
        return Finding(*named, Verdict.OK, f"{wanted}, as asked for")
    if len(likely) == 1:
        return Finding(*named, Verdict.OK, f"{likely[0].path} ({likely[0].likely})")
    if likely:
        verdict = Verdict.WARNING if wanted is None else Verdict.PROBLEM
        steps = tuple(Step("Name one:", f"hapticnet master --device serial:{port.path} …") for port in likely)
        return Finding(*named, verdict, f"{len(likely)} ports may be the device", "serial:auto cannot choose.", steps)
    verdict = Verdict.ABSENT if wanted is None else Verdict.PROBLEM
    other = Step("To do without one: --device sim")
    if machine.container:
        other = Step("Pass it on to the container:", "docker run --device /dev/ttyUSB0 …")
    value = "no serial port looks like an Arduino Nano" if ports else "no serial port"
    return Finding(*named, verdict, value, "", (FIND, other))


def _judge_access(machine: Machine, port: FoundPort) -> Finding:
    file, named = machine.path(port.name), (f"serial.access:{port.name}", f"Port {Path(port.name).name}")
    try:
        status = file.stat()
    except OSError as error:
        return Finding(*named, Verdict.PROBLEM, error.strerror or str(error), "", (FIND,))
    if not machine.access(file, os.R_OK | os.W_OK):
        value = f"permission denied; the port belongs to the group {_group(status.st_gid)}"
        step = _how_to_permit(machine, port, status)
        return Finding(*named, Verdict.PROBLEM, value, "hapticnet cannot reach the device.", (step,))
    user = _user_of(machine, port.name)
    if user is None:
        return Finding(*named, Verdict.OK, "may be read and written; no other program is seen to use it")
    step = Step("End that program before a session.")
    return Finding(*named, Verdict.WARNING, f"in use by {user}", "Only one program can have the device.", (step,))


def _how_to_permit(machine: Machine, port: FoundPort, status: os.stat_result) -> Step:
    group = _group(status.st_gid)
    if machine.container:
        command = f"docker run --device {port.name} --group-add {status.st_gid} …"
        return Step("Start the container with its device and group:", command)
    if not status.st_mode & stat.S_IWGRP or status.st_gid == 0:
        command = f"sudo chgrp dialout {port.name} && sudo chmod 660 {port.name}"
        return Step("Give the port to the group dialout until it is replugged:", command)
    if _is_member(machine, group):
        return Step(f"You joined the group {group} after this login. Log out and in, or run:", f"newgrp {group}")
    return Step(f"Join the group {group}, then log out and in again:", f"sudo usermod -aG {group} $USER")


def _judge_wait(machine: Machine, port: FoundPort) -> list[Finding]:
    """Judge how long an FTDI adapter holds bytes back; other adapters have no such setting."""
    name = Path(port.name).name
    setting = f"/sys/bus/usb-serial/devices/{name}/latency_timer"
    wait_ms = machine.number(setting)
    if wait_ms is None:
        return []
    named, value = (f"serial.latency:{port.name}", "Latency timer"), f"{wait_ms} ms"
    if wait_ms <= SHORT_WAIT_MS:
        return [Finding(*named, Verdict.OK, value)]
    rule = f'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{{latency_timer}}="{SHORT_WAIT_MS}"'
    meaning = (
        f"The adapter may hold the force sensor's readings back that long. hapticnet asks the driver for"
        f" {SHORT_WAIT_MS} ms when it opens the port; a driver may ignore it."
    )
    steps = (
        Step("Set it until the adapter is replugged:", f"echo {SHORT_WAIT_MS} | sudo tee {setting}"),
        Step("And for good:", f"echo '{rule}' | sudo tee /etc/udev/rules.d/90-hapticnet.rules"),
    )
    return [Finding(*named, Verdict.WARNING, value, meaning, steps, f"good: {SHORT_WAIT_MS} ms")]


def _judge_grabber(name: str) -> Finding:
    deed, command = GRABBERS[name]
    step = Step("If nobody needs it here:", command)
    return Finding(f"serial.grabber:{name}", name, Verdict.WARNING, "is running", deed, (step,))


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _is_member(machine: Machine, group: str) -> bool:
    """Tell whether this account is listed in a group, even if only since this login."""
    try:
        account = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return False
    entries = (line.split(":") for line in (machine.text("/etc/group") or "").splitlines())
    return any(entry[0] == group and account in entry[-1].split(",") for entry in entries)


def _user_of(machine: Machine, device: str) -> str | None:
    """Return the program that has a device open, as far as this account may see that."""
    target = str(machine.path(device))
    for folder in machine.glob("/proc/[0-9]*/fd"):
        with contextlib.suppress(OSError):  # another account's, or ended meanwhile
            for link in machine.path(folder).iterdir():
                if os.readlink(link) == target:
                    number = folder.split("/")[2]
                    return f"{machine.text(f'/proc/{number}/comm') or 'a program'} (process {number})"
    return None
