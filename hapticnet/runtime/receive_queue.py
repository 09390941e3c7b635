"""What Linux knows about the queue of a socket: how old its datagrams are, and how many found no room."""

import socket
import struct
import time
from collections import deque
from contextlib import suppress
from typing import Final

from hapticnet.protocol.stats import Distribution

AGES_KEPT: Final = 1000
"""Ages kept until they are taken: those of a second, even of a port that reads continuously."""

TOLERANCE_US: Final = 1000.0
"""What two clocks of the system may differ by between two samples, and in when they are read [µs]."""

# From <asm-generic/socket.h> and <linux/sock_diag.h>.
_SO_TIMESTAMPNS: Final = 35
_SO_MEMINFO: Final = 55
_TIMESPEC: Final = struct.Struct("=qq")  # s, ns of CLOCK_REALTIME
_MEMINFO: Final = struct.Struct("=9I")
_MEMINFO_DROPS: Final = 8


class ReceiveQueue:
    """The queue of a socket of datagrams.

    Attributes
    ----------
    age
        Time [µs] from the arrival of a datagram at this machine until it was read; a sample of all.
    """

    def __init__(self, sock: socket.socket) -> None:
        self.age = Distribution()
        self._sock = sock
        self._ages_us: deque[float] = deque(maxlen=AGES_KEPT)
        self._drops = 0
        self._none_before_us = time.monotonic_ns() / 1000
        with suppress(OSError):  # not on Linux: ages stay unknown
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def sample_age(self) -> None:
        """Look at the oldest datagram of the queue, and leave it there. Costs 1.6 µs.

        The system stamps datagrams with its wall clock. If that was set since, the age may be impossible: below 0, or
        such that an earlier sample would have found this datagram. Such a sample does not count.

        Raises
        ------
        OSError
            As receiving does; BlockingIOError if the queue is empty.
        """
        now_us = time.monotonic_ns() / 1000
        try:
            _, ancillary, _, _ = self._sock.recvmsg(1, socket.CMSG_SPACE(_TIMESPEC.size), socket.MSG_PEEK)
        except BlockingIOError:
            self._none_before_us = now_us
            raise
        for level, kind, value in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(value) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(value)
                age_us = (time.time_ns() - 1_000_000_000 * seconds - nanoseconds) / 1000
                if 0.0 <= age_us <= now_us - self._none_before_us + TOLERANCE_US:
                    self._none_before_us = max(self._none_before_us, now_us - age_us)
                    self.age.add(age_us)
                    self._ages_us.append(age_us)

    def take_ages(self) -> list[float]:
        """Return the newest samples [µs] since the last call."""
        ages = list(self._ages_us)
        self._ages_us.clear()
        return ages

    def count_drops(self) -> int:
        """Return the number of datagrams that the system dropped because the queue was full.

        Once the socket is closed, this is what the last call before has returned.
        """
        with suppress(OSError, struct.error):  # closed, or not on Linux
            info = self._sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            self._drops = _MEMINFO.unpack(info)[_MEMINFO_DROPS]
        return self._drops
