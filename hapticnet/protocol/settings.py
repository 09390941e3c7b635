"""Timings of a session, shared by both ends."""

from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from hapticnet.errors import SettingsError
from hapticnet.perception import PAPER_FLOOR_N, WeberLaw
from hapticnet.protocol.messages import KEEPALIVE_US

SPARSE_KEEPALIVES: Final = 2
IDLE_KEEPALIVES: Final = 10
"""Longest silence, in keepalive intervals, of a session with few positions, and while no force is felt in it."""


class Entropy(Protocol):
    """A source of unpredictable numbers.

    `runtime.system.SystemEntropy` asks the operating system. In virtual time, use a seeded `numpy.random.Generator`.
    """

    def integers(self, low: int, high: int, /) -> Any:
        """Return a whole number from `low` to `high` - 1."""
        ...


def random_bytes(rng: Entropy, count: int) -> bytes:
    """Return `count` unpredictable bytes (a multiple of four)."""
    return b"".join(int(rng.integers(0, 1 << 32)).to_bytes(4, "big") for _ in range(count // 4))


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairSettings:
    """The slave's measures against loss. Defaults from bench/measure/repair.py (docs/build/decisions.md, 0010)."""

    replaces: bool = True  # whether each of the three ways is used
    repeats: bool = True
    paces: bool = True
    doubt_limit: float = 0.02  # probability of an error above a JND from which the slave repeats
    # time [µs] from a datagram to its repetition. An error of m JNDs is repeated after the longest time over m: large
    # changes first. A wait lets short bursts pass.
    shortest_wait_us: int = 2_000
    longest_wait_us: int = 6_000
    repeats_per_position: float = 0.12  # most repeats for each position that arrives; bounds the bytes
    shortest_keepalive_us: int = 2_000  # shortest longest silence [µs]
    silences_per_s: float = 1.0 / 900.0  # how often losses may look like a dead link: once in a quarter of an hour
    complete_above: float = 0.005  # share of lost datagrams above which every update decodes on its own


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSettings:
    """Timings [µs] and limits of sessions."""

    # interval of HELLOs while a master asks for a session: at first, and, after `quick_hellos` with growing
    # intervals, the longest
    hello_interval_us: int = 100_000
    slowest_hello_us: int = 1_000_000
    quick_hellos: int = 20
    refused_retry_us: int = 1_000_000  # wait after a refusal before asking again; doubles up to the longest
    slowest_retry_us: int = 16_000_000
    stale_after_us: int = 200_000  # silence after which a master declares the link stale; the age limit of a held force
    stale_interval_us: int = 50_000  # longest time between two positions while the link is stale
    ask_again_us: int = 1_000_000  # how long a link is stale before the master also asks for another session
    # age of the position that a force answers, on the master's clock, beyond which the force is not applied
    max_age_us: int = 1_000_000
    # longest silence of a slave while positions arrive and there is no loss; with loss, `repair`
    # shortens it. Three keepalives in a row may be lost; the fourth still comes before the link goes stale.
    keepalive_us: int = 45_000
    ack_delay_us: int = 20_000  # wait of a master with few positions before it sends one to acknowledge
    close_interval_us: int = 50_000  # how often, and how many times, a master sends CLOSE
    close_tries: int = 5
    keep_us: int = 30_000_000  # silence after which a slave forgets an open session and its scene
    half_open_us: int = 5_000_000  # silence after which a slave forgets a session whose master never sent a position
    gives_way_us: int = 1_000_000  # silence after which a session may be evicted for another identity
    most_sessions: int = 64  # at once, and the limit for one key or, without keys, one host
    most_per_identity: int = 16
    first_sequence: int = 0  # sequence number of the first datagram of a session
    repair: RepairSettings = field(default_factory=RepairSettings)  # the slave's measures against loss

    @property
    def sparse_keepalive_us(self) -> int:
        """`keepalive_us` when positions are sent only when they matter: one in a row may be lost, not three."""
        return SPARSE_KEEPALIVES * self.keepalive_us

    @property
    def idle_keepalive_us(self) -> int:
        """Like `sparse_keepalive_us`, while no force is felt."""
        return IDLE_KEEPALIVES * self.keepalive_us

    def stale_after(self, idle: bool) -> int:
        """Return `stale_after_us`, longer while next to no force is applied, so that nothing has to be released."""
        return 5 * self.stale_after_us if idle else self.stale_after_us

    def __post_init__(self) -> None:
        KEEPALIVE_US.check(self.keepalive_us)
        if 4 * self.keepalive_us > self.stale_after_us:
            raise SettingsError(
                f"keepalive interval is {self.keepalive_us} µs; it must be at most a quarter of the age limit of"
                f" {self.stale_after_us} µs, or silence would look like a dead link"
            )


LARGEST_N: Final = PAPER_FLOOR_N
"""Largest threshold [N] that is used here: 0.025 N, the smallest force difference that the paper's subjects noticed.
A large JND would otherwise let a noticeable force stay on a finger for the length of that silence."""

SLAVES_SHARE: Final = 0.25
MASTERS_SHARE: Final = 2.0
"""Below these shares of the threshold at 0 N the slave and the master are idle: the master below 0.05 N, 1 % of the
largest force at the device, and about what the force loop leaves as an error (0.03 N)."""


def slave_idle_below_n(law: WeberLaw) -> float:
    """Return the force [N], true and held, below which the slave sends keepalives more rarely."""
    return SLAVES_SHARE * min(law.threshold_n(0.0), LARGEST_N)


def master_idle_below_n(law: WeberLaw) -> float:
    """Return the applied force [N] below which the master waits longer for a sign of life."""
    return MASTERS_SHARE * min(law.threshold_n(0.0), LARGEST_N)
