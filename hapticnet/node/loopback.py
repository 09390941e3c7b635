"""Master, slave and two channels in virtual time: the effects of a network without sockets or waiting."""

from typing import Final

from hapticnet.channel.emulator import Emulator
from hapticnet.node.master import MasterNode
from hapticnet.node.slave import SlaveNode

MASTER_ADDRESS: Final = "loopback"


class Loopback:
    """Run both nodes; every datagram is built, carried by a channel, and parsed.

    Parameters
    ----------
    forward, feedback
        The channels from master to slave and from slave to master.
    start_us
        Virtual time at the start [µs].
    """

    def __init__(
        self,
        master: MasterNode,
        slave: SlaveNode,
        *,
        forward: Emulator[bytes],
        feedback: Emulator[bytes],
        start_us: int = 0,
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
        while self.now_us < end_us and not self.master.finished:
            if self.now_us >= self._next_tick_us:
                self.master.tick(self.now_us)
                self.master.drive(self.now_us)
                self._next_tick_us += self.master.period_us
            self._exchange()
            next_us = self._next_tick_us
            for due_us in (self.forward.next_timer_us(), self.feedback.next_timer_us(), self.slave.next_timer_us()):
                if due_us is not None and due_us < next_us:
                    next_us = due_us
            # Everything due now has been exchanged, so time always advances.
            self.now_us = min(max(next_us, self.now_us + 1), end_us)
        self.now_us = end_us

    def close(self, reason: str = "done") -> None:
        """End the session properly, with CLOSE and its answer."""
        self.master.close(reason, self.now_us)
        self.run(1_000_000)

    def _exchange(self) -> None:
        """Exchange the datagrams that are due, until neither side has anything left to send."""
        now_us = self.now_us
        busy = True
        while busy:
            busy = False
            for datagram in self.master.datagrams_to_send():
                self.forward.push(datagram, len(datagram), now_us)
            for datagram in self.forward.due(now_us):
                self.slave.receive_datagram(datagram, MASTER_ADDRESS, now_us)
            # After what arrives now, so that a scene is stepped along the newest line.
            slave_timer_us = self.slave.next_timer_us()
            if slave_timer_us is not None and now_us >= slave_timer_us:
                self.slave.tick(now_us)
                self.slave.settle(now_us)
            for datagram, _ in self.slave.datagrams_to_send():
                self.feedback.push(datagram, len(datagram), now_us)
            for datagram in self.feedback.due(now_us):
                self.master.receive_datagram(datagram, now_us)
                busy = True
