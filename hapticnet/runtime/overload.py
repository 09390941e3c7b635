"""Signs that this machine is too busy: shown on the console while they last, and kept for the report."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from hapticnet.node.step_times import StepTimes
from hapticnet.runtime.nonblocking_log import STDERR
from hapticnet.runtime.system import OTHER, policy
from hapticnet.runtime.timer import Ticker
from hapticnet.runtime.udp import UdpPort

WINDOW_US: Final = 900_000  # least time [µs] over which ages and missed ticks are judged
LARGEST_QUEUE_AGE_US: Final = 5_000  # age [µs] of datagrams, 99th percentile, above which the user is warned
LARGEST_MISSED_SHARE: Final = 0.01  # share of missed ticks above which the user is warned
TELL_EVERY_US: Final = 10_000_000  # time [µs] between two lines about the same sign


class Overload:
    """Watch a socket and, if there is one, a ticker; `say` is called with each warning for the user."""

    def __init__(self, scheduling: str, say: Callable[[str], None]) -> None:
        self.scheduling = scheduling  # the scheduling that was granted, as `prefer_realtime` describes it
        self._say = say
        self.port: UdpPort | None = None
        self.ticker: Ticker | None = None
        self._times: StepTimes | None = None
        self._since_us: int | None = None
        self._missed = self._ticks = 0
        self._dropped = 0
        self._told_us: dict[str, int] = {}
        refusal = scheduling.removeprefix(policy(scheduling)).removeprefix(" (")
        if refusal:
            say(f"no real-time scheduling, so a busy machine disturbs it: {refusal.removesuffix(')')}")

    def attach(self, port: UdpPort, ticker: Ticker | None = None, times: StepTimes | None = None) -> None:
        """Set the watched socket and ticker, and the times of steps, which may be the cause."""
        self.port, self.ticker, self._times = port, ticker, times

    @property
    def is_realtime(self) -> bool:
        """Whether this process has real-time scheduling."""
        return policy(self.scheduling) != OTHER

    def check(self, now_us: int) -> None:
        """Report problems, if any; call this a few times a second."""
        if self.port is None or (self._since_us is not None and now_us - self._since_us < WINDOW_US):
            return
        starts = self._since_us is None
        self._since_us = now_us
        ages = sorted(self.port.queue.take_ages())
        missed, ticks = self._count_ticks()
        if starts:  # events during the start are not overload
            self._dropped = self.port.queue.count_drops()
            return
        if self._times is not None and self._times.explains_delay:
            return  # the machine is not the cause; the node reports the cause
        # A single late datagram is a hiccup, not a queue.
        if len(ages) > 1 and (age_us := ages[-max(2, len(ages) // 100 + 1)]) > LARGEST_QUEUE_AGE_US:
            self._tell("age", now_us, f"datagrams wait {age_us / 1000:.1f} ms until this process reads them")
        if missed > LARGEST_MISSED_SHARE * ticks:
            self._tell("missed", now_us, f"{missed:,} of {ticks:,} ticks were missed within a second")
        dropped = self.port.queue.count_drops()
        if dropped > self._dropped and self._tell(
            "drops", now_us, f"the system dropped {dropped - self._dropped:,} datagrams that were not read in time"
        ):
            self._dropped = dropped

    def report(self) -> dict[str, Any]:
        """Return the report for JSON, over the whole run; None where not applicable."""
        ages = self.port.queue.age if self.port is not None else None
        ticker = self.ticker
        return {
            "queue_age_p50_us": ages.percentile(50) if ages else None,
            "queue_age_p99_us": ages.percentile(99) if ages else None,
            "kernel_drops": self.port.queue.count_drops() if self.port is not None else None,
            "missed_ticks": ticker.missed if ticker else None,
            "missed_share": ticker.missed / max(1, ticker.missed + ticker.lateness.count) if ticker else None,
            "scheduling": self.scheduling,
            "lines_left_out": STDERR.left_out,
        }

    def _count_ticks(self) -> tuple[int, int]:
        """Return missed and all ticks since the last call."""
        if self.ticker is None:
            return 0, 0
        missed, ticks = self.ticker.missed, self.ticker.missed + self.ticker.lateness.count
        since = missed - self._missed, ticks - self._ticks
        self._missed, self._ticks = missed, ticks
        return since

    def _tell(self, sign: str, now_us: int, line: str) -> bool:
        told_us = self._told_us.get(sign)
        if told_us is not None and now_us - told_us < TELL_EVERY_US:
            return False
        self._told_us[sign] = now_us
        self._say(f"overloaded: {line}")
        return True


def signs(account: Mapping[str, Any]) -> list[str]:
    """Return the signs, in words, of a too busy machine in the `report` of a whole run."""
    found = []
    age_us, missed, drops = account["queue_age_p99_us"], account["missed_share"], account["kernel_drops"]
    if missed is not None and missed > LARGEST_MISSED_SHARE:
        found.append(f"{account['missed_ticks']:,} ticks ({missed:.1%}) were missed")
    if age_us is not None and age_us > LARGEST_QUEUE_AGE_US:
        found.append(f"1 % of the datagrams waited more than {age_us / 1000:.1f} ms to be read")
    if drops:
        found.append(f"the system dropped {drops:,} datagrams")
    return found
