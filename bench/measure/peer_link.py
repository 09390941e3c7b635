"""Two network namespaces and the link between them; counters and CPU time of the processes there."""

import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hapticnet.errors import UnavailableError

NEAR_HOST: Final = "10.77.0.1"
FAR_HOST: Final = "10.77.0.2"
INTERFACE: Final = "wire"
RELAY: Final = Path(__file__).with_name("lossy_link.py")
ETHERNET_HEADER_BYTES: Final = 14
"""Header that a veth interface counts in each packet, and a TUN interface does not."""


@dataclass(frozen=True, slots=True)
class Link:
    """Both namespaces, and the bytes that the interface counts beside each IP packet."""

    near: str
    far: str
    extra_bytes: int

    def command(self, end: str, command: Sequence[object]) -> list[str]:
        """Return a command that runs at an end."""
        return ["ip", "netns", "exec", getattr(self, end), *map(str, command)]


@contextmanager
def link(delay_ms: float | None, loss: float, seed: int) -> Iterator[Link]:
    """Make a link: veth if `delay_ms` is None, else one that delays and drops.

    Raises
    ------
    UnavailableError
        If this user may not make network namespaces, or the system has none.
    """
    near, far = (f"hapticnet-{end}-{os.getpid()}" for end in ("near", "far"))
    relay: subprocess.Popen[str] | None = None
    try:
        for name in (near, far):
            ip("netns", "add", name)
            # Keep packets of IPv6 neighbours out of the counts.
            ip("netns", "exec", name, "sysctl", "-qw", "net.ipv6.conf.all.disable_ipv6=1", needed=False)
            ip("-n", name, "link", "set", "lo", "up")
        if delay_ms is None:
            ip("link", "add", INTERFACE, "netns", near, "type", "veth", "peer", "name", INTERFACE, "netns", far)
        else:
            command = [sys.executable, str(RELAY), INTERFACE, "other", str(delay_ms), str(loss), str(seed)]
            relay = subprocess.Popen(["ip", "netns", "exec", near, *command], stdout=subprocess.PIPE, text=True)
            assert relay.stdout is not None
            if relay.stdout.readline() != "ready\n":
                raise UnavailableError("cannot make TUN interfaces; the lossy link needs /dev/net/tun")
            ip("-n", near, "link", "set", "other", "netns", far, "name", INTERFACE)
        for name, host in ((near, NEAR_HOST), (far, FAR_HOST)):
            ip("-n", name, "address", "add", f"{host}/24", "dev", INTERFACE)
            ip("-n", name, "link", "set", INTERFACE, "up")
        yield Link(near, far, ETHERNET_HEADER_BYTES if delay_ms is None else 0)
    finally:
        if relay is not None:
            relay.terminate()
            relay.communicate()
        for name in (near, far):
            ip("netns", "del", name, needed=False)


def ip(*arguments: str, needed: bool = True) -> None:
    try:
        done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise UnavailableError("the program ip is missing (Debian: iproute2)") from None
    if needed and done.returncode:
        said = done.stderr.strip() or done.stdout.strip()
        raise UnavailableError(f"'ip {' '.join(arguments)}' failed: {said}")


def sent(process: int, extra_bytes: int) -> tuple[int, int]:
    """Return the packets and IP bytes that the link's interface has sent in the namespace of a process."""
    for line in Path(f"/proc/{process}/net/dev").read_text().splitlines():
        name, _, counters = line.partition(":")
        if name.strip() == INTERFACE:
            columns = counters.split()  # eight received counts, then bytes and packets sent
            packets = int(columns[9])
            return packets, int(columns[8]) - packets * extra_bytes
    raise UnavailableError(f"process {process} has no interface {INTERFACE}")


def cpu_us(processes: Iterable[int]) -> float:
    """Return the CPU time [µs] of all threads of processes so far."""
    total_ns = 0
    for process in processes:
        for task in Path(f"/proc/{process}/task").glob("*/schedstat"):
            total_ns += int(task.read_text().split()[0])
    return total_ns / 1e3
