"""How long the steps of scenes, operators, devices and codecs take, and which of them are too slow for their rate."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from hapticnet.codec.base import Codec
from hapticnet.protocol.stats import Distribution

Clock: TypeAlias = Callable[[], int]  # returns a time [µs] that passes while code runs
WINDOW_US: Final = 900_000  # least time [µs] over which steps are judged
LARGEST_SHARE_OVER: Final = 0.01
"""Share of the time by which steps may exceed the time between two positions: so many positions miss their answer."""

LARGEST_SHARE: Final = 0.8  # share of the time that steps may take in all
WINDOWS_IN_A_ROW: Final = 2
"""Windows in a row that must be bad: the first steps of a class may take long, and a machine may be busy for once."""


def no_wait() -> int:
    """Return 0, as in virtual time: no other process takes the processor away."""
    return 0


@dataclass(frozen=True, slots=True)
class StepsTooSlow:
    """The steps of some code take so long that positions go unanswered or ticks are missed; told once of each."""

    what: str  # the code, such as "scene own.py:Mine"
    mean_us: float  # of a step, on average and at most, and what its rate leaves; of the newest window
    longest_us: float
    period_us: float
    positions: int  # that arrived in that window, and of them not answered; 0 at a master
    unanswered: int

    def __str__(self) -> str:
        """Return it in words for a person."""
        mean, longest, period = (f"{us / 1000:.3g} ms" for us in (self.mean_us, self.longest_us, self.period_us))
        missed = f": {self.unanswered:,} of {self.positions:,} positions were not answered" if self.unanswered else ""
        return f"{self.what} is too slow: a step takes {mean}, at most {longest}, and is due every {period}{missed}"


class StepTime:
    """The time of the steps of one piece of code: call `begin` before and `end` after each."""

    def __init__(self, what: str, clock: Clock) -> None:
        self.what = what
        self.took = Distribution()  # time of each step [µs]
        self.warning: StepsTooSlow | None = None  # what was told; None if the steps never were too slow
        self._clock = clock
        self._began_us = 0
        self._bad_windows = 0
        self.count = self.unanswered = 0  # positions of this window that were not answered; the owner counts them
        self.total_us = self.over_us = self.longest_us = self.period_us = 0.0

    def begin(self) -> None:
        """Note that a step begins."""
        self._began_us = self._clock()

    def end(self, period_us: float) -> None:
        """Note that a step ends, and the time [µs] between two steps at the rate that was granted."""
        took_us = self._clock() - self._began_us
        self.took.add(took_us)
        self.count += 1
        self.total_us += took_us
        self.period_us = period_us
        if took_us > period_us:
            self.over_us += took_us - period_us
        if took_us > self.longest_us:
            self.longest_us = float(took_us)

    @property
    def is_slow(self) -> bool:
        """Whether the steps have been too slow for the last windows."""
        return self._bad_windows >= WINDOWS_IN_A_ROW

    @property
    def was_slow(self) -> bool:
        """Whether the steps were too slow in the last window."""
        return self._bad_windows > 0

    def judge(self, is_bad: bool) -> StepsTooSlow | None:
        """End a window; return what to tell, the first time that the steps are too slow."""
        self._bad_windows = self._bad_windows + 1 if is_bad else 0
        news = None
        if self.is_slow and self.warning is None:
            mean_us, positions = self.total_us / max(1, self.count), self.count + self.unanswered
            news = self.warning = StepsTooSlow(
                self.what, mean_us, self.longest_us, self.period_us, positions, self.unanswered
            )
        self.count = self.unanswered = 0
        self.total_us = self.over_us = self.longest_us = self.period_us = 0.0
        return news


class _Untimed(StepTime):
    """Steps that are not timed."""

    def begin(self) -> None:
        """Do nothing."""

    def end(self, period_us: float) -> None:
        """Do nothing."""


NOT_TIMED: Final = _Untimed("", lambda: 0)


class StepTimes:
    """The times of all code that a node steps; without a `clock`, as in virtual time, none are taken."""

    def __init__(self, clock: Clock | None) -> None:
        self._clock = clock
        self._times: dict[str, StepTime] = {}
        self._since_us: int | None = None
        self._waited_us = 0

    def of(self, what: str) -> StepTime:
        """Return the record for the times of a piece of code."""
        if self._clock is None:
            return NOT_TIMED
        if what not in self._times:
            self._times[what] = StepTime(what, self._clock)
        return self._times[what]

    def of_codec(self, codec: Codec) -> StepTime:
        """Return the record for the times of a codec; only users' codecs are timed."""
        source = getattr(codec, "source", None)
        return NOT_TIMED if source is None else self.of(f"codec {source}")

    def __iter__(self) -> Iterator[StepTime]:
        """Return all times."""
        return iter(self._times.values())

    @property
    def reported(self) -> list[StepsTooSlow]:
        """The reports so far."""
        return [each.warning for each in self if each.warning is not None]

    @property
    def explains_delay(self) -> bool:
        """Whether slow steps made the process fall behind in the last window."""
        return any(each.was_slow for each in self)

    def check(self, now_us: int, waited_us: Clock = no_wait) -> list[StepsTooSlow] | None:
        """Judge the time since the last call; return the report, None while the window lasts.

        `waited_us` returns this thread's total wait [µs] for a processor: on a busy machine, steps that
        are interrupted also take long, but are not to blame.
        """
        since_us = self._since_us
        if since_us is not None and 0 <= now_us - since_us < WINDOW_US:
            return None
        self._since_us = now_us
        before_us, self._waited_us = self._waited_us, waited_us()
        lost_us = self._waited_us - before_us
        window_us = 0 if since_us is None else now_us - since_us
        all_us = sum(each.total_us for each in self)
        slowest = max(self, key=lambda each: each.total_us, default=None)
        news = []
        for each in tuple(self):
            bad = each.over_us - lost_us > LARGEST_SHARE_OVER * window_us or (
                each is slowest and all_us - lost_us > LARGEST_SHARE * window_us
            )
            if (told := each.judge(bad and window_us > 0)) is not None:
                news.append(told)
        return news

    def all_took(self) -> Distribution:
        """Return the times of all steps together [µs]."""
        took = Distribution()
        for each in self:
            took.absorb(each.took.counts())
        return took

    def report(self) -> dict[str, Any]:
        """Return the report for JSON, by the timed code."""
        return {each.what: {**each.took.report(), "too_slow": each.warning is not None} for each in self}
