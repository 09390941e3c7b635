"""Many masters in one process, each with its own socket, and a slave that is killed and started again.

Each master is a `MasterSession` without operator and device: it sends the same position at a low rate. So a hundred of
them take a fraction of one core, and all timers, cookies and limits are the real ones.
"""

import dataclasses
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from fleet_costs import request

from hapticnet.protocol.events import ForceArrived, HoldConfirmed, LinkStale
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import Kind
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.entropy import SystemEntropy

TICK_S: Final = 0.004
"""How often each master's timers are looked at; a master with an operator does so at its sample rate."""

POSITION: Final = struct.pack(">f", 0.0)
"""In free air: the slave answers with KEEPALIVEs."""

KIND_BYTE: Final = 2
"""Where the kind stands in a frame, after the head of the array and the version."""

BIN_S: Final = 0.1
"""HELLOs are counted in bins of this length."""

PATIENCE_S: Final = 40.0

COMMAND: Final = (sys.executable, "-m", "hapticnet", "slave", "--scene", "paper:1", "--no-real-time")


class Slave:
    """A ``hapticnet slave`` on loopback, with as many places as are asked for; every start uses the same port."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._process: subprocess.Popen[str] | None = None
        self.address = ("127.0.0.1", 0)

    def start(self) -> None:
        """Start it, and wait until it listens."""
        places = "--most-sessions", str(self._places), "--most-sessions-per-key", str(self._places)
        listen = "--listen", f"{self.address[0]}:{self.address[1]}"
        command = [*COMMAND, *listen, *places]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        assert self._process.stderr is not None
        for line in self._process.stderr:
            found = re.search(r"listening on 127\.0\.0\.1:(\d+)", line)
            if found:
                self.address = ("127.0.0.1", int(found[1]))
                return
        raise RuntimeError(f"the slave did not start: exit code {self._process.wait()}")

    def kill(self) -> None:
        """Kill it: no CLOSE, no report."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """Ask it to end: it closes every session."""
        self._end(signal.SIGTERM)

    def cpu_s(self) -> float:
        """Return its CPU time so far [s], the kernel's part included."""
        assert self._process is not None
        return float(Path(f"/proc/{self._process.pid}/schedstat").read_text().split()[0]) / 1e9

    def _end(self, how: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(how)
        self._process.wait()
        assert self._process.stderr is not None
        self._process.stderr.close()


@dataclasses.dataclass(slots=True)
class Master:
    """A session, its socket, and what happened since the slave was lost [s after that]."""

    session: MasterSession
    sock: socket.socket
    next_us: int
    stale_s: float | None = None
    asked_s: float | None = None
    back_s: float | None = None
    number: int = 0


class Crowd:
    """Masters that are played in turn by one thread.

    Parameters
    ----------
    addresses
        How many addresses they share evenly.
    rate_hz
        Positions a second of each.
    """

    def __init__(self, count: int, addresses: int, rate_hz: float, slave: Slave) -> None:
        rng, asked = SystemEntropy(), request(rate_hz, "")
        self._slave = slave
        self._period_us = round(1e6 / rate_hz)
        self._poll = select.epoll()
        self._by_descriptor: dict[int, Master] = {}
        self.masters: list[Master] = []
        self.lost_us: int | None = None
        self.hellos: Counter[int] = Counter()
        started = now_us()
        for index in range(count):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            place = index % addresses
            sock.bind((f"127.{1 + place // 62500}.{place // 250 % 250}.{place % 250 + 1}", 0))
            session = MasterSession(asked._replace(name=f"m{index}"), SessionSettings(), rng)
            master = Master(session, sock, started + index * self._period_us // count)
            self._by_descriptor[sock.fileno()] = master
            self.masters.append(master)
            self._poll.register(sock.fileno(), select.EPOLLIN)

    def play(self, until: Callable[[], bool], patience_s: float = PATIENCE_S) -> bool:
        """Play all masters until a condition holds; return False if it does not in time."""
        end_s = time.monotonic() + patience_s
        next_s = time.monotonic()
        while not until():
            now_s = time.monotonic()
            if now_s > end_s:
                return False
            if now_s >= next_s:
                next_s = max(next_s + TICK_S, now_s)
                now = now_us()
                for master in self.masters:
                    self._tick(master, now)
            for descriptor, _ in self._poll.poll(max(0.0, next_s - time.monotonic())):
                self._receive(self._by_descriptor[descriptor])
        return True

    def lose(self) -> None:
        """Begin to note what happens: the slave is lost now."""
        self.lost_us = now_us()
        self.hellos.clear()
        for master in self.masters:
            master.stale_s = master.asked_s = master.back_s = None
            master.number = master.session.number

    def close(self) -> None:
        """Close every socket."""
        for master in self.masters:
            master.sock.close()
        self._poll.close()

    def is_settled(self) -> bool:
        """Return whether every master has its forces confirmed."""
        return all(master.session.round_trip.count > 0 for master in self.masters)

    def is_back(self) -> bool:
        """Return whether every master has had a fresh answer in a new session."""
        return all(master.back_s is not None for master in self.masters)

    def _tick(self, master: Master, now: int) -> None:
        session = master.session
        session.tick(now)
        if now >= master.next_us:
            master.next_us = max(master.next_us + self._period_us, now - self._period_us)
            session.send_position(now, POSITION)
        self._flush(master)

    def _receive(self, master: Master) -> None:
        try:
            while True:
                master.session.receive_datagram(master.sock.recv(2048), now_us())
        except BlockingIOError:
            pass
        self._flush(master)

    def _flush(self, master: Master) -> None:
        session = master.session
        for data in session.datagrams_to_send():
            master.sock.sendto(data, self._slave.address)
            if self.lost_us is not None and data[KIND_BYTE] == Kind.HELLO:
                self._note_hello(master)
        while (event := session.next_event()) is not None:
            if isinstance(event, ForceArrived):
                session.applied(event)
            if self.lost_us is None:
                continue
            since_s = (now_us() - self.lost_us) / 1e6
            if isinstance(event, LinkStale) and master.stale_s is None:
                master.stale_s = since_s
            elif isinstance(event, ForceArrived | HoldConfirmed) and session.number != master.number:
                master.back_s = since_s if master.back_s is None else master.back_s

    def _note_hello(self, master: Master) -> None:
        assert self.lost_us is not None
        since_s = (now_us() - self.lost_us) / 1e6
        self.hellos[int(since_s / BIN_S)] += 1
        if master.asked_s is None:
            master.asked_s = since_s


def outage(masters: int, addresses: int, rate_hz: float, wait_s: float, *, kill: bool) -> dict[str, Any]:
    """Let masters work, end their slave, start it again `wait_s` later, and return when each was served again.

    The slave's CPU time per position is taken before, while all work.
    """
    slave = Slave(masters + 8)
    slave.start()
    crowd = Crowd(masters, addresses, rate_hz, slave)
    try:
        assert crowd.play(crowd.is_settled), "not every master got a session"
        crowd.play(lambda: False, 1.0)
        cpu_s, sent = slave.cpu_s(), _positions(crowd)
        crowd.play(lambda: False, 2.0)
        cpu_s, sent = slave.cpu_s() - cpu_s, _positions(crowd) - sent
        (slave.kill if kill else slave.stop)()
        crowd.lose()
        crowd.play(lambda: False, wait_s)
        restart = _Restart(slave)
        assert crowd.play(lambda: restart.listens() and crowd.is_back()), "not every master came back"
        assert crowd.lost_us is not None
        return {
            "outage_s": (restart.listens_us - crowd.lost_us) / 1e6,
            "back_s": [master.back_s for master in crowd.masters],
            "stale_s": [master.stale_s for master in crowd.masters],
            "asked_s": [master.asked_s for master in crowd.masters],
            "hellos": sum(crowd.hellos.values()),
            "peak_hellos_per_s": max(crowd.hellos.values()) / BIN_S,
            "cpu_us_per_position": 1e6 * cpu_s / sent,
        }
    finally:
        slave.kill()
        crowd.close()


class _Restart:
    """A slave that starts while the masters go on."""

    def __init__(self, slave: Slave) -> None:
        self.listens_us = 0
        self._slave = slave
        self._thread = threading.Thread(target=self._start)
        self._thread.start()

    def listens(self) -> bool:
        return self.listens_us > 0

    def _start(self) -> None:
        self._slave.start()
        self.listens_us = now_us()


def _positions(crowd: Crowd) -> int:
    return sum(master.session.sent.by_kind[Kind.POSITION] for master in crowd.masters)
