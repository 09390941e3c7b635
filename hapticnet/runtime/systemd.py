"""Messages to systemd: ready, alive, status, stopping (sd_notify(3)). Without systemd there are none."""

import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Final, Generic

from hapticnet.runtime.watching import Event, Watcher

EXTENSION_US: Final = 10_000_000
"""Time [µs] that systemd is asked to wait for the end, again and again while a slave waits for its masters."""


class Notifier(Watcher[Event], Generic[Event]):
    """Tell systemd that the process is ready, and then twice a second that its event loop runs.

    A unit with ``Type=notify`` and ``WatchdogSec=`` thus notices a loop that is stuck, too.

    `path`: The socket of systemd, from the variable NOTIFY_SOCKET; ``@`` at its start stands for an abstract one.
    `status`: Returns a line for ``systemctl status``.
    `stopping`: Returns whether the process was told to end and waits for others; systemd then waits for it, too.
    """

    name = "systemd"

    def __init__(self, path: str, status: Callable[[], str], stopping: Callable[[], bool] = lambda: False) -> None:
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._status = status
        self._stopping = stopping
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    async def start(self) -> None:
        """Tell that the process is ready."""
        self._send("READY=1")

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Tell that the loop runs."""
        more = f"\nEXTEND_TIMEOUT_USEC={EXTENSION_US}" if self._stopping() else ""
        self._send(f"WATCHDOG=1\nSTATUS={self._status()}{more}")

    async def stop(self) -> None:
        """Tell that the process is about to end."""
        self._send("STOPPING=1")
        self._socket.close()

    def _send(self, message: str) -> None:
        with suppress(OSError):  # systemd does not read just now, or is gone
            self._socket.sendto(message.encode(), self._address)


def notify_socket(environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the socket on which systemd expects messages; None if it expects none."""
    path = environment.get("NOTIFY_SOCKET", "")
    return path if path.startswith(("/", "@")) else None
