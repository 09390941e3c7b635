"""The compiled firmware in a simulated ATmega328P, in lockstep with whoever advances it.

The simulator is a program of its own (firmware/sim, under its own licence), spoken to over pipes. It reads no clock:
the same calls give the same answers, and pacing to real time is the caller's.

The two take turns, so a second core only adds the time it takes to wake it: on one core (``os.sched_setaffinity``)
steps of 1 ms run twice as fast.
"""

import contextlib
import os
import struct
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple, Self

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError, UnavailableError

CYCLES_PER_US: Final = 16
"""The Nano's clock: 16 MHz."""

LONGEST_STEP_US: Final = 10_000_000
"""Longest single step [µs]: what the firmware sends meanwhile must fit the harness's buffers."""

MOST_BYTES: Final = 0xFFFF
"""Most bytes handed over in one step."""

BUILD_VARIABLE: Final = "HAPTICNET_FIRMWARE"
"""Environment variable that names the folder with the simulator and the firmware; else the checkout's own is taken."""

_REQUEST: Final = struct.Struct("<IHH")
_REPLY: Final = struct.Struct("<QIIII")
_EDGE: Final = struct.Struct("<QII")


def simavr_build() -> tuple[Path, Path]:
    """Return the simulator and the firmware for the usual line, as ``make simulator`` built them.

    Raises
    ------
    UnavailableError
        If one of them is missing.
    """
    named = os.environ.get(BUILD_VARIABLE)
    folder = Path(named) if named else Path(__file__).parents[2] / "firmware" / "build"
    paths = folder / "harness", folder / "firmware-500000.elf"
    for path in paths:
        if not path.is_file():
            raise UnavailableError(
                f"{path} is missing: in a checkout of hapticnet, `make simulator` builds it "
                f"({BUILD_VARIABLE} names another folder)"
            )
    return paths


class Edge(NamedTuple):
    """A servo pin changed: when [clock cycles since power-on], which servo (0 to 2), and to what level."""

    cycle: int
    servo: int
    level: int


class Step(NamedTuple):
    """What happened while the time was advanced.

    Attributes
    ----------
    cycle
        Time at its end [clock cycles since power-on].
    sent
        Bytes the firmware sent.
    edges
        Servo pulses, oldest first.
    resets
        How often the controller was reset since power-on.
    latency_cycles
        The longest that any interrupt was ever pending [clock cycles].
    """

    cycle: int
    sent: bytes
    edges: list[Edge]
    resets: int
    latency_cycles: int


class Simavr:
    """A running simulation; a context manager.

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
            # In a session of its own, so that a Ctrl-C meant for us does not end it under our hands.
            self._process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
        except OSError as error:
            raise UnavailableError(f"{harness} does not start: {error}") from error

    def advance(self, duration_us: int, *, millivolts: float = 0.0, data: bytes = b"") -> Step:
        """Let time pass.

        Parameters
        ----------
        duration_us
            How much [µs], up to ten seconds; a few clock cycles more may pass.
        millivolts
            Voltage [mV] at the force sensor's pin meanwhile, clamped to the 5 V supply.
        data
            Bytes for the firmware, up to `MOST_BYTES`; they arrive one after the other at the line's speed.

        Raises
        ------
        SettingsError
            If the duration is out of range or there are too many bytes.
        UnavailableError
            If the simulator has ended.
        """
        check_parameter("step", duration_us, 0, LONGEST_STEP_US, "µs")
        if len(data) > MOST_BYTES:
            raise SettingsError(f"{len(data)} bytes for the UART in one step; {MOST_BYTES} at most")
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
                with contextlib.suppress(OSError):  # what it did not live to read is lost
                    pipe.close()
        self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
