"""The level-crossing sampler: transmit which of a fixed set of levels the stimulus has reached.

After Bhardwaj, Chaudhuri, Dabeer, "Design and analysis of predictive sampling of haptic signals", ACM Transactions on
Applied Perception 11(4), 2014: level crossings predict what users notice a little better than Weber's law, and at 10
samples/s their mean square error is about 3 dB less. The spacing of the levels by Weber's law and the hysteresis are
our own.
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.deadband import Deadband, DeadZone
from hapticnet.codec.steps import MakeTable, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import law_numbers, rounded, threshold_around
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import distance, largest_component
from hapticnet_literature.levels import LEVEL, LevelForm, index_of, level_at

MOST_LEVELS: Final = 4096
"""Levels on either side of zero. With 5 % and 25 mN, 360 of them cover the whole range."""

WIDEST: Final = 0.5
"""Half width of a cell as a fraction of its level, at most: at 1 a cell would reach down to zero."""

ROUNDING: Final = 2.0**-36
"""How much narrower cells are than dead zones, as a share: more than `MOST_LEVELS` roundings can amount to."""


class LevelRule(NamedTuple):
    """The numbers of the rule; `levels` and `edges`: the levels from zero on, and the ends of their cells."""

    weber: float
    floor: float
    step: float
    levels: tuple[float, ...]
    edges: tuple[float, ...]


def send(rule: LevelRule, zone: DeadZone, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], DeadZone]:
    """Send the levels in whose cells the components are, or the value if there are none."""
    if index_of(rule.edges, largest_component(x)) < len(rule.levels):
        reference = level_at(rule.levels, rule.edges, x)
        threshold = threshold_around(rule, reference)
        if distance(x, reference) <= threshold:
            return (LEVEL, reference), DeadZone(reference, threshold)
    form, reference, threshold = rounded(rule, x)
    return (form, reference), DeadZone(reference, threshold)


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelCrossing(Scheme):
    """Transmit the index of the level that a stimulus has reached when it leaves the dead zone of the held level.

    Rule: the deadband's, with `ref` the level held: send when ``|x - ref| > threshold(|ref|)``, strictly. What is sent
    is, on each axis, the level in whose cell x lies. The levels: ``r₀ = 0``, and rᵢ₊₁ such that its cell begins where
    the one of rᵢ ends, ``rᵢ₊₁ - w(rᵢ₊₁) = rᵢ + w(rᵢ)``; the same below zero. The half width of a cell is
    ``w(r) = max(κ·r, φ)`` with ``κ = s·multiplier·weber_fraction`` (at most ½), ``φ = s·multiplier·floor_n`` and
    ``s = (1 - hysteresis) / √axes``. Hence levels 2φ apart below φ/κ, and from there on in the ratio
    ``(1 + κ) / (1 - κ)``.

    So ``|x - ref| ≤ w(ref) ≤ threshold`` anywhere in a cell, and with a axes ``|x - ref|² ≤ Σ w(refₐ)² ≤
    a·w(|ref|)² ≤ threshold(|ref|)²``: the held stimulus is within the threshold of the true one at every sample. On
    one axis without hysteresis dead zone and cell are the same, and this is level crossing with those levels; with
    more axes the dead zone is the ball around the box of cells.

    Noise: without hysteresis, a stimulus at rest near a crossing is sent whenever noise, however small, takes it
    across. (A deadband centres itself on each stimulus it sends, and stays silent up to a threshold.) With a hysteresis
    of h, only a swing of 2h thresholds is sent.

    Payload: int16 level indices, 2 bytes an axis; negative ones below zero. A stimulus beyond the last level, or any
    but zero where `floor_n` is zero, is sent as the deadband sends it.

    Attributes
    ----------
    hysteresis
        How much narrower cells are than the dead zone, as a fraction of it: 0 to 0.5. At 0.5 the levels are one
        threshold apart.
    """

    name: ClassVar[str] = "level-crossing"
    steps: ClassVar[Steps] = Deadband.steps._replace(send=send)
    law: WeberLaw = field(default_factory=WeberLaw)
    hysteresis: float = 0.25

    def __post_init__(self) -> None:
        check_parameter("hysteresis", self.hysteresis, 0.0, 0.5)

    def rule(self, axes: int, table: MakeTable) -> LevelRule:  # noqa: ARG002
        """Return law and levels."""
        return LevelRule(*law_numbers(self.law), 0.0, *self.cells(axes))

    def form(self, axes: int) -> LevelForm:
        """Return the form of its messages."""
        return LevelForm(axes, *self.cells(axes))

    def cells(self, axes: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the levels from zero on, on each of so many axes, and the ends of their cells."""
        share = (1.0 - self.hysteresis) / math.sqrt(axes) * self.law.multiplier
        return levels(min(share * self.law.weber_fraction, WIDEST), share * self.law.floor_n)


@lru_cache(maxsize=32)
def levels(weber: float, floor_n: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the levels from zero on whose cells have half widths ``max(weber·level, floor_n)``, and the cells' ends.

    Computed level by level with sums and quotients only, which have the same bits on every machine; powers do not.
    """
    weber, floor_n = max(weber - ROUNDING * 2.0**-10, 0.0), floor_n * (1.0 - ROUNDING)
    found, ends = [0.0], [floor_n]
    while len(found) <= MOST_LEVELS and ends[-1] < LARGEST_COMPONENT:
        # r - max(weber·r, floor) = end is solved by the larger of the two.
        level = max(ends[-1] + floor_n, ends[-1] / (1.0 - weber))
        if not found[-1] < level <= LARGEST_COMPONENT:
            break
        found.append(level)
        ends.append(level + max(weber * level, floor_n))
    return tuple(found), tuple(ends)
