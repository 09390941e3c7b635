"""A link between two TUN interfaces: delay every IP packet, and drop some, the same for every stack.

    lossy_link.py NEAR FAR DELAY_MS LOSS SEED

creates both interfaces in the network namespace it runs in, prints ``ready``, and forwards until it is ended. They keep
working when they are moved to other namespaces. Packets are never reordered. Each direction has its own random
numbers.
"""

import fcntl
import gc
import os
import random
import select
import struct
import sys
import time
from collections import deque
from typing import Final

# From <linux/if_tun.h>.
TUNSETIFF: Final = 0x400454CA
IFF_TUN: Final = 0x0001
IFF_NO_PI: Final = 0x1000

LARGEST_PACKET: Final = 65536
FIFO_PRIORITY: Final = 11
"""Above the measured processes, so that the link does not wait for them."""


def open_tun(name: str) -> int:
    """Create a TUN interface and return its descriptor."""
    tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(tun, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN | IFF_NO_PI))
    return tun


class Direction:
    """Packets on their way from one interface to the other."""

    def __init__(self, source: int, target: int, delay_s: float, loss: float, seed: str) -> None:
        self.source = source
        self._target, self._delay_s, self._loss = target, delay_s, loss
        self._rng = random.Random(seed)
        self._waiting: deque[tuple[float, bytes]] = deque()

    @property
    def due_s(self) -> float | None:
        """When the next packet is to be delivered; None if there is none."""
        return self._waiting[0][0] if self._waiting else None

    def take_in(self) -> None:
        """Read the sent packets."""
        while True:
            try:
                packet = os.read(self.source, LARGEST_PACKET)
            except OSError:  # nothing more, or the interface is down
                return
            if self._rng.random() >= self._loss:
                self._waiting.append((time.monotonic() + self._delay_s, packet))

    def deliver(self, now_s: float) -> None:
        """Write the packets that are due."""
        while self._waiting and self._waiting[0][0] <= now_s:
            try:
                os.write(self._target, self._waiting.popleft()[1])
            except OSError:  # as on a real link, packets to an interface that is down are lost
                continue


def forward(directions: list[Direction]) -> None:
    """Forward until the process is ended."""
    sources = [direction.source for direction in directions]
    while True:
        due = [direction.due_s for direction in directions if direction.due_s is not None]
        # select() waits to the microsecond; Python's epoll rounds up to the millisecond.
        ready, _, _ = select.select(sources, [], [], max(0.0, min(due) - time.monotonic()) if due else None)
        for direction in directions:
            if direction.source in ready:
                direction.take_in()
            direction.deliver(time.monotonic())


def main() -> None:
    near_name, far_name, delay_ms, loss, seed = sys.argv[1:]
    near, far = open_tun(near_name), open_tun(far_name)
    gc.freeze()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except PermissionError:
        print("the link has no real-time priority", file=sys.stderr)
    print("ready", flush=True)
    common = float(delay_ms) / 1e3, float(loss)
    forward([Direction(near, far, *common, f"{seed} out"), Direction(far, near, *common, f"{seed} back")])


if __name__ == "__main__":
    main()
