"""Serial ports: find the port of a device, and carry the bytes of a wired device over it despite any fault."""

import asyncio
import contextlib
import errno
import os
import termios
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import serial
from serial.tools import list_ports

from hapticnet.device.wired import READY, WiredDevice
from hapticnet.errors import RefusedError, SettingsError, UnavailableError
from hapticnet.runtime.signals import stop_on_signals
from hapticnet.runtime.system import now_us
from hapticnet.runtime.timer import Ticker, either

BAUD: Final = 500_000

BY_ID: Final = Path("/dev/serial/by-id")  # links by udev, named after the device: the same after replugging
NANO_VENDORS: Final = {  # USB vendor ids of Nanos and their adapters, from the USB ID Repository
    0x0403: "FTDI chip, as on Arduino Nanos",
    0x1A86: "CH340 chip, as on Nano clones",
    0x2341: "made by Arduino",
    0x2A03: "made by Arduino",
}

START_WITHIN_S: Final = 5.0  # time for a device to give readings: 3 s until it counts as silent, and opening
RETRY_S: Final = 0.25
WAIT_STEP_S: Final = 0.005
READ_BYTES: Final = 4096  # about 80 ms of a full line at 500 kbaud


@dataclass(frozen=True, slots=True)
class SerialSpec:
    """A serial device specification: serial:PATH; path None means auto."""

    path: str | None

    def __str__(self) -> str:
        return f"serial:{self.path or 'auto'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """A device on a serial line, and its port."""

    wired: WiredDevice
    spec: SerialSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundPort:
    """A serial port of this host."""

    path: str  # path for a specification: its link in /dev/serial/by-id, if there is one
    name: str  # the device file
    description: str  # name reported by the USB device
    serial_number: str | None  # serial number of the USB device; None if it has none
    likely: str | None  # why it may be an Arduino Nano; None if there is no indication


def parse_serial(text: str) -> SerialSpec:
    """Return the specification written as `text`; raise SettingsError if it is invalid."""
    kind, _, path = text.partition(":")
    if kind != "serial" or not path:
        raise SettingsError(f"device {text!r} must be serial:auto or serial:PATH, such as serial:/dev/ttyUSB0")
    if path != "auto" and not path.startswith("/"):
        raise SettingsError(f"port {path!r} of device {text!r} must be auto or an absolute path, such as /dev/ttyUSB0")
    return SerialSpec(None if path == "auto" else path)


def find_ports() -> list[FoundPort]:
    """Return the serial ports of this host: likely ones first, then those with a link by id."""
    links = {}
    with contextlib.suppress(OSError):  # the directory does not exist if nothing is plugged in
        links = {os.path.realpath(link): str(link) for link in sorted(BY_ID.iterdir())}
    found = [
        FoundPort(
            path=links.get(os.path.realpath(port.device), port.device),
            name=port.device,
            description="" if port.description in (None, "n/a") else port.description,
            serial_number=port.serial_number,
            likely=NANO_VENDORS.get(port.vid),
        )
        for port in list_ports.comports()
    ]
    return sorted(found, key=lambda port: (port.likely is None, port.path == port.name, port.path))


def choose_port() -> str:
    """Return the path of the only port that may be a Nano; otherwise UnavailableError lists the choices."""
    ports = find_ports()
    likely = [port for port in ports if port.likely]
    if len(likely) == 1:
        return likely[0].path
    if likely:
        names = ", ".join(f"serial:{port.path}" for port in likely)
        raise UnavailableError(f"{len(likely)} ports may be the device; choose one: {names}")
    others = ", ".join(f"serial:{port.path}" for port in ports) or "none"
    raise UnavailableError(f"no port looks like an Arduino Nano. Is it plugged in? Ports to choose from: {others}")


class SerialPort:
    """A serial port on an event loop that carries a wired device. Call `flush` after each exchange with it."""

    def __init__(self, loop: asyncio.AbstractEventLoop, spec: SerialSpec, wired: WiredDevice) -> None:
        self.failure: str | None = None  # why the port could not be opened at the last attempt; None if it is open
        self.openings = 0  # number of times the port was opened
        self.unwritten = 0  # number of bytes the port did not accept; they are dropped in favour of newer ones
        self._loop = loop
        self._spec = spec
        self._wired = wired
        self._fd: int | None = None
        self._rest = b""  # remainder of a frame that the port accepted in part
        self._gone = asyncio.Event()
        self._task = loop.create_task(self._keep_open())

    def flush(self, now_us: int) -> None:
        """Write the device's output without waiting; reopen the port if the device requests it."""
        data = self._wired.bytes_to_send()
        if self._fd is not None and self._wired.wants_reopening:
            self._lose(self._wired.status, now_us)
        if self._rest:
            self._rest = self._rest[self._write(self._rest, now_us) :]
        written = 0 if self._rest else self._write(data, now_us)
        if written:
            self._rest = data[written:]
        else:
            self.unwritten += len(data)

    async def wait_ready(self, timeout_s: float) -> None:
        """Drive the device, retracted, until it gives readings; RefusedError or UnavailableError if it does not."""
        end_us = now_us() + round(timeout_s * 1e6)
        while self._wired.status != READY:
            if self._wired.refusal:
                raise RefusedError(f"{self._spec}: {self._wired.refusal}")
            if self.failure or now_us() > end_us:
                raise UnavailableError(self.failure or f"{self._spec}: {self._wired.status}")
            self._wired.exchange(0.0, now_us())
            self.flush(now_us())
            await asyncio.sleep(WAIT_STEP_S)

    async def stop(self) -> None:
        """Close the port for good. The device then retracts because it receives nothing."""
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task

    async def _keep_open(self) -> None:
        while True:
            opening = self._loop.run_in_executor(None, _open, self._spec)
            try:
                port = await asyncio.shield(opening)
            except asyncio.CancelledError:
                opening.add_done_callback(_close_opened)
                raise
            except UnavailableError as error:
                self.failure = str(error)
                self._wired.closed(self.failure, now_us())
            else:
                try:
                    self._take(port.fileno())
                    await self._gone.wait()
                finally:
                    self._lose("closed", now_us(), orderly=True)
                    await self._loop.run_in_executor(None, _close, port)
            await asyncio.sleep(RETRY_S)

    def _take(self, fd: int) -> None:
        self._fd = fd
        self._gone.clear()
        self._rest = b""
        self.failure = None
        self.openings += 1
        self._wired.opened(now_us())
        self._loop.add_reader(fd, self._read)

    def _lose(self, reason: str, now_us: int, *, orderly: bool = False) -> None:
        if self._fd is None:
            return
        # Do this at once: a closed port stays readable, and the loop would spin on it.
        self._loop.remove_reader(self._fd)
        self._fd = None
        self._rest = b""
        self._wired.closed(reason, now_us, orderly=orderly)
        self._gone.set()

    def _read(self) -> None:
        if self._fd is None:
            return
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._wired.receive(data, now_us())
        else:
            self._lose("unplugged", now_us())

    def _write(self, data: bytes, now_us: int) -> int:
        """Write what the port accepts at once; return the number of bytes."""
        if self._fd is None or not data:
            return 0
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError:
            self._lose("unplugged", now_us)
            return 0


async def open_wire(wire: Wire, stop: asyncio.Event) -> SerialPort | None:
    """Open a wire and wait for readings; return None if `stop` is set. Raise like `SerialPort.wait_ready`."""
    port = SerialPort(asyncio.get_running_loop(), wire.spec, wire.wired)
    ready = asyncio.ensure_future(port.wait_ready(START_WITHIN_S))
    stopped = asyncio.ensure_future(stop.wait())
    opened = False
    try:
        await asyncio.wait({ready, stopped}, return_when=asyncio.FIRST_COMPLETED)
        if ready.done():
            await ready
        opened = not stop.is_set()
        return port if opened else None
    finally:
        ready.cancel()
        stopped.cancel()
        if not opened:
            await port.stop()


def _open(spec: SerialSpec) -> serial.Serial:
    """Open a port; UnavailableError says why this failed and how to fix it."""
    path = spec.path or "the port"
    try:
        path = spec.path or choose_port()
        port = serial.Serial(path, BAUD, timeout=0, exclusive=True)
        attributes = termios.tcgetattr(port.fileno())
        attributes[6][termios.VMIN] = 1  # so that an empty read means that the port is gone
        termios.tcsetattr(port.fileno(), termios.TCSANOW, attributes)
    except (OSError, ValueError, termios.error) as error:
        raise UnavailableError(f"{path} {_in_words(error)}") from error
    # An FTDI chip buffers bytes for up to 16 ms unless told otherwise; other chips and pseudo-terminals do not.
    with contextlib.suppress(OSError, ValueError, NotImplementedError):
        port.set_low_latency_mode(True)
    return port


def _in_words(error: Exception) -> str:
    number = error.errno if isinstance(error, OSError) else error.args[0] if error.args else None
    if number == errno.ENOENT:
        return "is missing; is the device plugged in? hapticnet device find lists the ports"
    if number in (errno.EACCES, errno.EPERM):
        return (
            "cannot be opened: permission denied; add yourself to the group dialout (sudo usermod -aG dialout $USER) "
            "and log in again"
        )
    if number in (errno.EAGAIN, errno.EBUSY):
        return "is in use by another program"
    if number in (errno.EISDIR, errno.ENOTTY) or "Inappropriate ioctl" in str(error):
        return "is not a serial port"
    if isinstance(error, ValueError):
        return f"does not support {BAUD} baud; use another adapter"
    return f"cannot be opened: {os.strerror(number) if isinstance(number, int) and number > 0 else error}"


def _close(port: serial.Serial) -> None:
    # Unsent output would keep the port of a dead adapter from closing.
    with contextlib.suppress(OSError, termios.error):
        port.reset_output_buffer()
    with contextlib.suppress(OSError):
        port.close()


def _close_opened(opening: "asyncio.Future[serial.Serial]") -> None:
    if not opening.cancelled() and opening.exception() is None:
        _close(opening.result())


TICK_US: Final = 1000


async def run_device(wire: Wire | None, tick: Callable[[int], bool]) -> bool:
    """Open a device, wait for readings, then call `tick` with the time [µs] every ms until it returns True.

    Return whether this, not a signal, ended the run. Raise like `open_wire` or `tick`.
    """
    loop = asyncio.get_running_loop()
    signalled = stop_on_signals(loop)
    done = asyncio.Event()
    failure: list[Exception] = []
    port = await open_wire(wire, signalled) if wire is not None else None
    if wire is not None and port is None:
        return False

    def on_tick(now_us: int) -> None:
        try:
            if not done.is_set() and tick(now_us):
                done.set()
        except Exception as error:
            failure.append(error)
            done.set()
        if port is not None:
            port.flush(now_us)

    ticker = Ticker(loop, TICK_US, on_tick)
    try:
        await either(done, signalled, None)
        if failure:
            raise failure[0]
        return not signalled.is_set()
    finally:
        ticker.stop()
        if port is not None:
            await port.stop()
