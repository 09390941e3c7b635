"""Master, slave and two channels in virtual time: the effects of a network without sockets or waiting."""

from typing import Final, Protocol

import numpy as np

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.settings import ChannelSettings
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import Operator
from hapticnet.scene.base import Touchable

MASTER_ADDRESS: Final = "loopback"


class Channel(Protocol):
    """A one-way carrier of datagrams, such as an `Emulator`."""

    def push(self, item: bytes, size_bytes: int, now_us: int) -> None:
        """Send a datagram."""

    def due(self, now_us: int) -> list[bytes]:
        """Remove and return the datagrams that have arrived."""
        ...

    def next_timer_us(self) -> int | None:
        """Return when the next datagram arrives [µs]; None if none is under way."""
        ...


class Loopback:
    """Run both nodes; every datagram is built, carried by a channel, and parsed."""

    def __init__(
        self, master: MasterNode, slave: SlaveNode, *, forward: Channel, feedback: Channel, start_us: int = 0
    ) -> None:
        self.master = master
        self.slave = slave
        self.forward = forward
        self.feedback = feedback
        self.now_us = start_us
        self._next_tick_us = start_us

    def run(self, duration_us: int) -> None:
        """Advance by `duration_us` [µs], from event to event."""
        end_us = self.now_us + duration_us
        master, forward, feedback = self.master, self.forward, self.feedback
        while (now_us := self.now_us) < end_us and master.end_reason is None:
            if now_us >= self._next_tick_us:
                master.tick(now_us)
                master.drive(now_us)
                self._next_tick_us += master.period_us
            slave_us = self._exchange(now_us)
            next_us = self._next_tick_us
            if slave_us is not None and slave_us < next_us:
                next_us = slave_us
            for channel in (forward, feedback):
                due_us = channel.next_timer_us()
                if due_us is not None and due_us < next_us:
                    next_us = due_us
            # Everything due now has been exchanged, so time always advances.
            next_us = next_us if next_us > now_us else now_us + 1
            self.now_us = next_us if next_us < end_us else end_us
        self.now_us = end_us

    def close(self, reason: str = "done") -> None:
        """End the session properly, with CLOSE and its answer."""
        self.master.close(reason, self.now_us)
        self.run(1_000_000)

    def _exchange(self, now_us: int) -> int | None:
        """Exchange due datagrams until neither side has more to send; return when the slave is due next [µs]."""
        master, slave, forward, feedback = self.master, self.slave, self.forward, self.feedback
        while True:
            for datagram in master.datagrams_to_send():
                forward.push(datagram, len(datagram), now_us)
            for datagram in forward.due(now_us):
                slave.receive_datagram(datagram, MASTER_ADDRESS, now_us)
            # After the arrivals, so that a scene is stepped along the newest line.
            slave_us = slave.next_timer_us()
            if slave_us is not None and now_us >= slave_us:
                slave.tick(now_us)
                slave.account_sent(now_us)
                slave_us = slave.next_timer_us()
            for datagram, _ in slave.datagrams_to_send():
                feedback.push(datagram, len(datagram), now_us)
            arrived = feedback.due(now_us)
            if not arrived:
                return slave_us
            for datagram in arrived:
                master.receive_datagram(datagram, now_us)


def emulated(
    hand: Operator,
    touched: Touchable,
    settings: MasterSettings,
    *,
    forward: ChannelSettings,
    feedback: ChannelSettings,
    seed: int,
    slave: SlaveSettings | None = None,
) -> Loopback:
    """Join a master without a device and a slave that records by emulated channels; the same seed, the same run."""
    to_master, to_slave = (
        Emulator[bytes](channel, np.random.default_rng([seed, number]))
        for number, channel in ((1, feedback), (2, forward))
    )
    return Loopback(
        MasterNode(hand, None, settings, np.random.default_rng([seed, 4])),
        SlaveNode(lambda _: touched, slave or SlaveSettings(record=True), np.random.default_rng([seed, 5])),
        forward=to_slave,
        feedback=to_master,
    )
