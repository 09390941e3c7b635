"""What a service is made of, in the model of `fleet_model`: its settings and costs, processes, hosts and masters."""

from collections import deque
from dataclasses import dataclass, field

from hapticnet.node.reception import ALL_REQUESTS_AT_ONCE, ALL_REQUESTS_PER_S, REQUESTS_AT_ONCE, REQUESTS_PER_S
from hapticnet.protocol.buckets import Buckets, TokenBucket
from hapticnet.protocol.settings import SessionSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """What a slave's process needs: CPU [µs] for each datagram, and room for datagrams that wait.

    `cookie_us`: a HELLO without cookie. `drop_us`: one with a cookie that is not read. `admit_us`: one that gets a
    session. `reset_us`: a position of an unknown session. `position_us`: one of a known session.
    """

    cookie_us: float = 0.0
    drop_us: float = 0.0
    admit_us: float = 0.0
    reset_us: float = 0.0
    position_us: float = 0.0
    queue: int = 1 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """A service.

    Attributes
    ----------
    hosts, processes
        Machines, and processes of each; a session number tells which process holds the session.
    addresses
        Source addresses that the masters share evenly; requests are limited for each.
    delay_s
        One way [s].
    sample_s, position_s, sparse
        Period of a master's samples, and of its positions [s]; longer if only those are sent that matter (`sparse`).
    detect_s
        How long a balancer goes on sending datagrams to a host that has failed [s].
    by_address
        Whether the balancer hashes the address of a HELLO without its port.
    per_address, in_all
        Requests that a process reads: a second, and at once.
    """

    masters: int
    addresses: int
    hosts: int = 1
    processes: int = 1
    delay_s: float = 50e-6
    sample_s: float = 1e-3
    position_s: float = 1e-3
    sparse: bool = False
    detect_s: float = 0.0
    by_address: bool = False
    seats: int = 1 << 30
    per_address: tuple[float, float] = (REQUESTS_PER_S, REQUESTS_AT_ONCE)
    in_all: tuple[float, float] = (ALL_REQUESTS_PER_S, ALL_REQUESTS_AT_ONCE)
    costs: Costs = field(default_factory=Costs)
    session: SessionSettings = field(default_factory=SessionSettings)

    @property
    def keepalive_s(self) -> float:
        """Longest silence of a slave [s]."""
        return 1e-6 * (self.session.sparse_keepalive_us if self.sparse else self.session.keepalive_us)


class Slave:
    """One process of a host."""

    def __init__(self, fleet: FleetSettings, host: "Host") -> None:
        self.host = host
        self.fleet = fleet
        self.seated: set[Master] = set()
        self.strays = 0  # masters that send it positions of sessions it does not know
        self.most_busy = 0.0
        self.dropped = 0
        self.start()

    def start(self) -> None:
        """Begin with nothing, as a process does."""
        self.is_up = True
        self.secret = object()  # of its cookies
        self.spent: set[object] = set()
        self.hosts = Buckets(*self.fleet.per_address)
        self.all = TokenBucket(*self.fleet.in_all)
        self._free_s = 0.0
        self._waiting: deque[float] = deque()

    def handled_s(self, now_s: float, cost_us: float) -> float | None:
        """Return when a datagram that arrives now is answered; None if the queue is full. Positions share the CPU."""
        fleet, costs = self.fleet, self.fleet.costs
        stale_s = 1e-6 * fleet.session.stale_interval_us
        busy = 1e-6 * (len(self.seated) * costs.position_us / fleet.position_s + self.strays * costs.reset_us / stale_s)
        self.most_busy = max(self.most_busy, busy)
        while self._waiting and self._waiting[0] <= now_s:
            self._waiting.popleft()
        if len(self._waiting) >= costs.queue:
            self.dropped += 1
            return None
        self._free_s = max(now_s, self._free_s) + 1e-6 * cost_us / max(0.02, 1.0 - busy)
        self._waiting.append(self._free_s)
        return self._free_s


class Host:
    """A machine: its processes, and whether the balancer sends new masters there."""

    def __init__(self, fleet: FleetSettings) -> None:
        self.in_rotation = True
        self.slaves = [Slave(fleet, self) for _ in range(fleet.processes)]


class Master:
    """A master: its session, or how far it has come in asking for one."""

    def __init__(self, number: int, address: int) -> None:
        self.number = number
        self.address = address
        self.slave: Slave | None = None
        self.stray_to: Slave | None = None
        self.asking: object | None = None
        self.attempt: object | None = None
        self.cookie: object | None = None
        self.cookie_s = self.tried_s = self.heard_s = 0.0
        self.refused = False
        self.wait_us = 0
        self.lost_s = 0.0
        self.losses = 0
