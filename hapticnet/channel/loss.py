"""Loss models of a channel: independent, in bursts, or by an explicit pattern."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from hapticnet.channel.quantities import format_share, parse_share
from hapticnet.checks import check_parameter
from hapticnet.errors import SettingsError

BLOCK: Final = 1024
"""Random numbers drawn at a time; drawing one at a time would dominate the cost of a packet."""

LONGEST_PATTERN: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class BernoulliLoss:
    """Each packet is lost independently with the same probability.

    Attributes
    ----------
    probability
        Probability that a packet is lost, 0 to 1.

    Raises
    ------
    SettingsError
        If the probability is not between 0 and 1.
    """

    probability: float

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

    Attributes
    ----------
    p
        Probability of a transition from the good to the bad state.
    r
        Probability of a transition from the bad to the good state.
    h
        Probability that a packet is delivered in the bad state; 0 by default.
    k
        Probability that a packet is delivered in the good state; 1 by default.

    Raises
    ------
    SettingsError
        If a probability is not between 0 and 1, or p and r are both 0, which has no stationary state.
    """

    p: float
    r: float
    h: float = 0.0
    k: float = 1.0

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


@dataclass(frozen=True, slots=True)
class PatternLoss:
    """Losses by an explicit pattern, repeated forever.

    Attributes
    ----------
    pattern
        One character per packet: 1 is lost, 0 is delivered.

    Raises
    ------
    SettingsError
        If the pattern is empty, too long or contains characters other than 0 and 1.
    """

    pattern: str

    def __post_init__(self) -> None:
        if not 1 <= len(self.pattern) <= LONGEST_PATTERN or set(self.pattern) - {"0", "1"}:
            raise SettingsError(
                f'loss pattern is "{self.pattern[:40]}"; it must be 1 to {LONGEST_PATTERN} characters 0 '
                "(delivered) or 1 (lost), such as 0010110"
            )

    @property
    def mean(self) -> float:
        """Long-term share of lost packets."""
        return self.pattern.count("1") / len(self.pattern)

    def describe(self) -> str:
        """Return the text that `parse_loss` reads."""
        return f"pattern:{self.pattern}"

    def fates(self, _rng: np.random.Generator) -> Iterator[bool]:
        """Yield whether each packet in turn is lost; the generator is not used."""
        return itertools.cycle([mark == "1" for mark in self.pattern])


Loss: TypeAlias = BernoulliLoss | GilbertElliottLoss | PatternLoss


def parse_loss(text: str) -> Loss:
    """Return the loss written as ``2%``, ``gilbert:p,r[,h[,k]]`` or ``pattern:0010110``.

    Raises
    ------
    SettingsError
        If it has another form.
    """
    model, colon, arguments = text.partition(":")
    if not colon:
        return BernoulliLoss(parse_share(text))
    if model == "pattern":
        return PatternLoss(arguments)
    shares = arguments.split(",")
    if model == "gilbert" and 2 <= len(shares) <= 4:
        return GilbertElliottLoss(*(parse_share(share) for share in shares))
    raise SettingsError(f'"{text[:60]}" is not a loss such as 2%, gilbert:p,r[,h[,k]] or pattern:0010110')
