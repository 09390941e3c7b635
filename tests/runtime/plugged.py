"""A stand-in for the firmware on a real pseudo-terminal, in real time."""

import asyncio
import contextlib
import fcntl
import os
import tempfile
import tty
from typing import Final

from hapticnet.runtime.timer import Ticker
from tests.device.standin import StandIn

TIOCVHANGUP: Final = 0x5437  # <asm-generic/ioctls.h> of Linux


class Plugged:
    """A stand-in on a pseudo-terminal while it is plugged in, at a path of its own.

    A closed pseudo-terminal's number goes to the next one on this host, which a retried port of a test would take."""

    def __init__(self, firmware: StandIn) -> None:
        self.firmware = firmware
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._folder = tempfile.TemporaryDirectory(prefix="plugged-")
        self.path = f"{self._folder.name}/ttyUSB0"
        os.symlink(os.ttyname(slave), self.path)
        # Keep this end open; otherwise there would be a hang-up whenever the host closes its end.
        self._slave = slave
        os.set_blocking(self._master, False)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._master, self._hear)
        self._ticker = Ticker(self._loop, 1000, self._tick)

    def hang_up(self) -> None:
        """Hang up like the kernel when a USB adapter is unplugged; needs CAP_SYS_ADMIN."""
        fcntl.ioctl(self._slave, TIOCVHANGUP)

    def unplug(self) -> None:
        if not os.path.lexists(self.path):  # unplugged already
            return
        self._loop.remove_reader(self._master)
        self._ticker.stop()
        self._folder.cleanup()
        os.close(self._slave)
        os.close(self._master)

    def say(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # no reader
            os.write(self._master, data)

    def _hear(self) -> None:
        with contextlib.suppress(OSError):  # hung up
            self.firmware.receive(os.read(self._master, 4096))

    def _tick(self, _: int) -> None:
        self.firmware.tick()
        sent = self.firmware.take_sent()
        if sent:
            self.say(sent)
