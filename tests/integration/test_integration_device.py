"""A device on a serial line as processes: unplugged, plugged in again, or not there at all. No speed is asserted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapticnet.runtime.nano import BUILD_VARIABLE

PATIENCE_S = 60.0

# The last that was said of the device: a busy machine may stall the simulated one for long enough to be missed too.
READY = r"device ready(?!(?s:.*)device lost)"
LOST = r"device lost(?!(?s:.*)device ready)"


@pytest.fixture
def simulator(simavr_files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes started from here find the simulator."""
    monkeypatch.setenv(BUILD_VARIABLE, str(simavr_files[0].parent))


@pytest.fixture
def plug_in(simulator: None, start: Callable[..., Any], tmp_path: Path) -> Callable[[], tuple[Any, str]]:  # noqa: ARG001
    """Return what puts a device on a port, always the same: the process that is it, and how it is written."""
    link = tmp_path / "ttyUSB0"

    def plug() -> tuple[Any, str]:
        device = start("device", "sim")
        link.unlink(missing_ok=True)  # as udev does; the number of the pseudo-terminal goes to another program
        link.symlink_to(device.wait_for(r"listening on (/dev/pts/\d+)").group(1))
        return device, f"serial:{link}"

    return plug


def test_an_insertion_is_felt_through_a_serial_line_and_the_report_tells_of_it(start, slave, plug_in):
    _, address = slave
    device, port = plug_in()
    master = start("master", "--connect", address, "--device", port, "--insertions", "1", "--json")
    assert master.process.wait(PATIENCE_S) == 0, master.said()
    assert "device ready: device on a serial line, firmware 0.1.0" in master.said()
    assert "not calibrated" in master.said()
    line = master.report()["device"]["line"]
    assert line["firmware"] == "0.1.0"
    assert line["readings"] > 100
    assert line["setpoints_sent"] > 20
    assert line["resets_seen"] == 0
    assert device.end() == 0


def test_an_unplugged_device_costs_no_session_and_is_taken_up_again(start, slave, plug_in):
    server, address = slave
    device, port = plug_in()
    master = start("master", "--connect", address, "--device", port, "--duration", "120", "--json")
    master.wait_for("connected to")
    for _ in range(2):
        master.wait_for(READY)
        device.process.kill()
        device.process.wait()
        master.wait_for(LOST)
        device, _ = plug_in()
    master.wait_for(READY)
    assert "device lost (unplugged); the session continues" in master.said()
    assert master.end() == 0
    account = master.report()
    assert account["connections"] == 1
    assert account["device"]["times_lost"] >= 2
    assert server.end() == 0
    assert len(server.report()["sessions"]) == 1


def test_a_master_brings_its_own_simulated_nano_and_ends_it(start, slave, simulator):  # noqa: ARG001
    _, address = slave
    master = start("master", "--connect", address, "--device", "simavr:0.6", "--duration", "3", "--json")
    assert master.process.wait(PATIENCE_S) == 0, master.said()
    account = master.report()
    assert account["end_reason"] == "done"
    assert account["device"]["line"]["readings"] > 100


@pytest.mark.parametrize(
    ("arguments", "complaint", "code"),
    [
        (("master", "--quiet", "--device", "serial:/dev/no-such-port"), "is missing; is the device plugged in?", 4),
        (("master", "--quiet", "--device", "serial:nano"), "an absolute path", 2),
    ],
)
def test_a_wrong_port_is_one_line_and_an_exit_code(start, arguments, complaint, code):
    process = start(*arguments)
    assert process.process.wait(PATIENCE_S) == code
    (line,) = process.said().splitlines()
    assert complaint in line
