"""The compiled firmware on a simulated ATmega328P, in lockstep with its caller.

The simulator is a separate program (firmware/sim, with its own licence), connected by pipes. It reads no clock: the
same calls give the same results, and the caller paces it to real time if needed.

Simulator and caller take turns, so a second core only adds wake-up time: on one core (``os.sched_setaffinity``), steps
of 1 ms run twice as fast.
"""

import contextlib
import os
import struct
import subprocess
from pathlib import Path
from typing import Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError, UnavailableError

CYCLES_PER_US: Final = 16
"""Clock cycles per µs of the Nano: 16 MHz."""

LONGEST_STEP_US: Final = 10_000_000
"""Longest step [µs]: the firmware's output during a step must fit the harness's buffers."""

MOST_BYTES: Final = 0xFFFF
"""Largest number of bytes passed in one step."""

BUILD_VARIABLE: Final = "HAPTICNET_FIRMWARE"
"""Environment variable with the folder of simulator and firmware; default: the folder in the checkout."""

_REQUEST: Final = struct.Struct("<IHH")
_REPLY: Final = struct.Struct("<QIIII")
_EDGE: Final = struct.Struct("<QII")


def simavr_build() -> tuple[Path, Path]:
    """Return the simulator and the firmware for the default baud rate, as built by ``make simulator``.

    Raises
    ------
    UnavailableError
        If one of them is missing.
    """
    named = os.environ.get(BUILD_VARIABLE)
    firmware = Path(__file__).parents[2] / "firmware"
    if not named and not (firmware / "Makefile").is_file():
        raise UnavailableError(
            "the simulator is not in an installed package: run `make simulator` in a checkout of hapticnet, then"
            f" export {BUILD_VARIABLE}=CHECKOUT/firmware/build"
        )
    folder = Path(named) if named else firmware / "build"
    paths = folder / "harness", folder / "firmware-500000.elf"
    for path in paths:
        if not path.is_file():
            where = f"; {BUILD_VARIABLE} must name the checkout's firmware/build" if named else ""
            raise UnavailableError(f"{path} is missing: `make simulator` in the checkout of hapticnet builds it{where}")
    return paths


class Edge(NamedTuple):
    """A change of a servo pin: time [clock cycles since power-on], servo (0 to 2) and new level."""

    cycle: int
    servo: int
    level: int


class Step(NamedTuple):
    """Result of a step.

    Attributes
    ----------
    cycle
        Time at the end [clock cycles since power-on].
    sent
        Bytes sent by the firmware.
    edges
        Changes of the servo pins, oldest first.
    resets
        Number of resets of the controller since power-on.
    latency_cycles
        Longest time that any interrupt was pending so far [clock cycles].
    """

    cycle: int
    sent: bytes
    edges: list[Edge]
    resets: int
    latency_cycles: int


class Simavr:
    """A running simulation.

    Parameters
    ----------
    harness
        The simulator, built by ``make -C firmware sim``.
    firmware
        The ELF file to run.

    Raises
    ------
    UnavailableError
        If either file is missing or the simulator does not start.
    """

    def __init__(self, harness: Path, firmware: Path) -> None:
        for path, target in ((harness, "sim"), (firmware, "firmware")):
            if not path.is_file():
                raise UnavailableError(f"{path} is missing; build it: make -C firmware {target}")
        command = [str(harness), str(firmware)]
        try:
            # In its own session, so that Ctrl-C does not end it before its caller.
            self._process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
        except OSError as error:
            raise UnavailableError(f"cannot start {harness}: {error}") from error

    def advance(self, duration_us: int, *, millivolts: float = 0.0, data: bytes = b"") -> Step:
        """Advance time.

        Parameters
        ----------
        duration_us
            Duration [µs], up to ten seconds; it may be exceeded by a few clock cycles.
        millivolts
            Voltage [mV] at the force sensor's pin during the step, clamped to the 5 V supply.
        data
            Bytes for the firmware, up to `MOST_BYTES`; they arrive one after the other at the speed of the line.

        Raises
        ------
        SettingsError
            If the duration is out of range or there are too many bytes.
        UnavailableError
            If the simulator has ended.
        """
        check_parameter("step", duration_us, 0, LONGEST_STEP_US, "µs")
        if len(data) > MOST_BYTES:
            raise SettingsError(f"{len(data)} bytes for the UART in one step; the limit is {MOST_BYTES}")
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None  # noqa: S101
        assert stdout is not None  # noqa: S101
        level = round(10.0 * min(max(millivolts, 0.0), 5000.0))
        try:
            stdin.write(_REQUEST.pack(duration_us * CYCLES_PER_US, level, len(data)) + data)
            stdin.flush()
            cycle, n_sent, n_edges, resets, latency_cycles = _REPLY.unpack(stdout.read(_REPLY.size))
            sent = stdout.read(n_sent)
            edges = [Edge(*fields) for fields in _EDGE.iter_unpack(stdout.read(n_edges * _EDGE.size))]
        except (OSError, struct.error) as error:
            raise UnavailableError(f"the simulator ended with code {self._process.wait()}") from error
        return Step(cycle, sent, edges, resets, latency_cycles)

    def close(self) -> None:
        """End the simulation."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # unread input is lost
                    pipe.close()
        self._process.wait()
