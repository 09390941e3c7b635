"""The compiled firmware on a simulated ATmega328P: alone, with the simulated plant, or on a pseudo-terminal."""

import asyncio
import contextlib
import errno
import os
import struct
import subprocess
import termios
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.device.base import Device, Reading
from hapticnet.device.simulated import Plant, PlantSettings, loading_calibration
from hapticnet.device.wired import WiredDevice
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.runtime.serial_port import run_device
from hapticnet.runtime.timer import Repeating

CYCLES_PER_US: Final = 16  # clock cycles per µs of the Nano: 16 MHz
LONGEST_STEP_US: Final = 10_000_000  # longest step [µs]: the firmware's output must fit the harness's buffers
MOST_BYTES: Final = 0xFFFF  # largest number of bytes passed in one step
BUILD_VARIABLE: Final = "HAPTICNET_FIRMWARE"  # folder of simulator and firmware; default: the one in the checkout
_REQUEST: Final = struct.Struct("<IHH")
_REPLY: Final = struct.Struct("<QIIII")
_EDGE: Final = struct.Struct("<QII")


def simavr_build() -> tuple[Path, Path]:
    """Return simulator and firmware as built by ``make simulator``; raise UnavailableError if one is missing."""
    folder = Path(os.environ.get(BUILD_VARIABLE) or Path(__file__).parents[2] / "firmware" / "build")
    paths = folder / "harness", folder / "firmware.elf"
    for path in paths:
        if not path.is_file():
            raise UnavailableError(
                f"{path} is missing: `make simulator` in a checkout of hapticnet builds it; elsewhere, {BUILD_VARIABLE}"
                " must name the checkout's firmware/build"
            )
    return paths


class Edge(NamedTuple):
    """A change of a servo pin: time [clock cycles since power-on], servo (0 to 2) and new level."""

    cycle: int
    servo: int
    level: int


class Step(NamedTuple):
    """Result of a step."""

    cycle: int  # time at the end [clock cycles since power-on]
    sent: bytes  # bytes sent by the firmware
    edges: list[Edge]  # changes of the servo pins, oldest first
    resets: int  # number of resets of the controller since power-on
    latency_cycles: int  # longest time that any interrupt was pending so far [clock cycles]


class Simavr:
    """A running simulation of an ELF file. Raises UnavailableError if a file is missing or it does not start."""

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
        """Advance by up to ten seconds with `millivolts` at the force sensor's pin; may be a few cycles more.

        The `data` for the firmware arrive at the speed of the line. SettingsError if the duration or their number is
        out of range; UnavailableError if the simulator has ended.
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


SLICE_US: Final = 1_000  # interval [µs] of the converter's voltage: the window of the firmware's mean
LONGEST_GAP_US: Final = 2_000_000  # longest gap [µs] simulated: by then the firmware has retracted and the servos rest
SHORTEST_PULSE_US: Final = 500.0
LONGEST_PULSE_US: Final = 2_500.0  # limits [µs] of a hobby servo's pulses; a reset may cut one short
SUPPLY_MV: Final = 5_000.0  # full scale of the converter [mV], whose reference is the supply
SensorHook: TypeAlias = Callable[[float, int], float]  # a fault: input [counts] from true output [counts], time [µs]


class Board:
    """The firmware on its board with the plant: pulses out, sensor voltage in. `build` is as from `simavr_build`."""

    def __init__(
        self, settings: PlantSettings, rng: np.random.Generator, *, build: tuple[Path, Path] | None = None
    ) -> None:
        self.plant = Plant(settings, rng)  # the mechanics
        self.sensor: SensorHook | None = None  # fault of the sensor, if any
        self.resets = 0  # number of resets of the controller since power-on
        self._simavr = Simavr(*(build or simavr_build()))
        self._millivolts_per_count = SUPPLY_MV / (1 << settings.sensor.adc_bits)
        self._now_us = 0
        self._power_on_us = 0.0  # on the caller's clock
        self._cycle = 0
        self._rises: list[int | None] = [None, None, None]

    def set_clock(self, now_us: int) -> None:
        """Set the present time to `now_us` [µs]; simulation continues from here."""
        self._now_us = now_us
        self._power_on_us = now_us - self._cycle / CYCLES_PER_US
        self.plant.advance(now_us)

    def advance(self, now_us: int, data: bytes = b"") -> bytes:
        """Advance to `now_us`, by at most a slice; pass in `data` at its start, and return the output."""
        plant = self.plant
        counts = plant.level_counts()
        if self.sensor is not None:
            counts = self.sensor(counts, self._now_us)
        # Steps may be a few cycles too long; counting from power-on keeps the excess from accumulating.
        duration_us = round(now_us - self._power_on_us - self._cycle / CYCLES_PER_US)
        step = self._simavr.advance(max(0, duration_us), millivolts=counts * self._millivolts_per_count, data=data)
        self._now_us = now_us
        self._cycle = step.cycle
        self.resets = step.resets
        for cycle, servo, level in step.edges:
            rise = self._rises[servo]
            if level:
                self._rises[servo] = cycle
            elif rise is not None:  # the initial level of a pin is also reported as an edge
                width_us = (cycle - rise) / CYCLES_PER_US
                if SHORTEST_PULSE_US <= width_us <= LONGEST_PULSE_US:
                    plant.advance(self._power_on_us + cycle / CYCLES_PER_US)
                    plant.take_one(servo, width_us)
        plant.advance(self._power_on_us + step.cycle / CYCLES_PER_US)
        return step.sent

    def close(self) -> None:
        """End the simulation."""
        self._simavr.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Disturbance of the host's writes."""

    delay_us: int = 0  # delay [µs]
    loss: float = 0.0  # share of writes that are lost (0 to 1), requests included


class SimulatedNano(Device):
    """The device in lockstep: `exchange` advances host's end of the line (`wired`), firmware and plant."""

    def __init__(
        self,
        settings: PlantSettings,
        rng: np.random.Generator,
        *,
        wired: WiredDevice | None = None,
        build: tuple[Path, Path] | None = None,
        disturbance: Disturbance | None = None,
    ) -> None:
        self.board = Board(settings, rng, build=build)  # firmware and plant; set `board.sensor` for a sensor fault
        self.plant = self.board.plant  # the mechanics
        self.wired = wired or WiredDevice(
            loading_calibration(settings.sensor), linkage=settings.linkage, servo=settings.servo
        )
        self.capabilities = self.wired.capabilities
        self.delay_us = self.wired.delay_us
        self.description = (
            f"simulated Nano with the compiled firmware, finger {settings.finger.stiffness_n_m / 1000.0:g} N/mm at 1 N"
        )
        self.status = self.wired.status
        self._disturbance = disturbance or Disturbance()
        self._loss_rng = rng.spawn(1)[0]
        self._under_way: deque[tuple[int, bytes]] = deque()
        self._now_us: int | None = None

    @property
    def contact_force_n(self) -> float:
        """True force [N] on the finger, unknown to real devices."""
        return self.plant.contact_force_n

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the displacement [m] and return the newest reading or None; no time passes unless `now_us` is later."""
        try:
            self._advance(now_us)
        except UnavailableError as error:
            self.wired.closed(str(error), now_us)
        reading = self.wired.exchange(displacement_m, now_us)
        self.status = self.wired.status
        return reading

    def report(self) -> dict[str, Any]:
        """Return the counters of the line, for JSON."""
        return self.wired.report()

    def close(self) -> None:
        """End the simulation."""
        self.board.close()

    def _advance(self, now_us: int) -> None:
        at_us = self._now_us
        if at_us is None:
            self.wired.opened(now_us)
        if at_us is None or not 0 <= now_us - at_us <= LONGEST_GAP_US:
            at_us = now_us if at_us is None or now_us < at_us else now_us - LONGEST_GAP_US
            self.board.set_clock(at_us)
            self._under_way.clear()
        while at_us < now_us:
            data = self._arriving(at_us)
            at_us = min(at_us + SLICE_US, now_us)
            sent = self.board.advance(at_us, data)
            if sent:
                self.wired.receive(sent, at_us)
        self._now_us = now_us

    def _arriving(self, now_us: int) -> bytes:
        """Accept the host's writes, and return the bytes that reach the board."""
        data = self.wired.bytes_to_send()
        disturbance = self._disturbance
        if data and not (disturbance.loss and self._loss_rng.random() < disturbance.loss):
            self._under_way.append((now_us + disturbance.delay_us, data))
        arriving = b""
        while self._under_way and self._under_way[0][0] <= now_us:
            arriving += self._under_way.popleft()[1]
        return arriving


MOST_CATCH_UP_US: Final = 50_000  # longest stall [µs] that is caught up; the rest of a longer one is skipped
MOST_READ_BYTES: Final = 4096  # largest number of bytes read at a time: the capacity of a pseudo-terminal


class NanoPty:
    """A board on a pseudo-terminal; its output is lost while that is closed.

    Opening it does not reset the controller. Raise UnavailableError without a pseudo-terminal.
    """

    def __init__(self, board: Board) -> None:
        self.board = board  # firmware and plant
        self.visited = False  # whether a program has it open
        self.lost_us = 0  # real time [µs] skipped after stalls
        self._simulated_us = 0
        self._reached_us: int | None = None
        try:
            self._master, visitor = os.openpty()
        except OSError as error:
            raise UnavailableError(f"cannot create a pseudo-terminal: {error.strerror}") from error
        try:
            self.path = os.ttyname(visitor)  # the pseudo-terminal to open
            tty.setraw(visitor)  # remains in force as long as this end is open
            os.set_blocking(self._master, False)
        except BaseException:
            os.close(self._master)
            raise
        finally:
            # Only visitors hold this end, so that their coming and going can be detected.
            os.close(visitor)

    def advance(self, now_us: int) -> None:
        """Advance the board to `now_us`, and carry bytes; raise UnavailableError if the simulator has ended."""
        reached_us = now_us if self._reached_us is None else self._reached_us
        self._reached_us = now_us
        elapsed_us = min(max(now_us - reached_us, 0), MOST_CATCH_UP_US)
        self.lost_us += max(now_us - reached_us, 0) - elapsed_us
        data = self._read()
        end_us = self._simulated_us + elapsed_us
        while self._simulated_us < end_us:
            self._simulated_us = min(self._simulated_us + SLICE_US, end_us)
            self._write(self.board.advance(self._simulated_us, data))
            data = b""

    def close(self) -> None:
        """Close the pseudo-terminal; the owner closes the board."""
        os.close(self._master)

    def _read(self) -> bytes:
        try:
            data = os.read(self._master, MOST_READ_BYTES)
        except BlockingIOError:
            data = b""
        except OSError as error:
            if error.errno != errno.EIO:  # EIO: no program has the other end open
                raise UnavailableError(f"{self.path} cannot be read: {error.strerror}") from error
            if self.visited:
                self.visited = False
                self._forget_unread()
            return b""
        self.visited = True
        return data

    def _forget_unread(self) -> None:
        """Discard input that the last visitor left unread; this is possible only from a visitor's end."""
        with contextlib.suppress(OSError, termios.error):
            visitor = os.open(self.path, os.O_RDWR | os.O_NOCTTY)
            try:
                termios.tcflush(visitor, termios.TCIFLUSH)
            finally:
                os.close(visitor)

    def _write(self, data: bytes) -> None:
        if data and self.visited:
            # Output that does not fit because the visitor does not read is lost; a departure is noticed next time.
            with contextlib.suppress(OSError):
                os.write(self._master, data)


async def run_nano_pty(nano: NanoPty, on_status: Callable[[], None]) -> None:
    """Run until SIGINT or SIGTERM; raise UnavailableError if the simulator ends."""

    def tick(now_us: int) -> bool:
        nano.advance(now_us)
        return False

    status = Repeating(asyncio.get_running_loop(), on_status)
    try:
        await run_device(None, tick)
    finally:
        status.cancel()
