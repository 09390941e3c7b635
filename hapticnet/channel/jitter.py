"""Random delay of packets, added to the constant delay of a channel."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from hapticnet.channel.loss import BLOCK
from hapticnet.channel.quantities import LONGEST_US, format_time, parse_number, parse_time_us
from hapticnet.checks import check_above, check_parameter
from hapticnet.errors import SettingsError

Distribution: TypeAlias = Literal["normal", "uniform", "pareto"]

DISTRIBUTIONS: Final = get_args(Distribution)
DEFAULT_SHAPE: Final = 3.0
LARGEST_SHAPE: Final = 1000.0


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

    Attributes
    ----------
    distribution
        One of normal, uniform, pareto.
    deviation_us
        Standard deviation σ [µs].
    shape
        α of the Pareto distribution, above 2; smaller values give a heavier tail. Not used by the other two.
    keeps_order
        Whether a packet waits for earlier ones (a queue) or may overtake them (multiple paths).

    Raises
    ------
    SettingsError
        If a value is unknown or out of range.
    """

    distribution: Distribution
    deviation_us: int
    shape: float = DEFAULT_SHAPE
    keeps_order: bool = True

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise SettingsError(f'jitter is "{self.distribution}"; it must be one of {", ".join(DISTRIBUTIONS)}')
        check_parameter("jitter deviation", self.deviation_us, 0, LONGEST_US, "µs")
        if self.distribution != "pareto" and self.shape != DEFAULT_SHAPE:
            raise SettingsError(f"jitter shape is {self.shape}; only pareto has a shape")
        # At 2 and below, a Pareto distribution has no standard deviation.
        check_above("jitter shape", self.shape, 2, LARGEST_SHAPE)

    def describe(self) -> str:
        """Return the text that `parse_jitter` reads."""
        shape = f":{self.shape!r}" if self.distribution == "pareto" else ""
        return f"{self.distribution}:{format_time(self.deviation_us)}{shape}"

    def delays_us(self, rng: np.random.Generator) -> Iterator[int]:
        """Yield the delay [µs] of each packet in turn."""
        alpha = self.shape
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
    """Return the jitter written as ``normal:5ms``, ``uniform:5ms`` or ``pareto:5ms[:shape]``.

    Raises
    ------
    SettingsError
        If it has another form.
    """
    match text.split(":"):
        case [("normal" | "uniform" | "pareto") as distribution, deviation]:
            return Jitter(distribution=distribution, deviation_us=parse_time_us(deviation))
        case ["pareto", deviation, shape]:
            return Jitter(distribution="pareto", deviation_us=parse_time_us(deviation), shape=parse_number(shape))
    raise SettingsError(f'"{text[:60]}" is not a jitter such as normal:5ms, uniform:5ms or pareto:5ms[:3]')
