"""Settings of one direction of an emulated network, each with its text form in a channel specification."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError

LONGEST_US: Final = 3_600_000_000
"""Longest time [µs] in a channel's settings: one hour, far beyond any link that carries touch."""

FASTEST_BIT_PER_S: Final = 10**12  # fastest bottleneck [bit/s]: 1 Tbit/s, where a packet takes less than a nanosecond

_TIME_UNITS: Final = {"us": 1, "µs": 1, "ms": 1_000, "s": 1_000_000}
_RATE_UNITS: Final = {"bit/s": 1, "kbit/s": 10**3, "mbit/s": 10**6, "gbit/s": 10**9}
_QUANTITY: Final = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(\D*)", re.ASCII | re.IGNORECASE)


def parse_time_us(text: str) -> int:
    """Return a time such as 20ms in whole microseconds."""
    return _whole(
        text, _TIME_UNITS, LONGEST_US, f"a time such as 20ms, in us, ms or s, up to {format_time(LONGEST_US)}"
    )


def parse_rate_bit_per_s(text: str) -> int:
    """Return a rate such as 1Mbit/s in whole bits per second."""
    expected = f"a rate such as 1Mbit/s, in bit/s, kbit/s, Mbit/s or Gbit/s, up to {format_rate(FASTEST_BIT_PER_S)}"
    return _whole(text, _RATE_UNITS, FASTEST_BIT_PER_S, expected)


def parse_share(text: str) -> float:
    """Return a share such as 2% or 0.02 as a fraction of 1."""
    number, unit = _number_and_unit(text)
    # float("7") / 100 is the double nearest to 0.07; 7 * 0.01 is not.
    share = number / 100.0 if unit == "%" else number
    if unit not in ("", "%") or not 0.0 <= share <= 1.0:
        raise SettingsError(f'"{text[:60]}" is not a share such as 2% or 0.02, from 0% to 100%')
    return share


def format_time(time_us: int) -> str:
    """Return a time as a whole number in the largest possible unit."""
    return _in_largest_unit(time_us, {"s": 1_000_000, "ms": 1_000, "us": 1})


def time_in_words(time_us: int) -> str:
    """Return a time as `format_time` does, with a space before the unit, for sentences."""
    return re.sub(r"(?<=\d)(?=[a-z])", " ", format_time(time_us))


def format_rate(rate_bit_per_s: int) -> str:
    """Return a rate as a whole number in the largest possible unit."""
    return _in_largest_unit(rate_bit_per_s, {"Gbit/s": 10**9, "Mbit/s": 10**6, "kbit/s": 10**3, "bit/s": 1})


def format_share(share: float) -> str:
    """Return a share in percent if that reads back as the same number, else as a fraction of 1."""
    percent = f"{share * 100.0:.12g}"
    return f"{percent}%" if float(percent) / 100.0 == share else repr(share)


def _number_and_unit(text: str) -> tuple[float, str]:
    match = _QUANTITY.fullmatch(text.strip())
    return (float(match[1]), match[2].strip().lower()) if match else (float("nan"), "")


def _whole(text: str, units: Mapping[str, int], largest: int, expected: str) -> int:
    number, unit = _number_and_unit(text)
    value = number * units.get(unit, float("nan"))
    # NaN compares false with everything, so this form rejects it too.
    if not 0.0 <= value <= largest:
        raise SettingsError(f'"{text[:60]}" is not {expected}')
    return round(value)


def _in_largest_unit(value: int, units: Mapping[str, int]) -> str:
    unit = next(unit for unit, size in units.items() if value % size == 0)
    return f"{value // units[unit]}{unit}"


BLOCK: Final = 1024  # random numbers drawn at a time; drawing one at a time would dominate the cost of a packet


@dataclass(frozen=True, slots=True)
class BernoulliLoss:
    """Each packet is lost independently with the same probability."""

    probability: float  # probability that a packet is lost, 0 to 1

    def __post_init__(self) -> None:
        check_parameter("loss probability", self.probability, 0, 1)

    @property
    def mean(self) -> float:
        """Long-term share of lost packets."""
        return self.probability

    def describe(self) -> str:
        """Return the text that `parse_loss` reads."""
        return format_share(self.probability)

    def fates(self, rng: np.random.Generator) -> Iterator[bool]:
        """Yield whether each packet in turn is lost."""
        while True:
            yield from (rng.random(BLOCK) < self.probability).tolist()


@dataclass(frozen=True, slots=True)
class GilbertElliottLoss:
    """Losses in bursts: a Markov chain with a good and a bad state that takes one step per packet.

    Gilbert, "Capacity of a burst-noise channel", Bell System Technical Journal 39 (1960) 1253–1265, with k = 1;
    Elliott, "Estimates of error rates for codes on burst-noise channels", same journal 42 (1963) 1977–1997, with
    k below 1. The chain is in the bad state for a share p / (p + r) of the packets, so the stationary loss rate is
    ``(1 − h)·p/(p + r) + (1 − k)·r/(p + r)``; a burst in the bad state lasts 1/r packets on average. The chain starts
    in its stationary distribution.
    """

    p: float  # probability of a transition from the good to the bad state
    r: float  # probability of a transition from the bad to the good state
    h: float = 0.0  # probability that a packet is delivered in the bad state; 0 by default
    k: float = 1.0  # probability that a packet is delivered in the good state; 1 by default

    def __post_init__(self) -> None:
        for name, share in (("p", self.p), ("r", self.r), ("h", self.h), ("k", self.k)):
            check_parameter(f"loss gilbert: {name}", share, 0, 1)
        if self.p + self.r == 0.0:
            raise SettingsError("loss gilbert: p and r are both 0; the state would never change")

    @property
    def mean(self) -> float:
        """Long-term share of lost packets."""
        bad = self.p / (self.p + self.r)
        return (1.0 - self.h) * bad + (1.0 - self.k) * (1.0 - bad)

    def describe(self) -> str:
        """Return the text that `parse_loss` reads."""
        return "gilbert:" + ",".join(format_share(share) for share in (self.p, self.r, self.h, self.k))

    def fates(self, rng: np.random.Generator) -> Iterator[bool]:
        """Yield whether each packet in turn is lost."""
        to_bad, stay_bad, loss_good, loss_bad = self.p, 1.0 - self.r, 1.0 - self.k, 1.0 - self.h
        bad = bool(rng.random() < self.p / (self.p + self.r))
        while True:
            for loss_draw, state_draw in rng.random((BLOCK, 2)).tolist():
                yield loss_draw < (loss_bad if bad else loss_good)
                bad = state_draw < (stay_bad if bad else to_bad)


Loss: TypeAlias = BernoulliLoss | GilbertElliottLoss


def parse_loss(text: str) -> Loss:
    """Return the loss written as ``2%`` or ``gilbert:p,r[,h[,k]]``; SettingsError if invalid."""
    model, colon, arguments = text.partition(":")
    if not colon:
        return BernoulliLoss(parse_share(text))
    shares = arguments.split(",")
    if model == "gilbert" and 2 <= len(shares) <= 4:
        return GilbertElliottLoss(*(parse_share(share) for share in shares))
    raise SettingsError(f'"{text[:60]}" is not a loss such as 2% or gilbert:p,r[,h[,k]]')


Distribution: TypeAlias = Literal["normal", "uniform", "pareto"]

DISTRIBUTIONS: Final = get_args(Distribution)
PARETO_SHAPE: Final = 3.0  # α below: the smallest whole number with a standard deviation, so the heaviest tail


@dataclass(frozen=True, slots=True, kw_only=True)
class Jitter:
    """A random delay, never negative, added to the constant one.

    Queues and retransmissions only add to the propagation time, so each distribution starts at 0. All are scaled to the
    same standard deviation σ, so one can replace another:

    ========== ==================================================================== ===================
    uniform    from 0 to σ·√12                                                      mean 1.732 σ
    normal     half-normal, ``|N(0, s)|`` with s = σ/√(1 − 2/π)                     mean 1.324 σ
    pareto     Lomax (Pareto II): survival ``(1 + x/λ)^−α`` of the delay x, with    mean σ·√((α − 2)/α)
               λ = σ·(α − 1)·√((α − 2)/α)
    ========== ==================================================================== ===================
    """

    distribution: Distribution  # one of normal, uniform, pareto
    deviation_us: int  # standard deviation σ [µs]

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise SettingsError(f'jitter is "{self.distribution}"; it must be one of {", ".join(DISTRIBUTIONS)}')
        check_parameter("jitter deviation", self.deviation_us, 0, LONGEST_US, "µs")

    def describe(self) -> str:
        """Return the text that `parse_jitter` reads."""
        return f"{self.distribution}:{format_time(self.deviation_us)}"

    def delays_us(self, rng: np.random.Generator) -> Iterator[int]:
        """Yield the delay [µs] of each packet in turn."""
        alpha = PARETO_SHAPE
        while True:
            match self.distribution:
                case "uniform":
                    block = rng.random(BLOCK) * math.sqrt(12.0)
                case "normal":
                    block = np.abs(rng.standard_normal(BLOCK)) / math.sqrt(1.0 - 2.0 / math.pi)
                case "pareto":
                    block = rng.pareto(alpha, BLOCK) * ((alpha - 1.0) * math.sqrt((alpha - 2.0) / alpha))
            yield from np.rint(block * self.deviation_us).astype(np.int64).tolist()


def parse_jitter(text: str) -> Jitter:
    """Return the jitter written as ``normal:5ms``, ``uniform:5ms`` or ``pareto:5ms``; SettingsError if invalid."""
    match text.split(":"):
        case [("normal" | "uniform" | "pareto") as distribution, deviation]:
            return Jitter(distribution=distribution, deviation_us=parse_time_us(deviation))
    raise SettingsError(f'"{text[:60]}" is not a jitter such as normal:5ms, uniform:5ms or pareto:5ms')


DEFAULT_HOLD_BACK_US: Final = 10_000
"""Time [µs] a reordered packet is held back: ten packets of a 1 kHz stream overtake it."""

DEFAULT_QUEUE_US: Final = 100_000  # longest time [µs] a packet waits for the bottleneck


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelSettings:
    """Effects of one direction of a network; none by default.

    The effects apply in this order: loss, duplication, bottleneck, delay with jitter and reordering. A lost packet is
    not duplicated. A duplicate follows its original through the bottleneck, like a retransmission after a lost
    acknowledgement, so the output never exceeds the rate.

    Packets keep their order, also with jitter: each waits for those before it, as in a queue. Only
    `reorder_probability` holds back single packets while later ones overtake.
    """

    delay_us: int = 0  # shortest time [µs] from sending to delivery
    jitter: Jitter | None = None  # random delay added to it
    loss: Loss | None = None
    reorder_probability: float = 0.0  # probability that a packet is held back, 0 to 1
    hold_back_us: int = DEFAULT_HOLD_BACK_US  # additional delay [µs] of a packet that is held back
    duplicate_probability: float = 0.0  # probability that a packet arrives twice, 0 to 1
    # Rate of the bottleneck [bit/s], counting UDP and IPv4 headers; None: no bottleneck
    rate_bit_per_s: int | None = None
    # Longest time [µs] a packet waits for the bottleneck; one that would wait longer is dropped. The limit is a time
    # because time is what a queue costs a haptic loop, at any packet size and rate.
    queue_us: int = DEFAULT_QUEUE_US

    def __post_init__(self) -> None:
        rate = FASTEST_BIT_PER_S if self.rate_bit_per_s is None else self.rate_bit_per_s
        check_parameter("channel delay_us", self.delay_us, 0, LONGEST_US)
        check_parameter("channel reorder_probability", self.reorder_probability, 0, 1)
        check_parameter("channel hold_back_us", self.hold_back_us, 1, LONGEST_US)
        check_parameter("channel duplicate_probability", self.duplicate_probability, 0, 1)
        check_parameter("channel rate_bit_per_s", rate, 1, FASTEST_BIT_PER_S)
        check_parameter("channel queue_us", self.queue_us, 1, LONGEST_US)

    @property
    def is_perfect(self) -> bool:
        """Whether every packet is delivered once, in order, at the time it is sent."""
        return (
            self.delay_us == 0
            and (self.jitter is None or self.jitter.deviation_us == 0)
            and (self.loss is None or self.loss.mean == 0.0)
            and self.reorder_probability == 0.0
            and self.duplicate_probability == 0.0
            and self.rate_bit_per_s is None
        )

    def describe(self) -> str:
        """Return the settings as one line that `parse_channel` can read."""
        parts = []
        if self.delay_us:
            parts.append(f"delay={format_time(self.delay_us)}")
        if self.jitter is not None:
            parts.append(f"jitter={self.jitter.describe()}")
        if self.loss is not None:
            parts.append(f"loss={self.loss.describe()}")
        if self.reorder_probability or self.hold_back_us != DEFAULT_HOLD_BACK_US:
            hold_back = format_time(self.hold_back_us)
            parts.append(f"reorder={format_share(self.reorder_probability)}:{hold_back}")
        if self.duplicate_probability:
            parts.append(f"duplicate={format_share(self.duplicate_probability)}")
        if self.rate_bit_per_s is not None:
            parts.append(f"rate={format_rate(self.rate_bit_per_s)}")
        if self.queue_us != DEFAULT_QUEUE_US:
            parts.append(f"queue={format_time(self.queue_us)}")
        return ",".join(parts) or "perfect"
