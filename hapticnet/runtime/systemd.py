"""Messages to systemd: ready, alive, status, stopping (sd_notify(3)). Without systemd there are none."""

import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Generic

from hapticnet.runtime.watching import Event, Watcher


class Notifier(Watcher[Event], Generic[Event]):
    """Tell systemd that the process is ready, and then twice a second that its event loop runs.

    A unit with ``Type=notify`` and ``WatchdogSec=`` thus notices a loop that is stuck, too.

    Parameters
    ----------
    path
        The socket of systemd, from the variable NOTIFY_SOCKET; ``@`` at its start stands for an abstract one.
    status
        Returns a line for ``systemctl status``.
    """

    name = "systemd"

    def __init__(self, path: str, status: Callable[[], str]) -> None:
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._status = status
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    async def start(self) -> None:
        """Tell that the process is ready."""
        self._send("READY=1")

    def check(self, now_us: int) -> None:  # noqa: ARG002 - the interval is fixed
        """Tell that the loop runs."""
        self._send(f"WATCHDOG=1\nSTATUS={self._status()}")

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
