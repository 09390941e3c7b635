"""Masters, slaves and a balancer as discrete events: who asks for a session when, and who gets one.

Timers and back-off are those of `SessionSettings` and `protocol.asking`, limits those of `node.reception`, whose token
buckets decide here, too. A slave is one queue with measured costs. Not modelled: lost datagrams, and the forces.
"""

import random
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from math import ceil
from typing import Any, Final

import simpy
from fleet_parts import FleetSettings, Host, Master, Slave

from hapticnet.protocol.asking import FRESH_AFTER_US, GROWTH
from hapticnet.protocol.master_session import DOUBT_MARGIN_US

MASK: Final = (1 << 64) - 1

BIN_S: Final = 0.1
"""HELLOs are counted in bins of this length."""


def mixed(number: int) -> int:
    """Return 64 bits that depend on all bits of a number: a hash (the finaliser of SplitMix64)."""
    number = (number + 0x9E3779B97F4A7C15) & MASK
    number = ((number ^ (number >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    number = ((number ^ (number >> 27)) * 0x94D049BB133111EB) & MASK
    return number ^ (number >> 31)


class Model:
    """A service in virtual time. `env.run` plays it; the methods are what happens to it."""

    def __init__(self, settings: FleetSettings, seed: int) -> None:
        self.env = simpy.Environment()
        self.settings = settings
        self.rng = random.Random(seed)
        self.hosts = [Host(settings) for _ in range(settings.hosts)]
        self.masters = [Master(number, number % settings.addresses) for number in range(settings.masters)]
        self.hellos: Counter[int] = Counter()
        self.outcomes: Counter[str] = Counter()
        self.away: list[float] = []  # how long each loss lasted [s]

    @property
    def slaves(self) -> list[Slave]:
        """Every process."""
        return [slave for host in self.hosts for slave in host.slaves]

    def seat_all(self) -> None:
        """Give every master a session, as after a long quiet time."""
        for master in self.masters:
            master.slave = self._route(master)
            assert master.slave is not None
            master.slave.seated.add(master)

    def fail(self, slaves: list[Slave], *, answers_s: float | None = None) -> None:
        """Let processes die silently. They answer again after `answers_s`, or the balancer notices after `detect_s`."""
        for slave in slaves:
            slave.is_up = False
            lost = self._empty(slave)
            for master in lost:
                self._lose(master)
            again_s = self.settings.detect_s if answers_s is None else answers_s
            self.later(again_s, partial(self._reroute, slave, lost, back=answers_s is not None))

    def stop(self, host: Host) -> None:
        """Take a host out of rotation and stop it in an orderly way: each master gets a CLOSE and asks at once."""
        host.in_rotation = False
        for slave in host.slaves:
            slave.is_up = False
            for master in self._empty(slave):
                self._part(master)
                self.later(self.settings.delay_s, partial(self._ask, master))

    def start(self, host: Host) -> None:
        """Start a host that was stopped."""
        host.in_rotation = True
        for slave in host.slaves:
            slave.start()

    def join(self, master: Master) -> None:
        """Let a master that has no session ask for its first."""
        self._part(master)
        self._ask(master)

    def leave(self, master: Master) -> None:
        """End a session in an orderly way."""
        if master.slave is not None:
            master.slave.seated.discard(master)
            master.slave = None

    def roam(self, master: Master, *, steered: bool) -> None:
        """Give a master another address. Steered by session number, a sealed session does not notice.

        Otherwise its positions reach another process, which does not know the session.
        """
        if steered or master.slave is None:
            return
        master.slave.seated.discard(master)
        master.number += len(self.masters) * self.rng.randrange(1, 1000)  # another place in the hash
        self._lose(master)
        self._stray(master, self._route(master))

    def later(self, delay_s: float, call: Callable[[], Any]) -> None:
        """Call something after a delay [s]."""
        event = self.env.timeout(max(0.0, delay_s))
        event.callbacks.append(lambda _: call())

    def _empty(self, slave: Slave) -> list[Master]:
        lost, slave.seated = slave.seated, set()
        return sorted(lost, key=lambda master: master.number)

    def _lose(self, master: Master) -> None:
        settings, timers = self.settings, self.settings.session
        self._part(master)
        # It last heard a KEEPALIVE. A slave sends one at the first step after each interval.
        silence_s = settings.keepalive_s
        if not settings.sparse:
            silence_s = ceil(silence_s / settings.position_s) * settings.position_s
        master.heard_s = self.env.now - self.rng.random() * silence_s
        asks_s = master.heard_s + 1e-6 * (timers.stale_after_us + timers.ask_again_us)
        losses = master.losses
        self.later(asks_s - self.env.now + self._tick(), lambda: self._ask(master) if master.losses == losses else None)

    def _part(self, master: Master) -> None:
        master.slave = None
        master.lost_s = self.env.now
        master.losses += 1

    def _reroute(self, slave: Slave, lost: list[Master], *, back: bool) -> None:
        """Send the positions of lost sessions to a process that answers: the same one, or those that are left."""
        if back:
            slave.start()
        else:
            slave.host.in_rotation = False
        for master in lost:
            if master.slave is None:
                self._stray(master, slave if back else self._route(master))

    def _stray(self, master: Master, target: Slave | None) -> None:
        """Let a position of a lost session reach a process that does not know it, which answers with RESET."""
        settings = self.settings
        if target is None or not target.is_up:
            return
        master.stray_to = target
        target.strays += 1
        is_stale = self.env.now - master.heard_s > 1e-6 * settings.session.stale_after_us
        stale_s = max(1e-6 * settings.session.stale_interval_us, settings.sample_s)
        period_s = stale_s if is_stale else settings.position_s

        def arrive() -> None:
            if master.slave is not None or master.asking is not None:
                return
            done_s = target.handled_s(self.env.now, settings.costs.reset_us)
            if done_s is None:
                self.later(period_s, arrive)
            else:
                self.later(done_s - self.env.now + settings.delay_s, doubt)

        def doubt() -> None:
            believed_s = master.heard_s + settings.keepalive_s + 1e-6 * DOUBT_MARGIN_US
            self.later(believed_s - self.env.now + self._tick(), partial(self._ask, master))

        self.later(self.rng.random() * period_s + settings.delay_s, arrive)

    def _ask(self, master: Master) -> None:
        if master.slave is None and master.asking is None:
            master.asking = object()
            master.wait_us = self.settings.session.refused_retry_us
            self.env.process(self._asking(master, master.asking))

    def _asking(self, master: Master, token: object) -> Iterator[simpy.Event]:
        """Send HELLOs until there is a session, as `protocol.asking.Asking` does."""
        settings = self.settings.session
        interval_us, tries = settings.hello_interval_us, 0
        while master.asking is token:
            if master.refused:
                master.refused = False
                interval_us, tries = master.wait_us, 0
                master.wait_us = min(2 * master.wait_us, settings.slowest_retry_us)
            else:
                late = master.cookie is not None and self.env.now - master.cookie_s > 1e-6 * FRESH_AFTER_US
                if master.attempt is None or late:
                    master.attempt, master.cookie = object(), None
                    interval_us = interval_us if tries else settings.hello_interval_us
                tries += 1
                if tries > settings.quick_hellos:
                    interval_us = min(round(interval_us * GROWTH), settings.slowest_hello_us)
                master.tried_s = self.env.now
                self._send_hello(master)
            while master.asking is token and not master.refused:
                rest_s = master.tried_s + 1e-6 * interval_us - self.env.now
                if rest_s <= 0.0:
                    break
                yield self.env.timeout(rest_s + self._tick())

    def _send_hello(self, master: Master) -> None:
        self.hellos[int(self.env.now / BIN_S)] += 1
        attempt, cookie = master.attempt, master.cookie
        slave = self._route(master)
        if slave is None or not slave.is_up:  # decided as it is sent, which saves an event for each
            self.outcomes["to a process that is gone"] += 1
            return
        self.later(self.settings.delay_s, lambda: self._take_hello(master, attempt, cookie))

    def _take_hello(self, master: Master, attempt: object, cookie: object) -> None:
        slave, costs = self._route(master), self.settings.costs
        if slave is None or not slave.is_up:
            self.outcomes["to a process that is gone"] += 1
            return
        now_us = round(1e6 * self.env.now)
        answer: Callable[[], None] | None = None
        if cookie is not slave.secret:
            cost_us, outcome, secret = costs.cookie_us, "cookie", slave.secret
            answer = lambda: self._take_cookie(master, attempt, secret)  # noqa: E731
        elif attempt in slave.spent:
            cost_us, outcome = costs.drop_us, "read before"
        elif not slave.hosts.take(master.address, now_us):
            cost_us, outcome = costs.drop_us, "limit of the address"
        elif not slave.all.take(now_us):
            cost_us, outcome = costs.drop_us, "limit of the process"
        elif len(slave.seated) >= self.settings.seats:
            cost_us, outcome = costs.admit_us, "refused"
            answer = lambda: self._take_refusal(master, attempt)  # noqa: E731
        else:
            slave.spent.add(attempt)
            cost_us, outcome = costs.admit_us, "session"
            answer = lambda: self._take_session(master, attempt, slave)  # noqa: E731
        done_s = slave.handled_s(self.env.now, cost_us)
        self.outcomes["queue full" if done_s is None else outcome] += 1
        if done_s is None:
            slave.spent.discard(attempt)
        elif answer is not None:
            self.later(done_s - self.env.now + self.settings.delay_s, answer)

    def _take_cookie(self, master: Master, attempt: object, cookie: object) -> None:
        if master.attempt is not attempt:
            return
        first, master.cookie = master.cookie is None, cookie
        if first:
            master.cookie_s = master.tried_s = self.env.now
            self._send_hello(master)

    def _take_refusal(self, master: Master, attempt: object) -> None:
        if master.attempt is attempt:
            master.attempt = master.cookie = None
            master.refused, master.tried_s = True, self.env.now

    def _take_session(self, master: Master, attempt: object, slave: Slave) -> None:
        if master.attempt is not attempt or not slave.is_up:
            return
        master.asking = master.attempt = master.cookie = None
        master.slave = slave
        slave.seated.add(master)
        if master.stray_to is not None:
            master.stray_to.strays -= 1
            master.stray_to = None
        # Served again: the answer to the first position, which the next sample sends.
        first_s = self.rng.random() * self.settings.sample_s + 2 * self.settings.delay_s
        back_s = self.env.now + first_s + 1e-6 * self.settings.costs.position_us
        self.away.append(back_s - master.lost_s)

    def _route(self, master: Master) -> Slave | None:
        """Return the process that a HELLO reaches: a hash of the address, over the hosts in rotation."""
        for turn in range(200):
            draw = mixed((master.address if self.settings.by_address else master.number) + (turn << 32))
            host = self.hosts[draw % len(self.hosts)]
            if host.in_rotation:
                return host.slaves[draw // len(self.hosts) % len(host.slaves)]
        return None

    def _tick(self) -> float:
        """Return how long after it was due a timer is looked at [s]."""
        return self.rng.random() * self.settings.sample_s
