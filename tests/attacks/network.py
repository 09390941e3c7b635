"""Many masters, one slave, and what lies between them, in virtual time."""

import heapq
from collections.abc import Callable, Hashable
from typing import Protocol, TypeAlias

import numpy as np

from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.handshake import Door, SealedDoor
from hapticnet.protocol.keys import MasterEntry, MasterKey, PrivateKey, Roster
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue

Address: TypeAlias = tuple[str, int]

SECOND = 1_000_000
SLAVE_KEY = PrivateKey(bytes(range(32)))


class Channel(Protocol):
    """One direction of a network, as `channel.emulator.Emulator` is one."""

    def push(self, item: bytes, size_bytes: int, now_us: int) -> None: ...

    def due(self, now_us: int) -> list[bytes]: ...

    def next_timer_us(self) -> int | None: ...


class Hand:
    """An operator whose position is a function of time [µs]."""

    axes = 1
    duration_us = 10**15

    def __init__(self, position_m: Callable[[int], float]) -> None:
        self._position_m = position_m

    def sample(self, t_us: int) -> PositionSample:
        return PositionSample(t_us, (self._position_m(t_us),))


def soft_tissue() -> Scene:
    """Return a scene of one layer that is never pierced: 100 N/m from 0."""
    return Scene((Tissue(name="gel", rest_position_m=0.0, stiffness_n_per_m=100.0, breach_force_n=1e6),), name="gel")


def host_of(address: Hashable) -> Hashable:
    return address[0] if isinstance(address, tuple) else address


def master_key(number: int) -> PrivateKey:
    """Return the key of a master by its number."""
    return PrivateKey(bytes([0, number % 256, number // 256, *range(29)]))


def make_slave(
    *,
    sealed: bool,
    masters: int = 1,
    make_scene: Callable[[], Scene] = soft_tissue,
    session: SessionSettings | None = None,
    seed: int = 1,
) -> SlaveNode:
    """Return a slave that serves open sessions, or sealed ones to the masters of the first numbers."""
    rng = np.random.default_rng([seed, 20])
    roster = Roster(MasterEntry(name=f"m{n}", public=master_key(n).public) for n in range(masters))
    doors: dict[int, Door] = {SEALED: SealedDoor(SLAVE_KEY.private, roster, rng)} if sealed else {OPEN: Door()}
    settings = SlaveSettings(session=session or SessionSettings())
    return SlaveNode(lambda _: make_scene(), settings, rng, doors=doors, host_of=host_of)


def make_master(
    hand: Hand,
    *,
    sealed: bool,
    number: int = 0,
    codec: str = "deadband",
    rate_hz: float = 1000.0,
    record: bool = False,
    session: SessionSettings | None = None,
) -> MasterNode:
    """Return a master with the key of its number."""
    key = MasterKey(master_key(number), SLAVE_KEY.public) if sealed else None
    settings = MasterSettings(
        codec=codec, rate_hz=rate_hz, key=key, name=f"m{number}", record=record, session=session or SessionSettings()
    )
    return MasterNode(hand, None, settings, np.random.default_rng([number, 21]))


class Line:
    """A master and its way to the slave. Assign another `address` to make it roam."""

    def __init__(self, master: MasterNode, address: Address, forward: Channel, feedback: Channel, now_us: int) -> None:
        self.master = master
        self.address = address
        self.forward = forward
        self.feedback = feedback
        self.next_tick_us = now_us
        self.stopped = False

    def next_us(self) -> int:
        """Return when there is something to do."""
        times = [self.forward.next_timer_us(), self.feedback.next_timer_us()]
        if not self.stopped:
            times.append(self.next_tick_us)
        return min((at_us for at_us in times if at_us is not None), default=1 << 62)


class Network:
    """Carry datagrams between lines and slave; what the slave sends to an address that no line has is lost."""

    def __init__(self, slave: SlaveNode, *, start_us: int = 0) -> None:
        self.slave = slave
        self.now_us = start_us
        self.lines: list[Line] = []
        self._by_address: dict[Hashable, Line] = {}
        self._queue: list[tuple[int, int]] = []

    def add(self, master: MasterNode, address: Address, forward: Channel, feedback: Channel) -> Line:
        """Add a master, its address, and the channels to and from the slave."""
        line = Line(master, address, forward, feedback, self.now_us)
        self.lines.append(line)
        self._by_address[address] = line
        heapq.heappush(self._queue, (self.now_us, len(self.lines) - 1))
        return line

    def roam(self, line: Line, address: Address) -> None:
        """Give a line another address from now on."""
        del self._by_address[line.address]
        line.address = address
        self._by_address[address] = line

    def run(self, duration_us: int) -> None:
        """Advance by `duration_us`."""
        end_us = self.now_us + duration_us
        while self._queue and self._queue[0][0] <= end_us:
            at_us, index = heapq.heappop(self._queue)
            line = self.lines[index]
            if at_us < line.next_us():  # it has been served since
                if line.next_us() < 1 << 62:
                    heapq.heappush(self._queue, (line.next_us(), index))
                continue
            self.now_us = max(self.now_us, at_us)
            self._serve(line)
            heapq.heappush(self._queue, (max(line.next_us(), self.now_us + 1), index))
        self.now_us = end_us

    def _serve(self, line: Line) -> None:
        now_us = self.now_us
        expiry_us = self.slave.next_timer_us()
        if expiry_us is not None and now_us >= expiry_us:
            self.slave.tick(now_us)
        if not line.stopped and now_us >= line.next_tick_us:
            line.master.tick(now_us)
            line.master.drive(now_us)
            line.next_tick_us = now_us + line.master.period_us
        for _ in range(4):  # a perfect channel delivers at once, and an answer may have an answer
            for data in line.master.datagrams_to_send():
                line.forward.push(data, len(data), now_us)
            for data in line.forward.due(now_us):
                self.slave.receive_datagram(data, line.address, now_us)
            for data, address in self.slave.datagrams_to_send():
                to = self._by_address.get(address)
                if to is not None:
                    to.feedback.push(data, len(data), now_us)
            for data in line.feedback.due(now_us):
                line.master.receive_datagram(data, now_us)
