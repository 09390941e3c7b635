"""The rows of a comparison in blocks of equal settings, and their means over several recordings with intervals."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Final

from hapticnet.experiment.comparison import Row

CONFIDENCE: Final = 0.95
HOLD_OPTIMUM: Final = "optimum, hold"
LINE_OPTIMUM: Final = "optimum, lines"
METHOD: Final = "mean ± half width of the 95 % interval of Student's t over {count} recordings"


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The common settings of the codecs in a block, apart from the recording; see `comparison.Row`."""

    multiplier: float
    weber_fraction: float
    floor_n: float
    loss: float
    delay_us: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One codec, or one optimum, in a block."""

    label: str
    codec: str | None
    values: Mapping[str, Any]  # figures by the name of the field in `Row.flat`; None where there is no finite value
    half_widths: Mapping[str, float]  # of the 95 % intervals, for the values that are means


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """All codecs with the same settings, on one recording or in the mean over several."""

    trial: str | None  # name of the recording; None for means
    recordings: int
    settings: Settings
    lines: tuple[Line, ...]


def blocks(rows: Sequence[Row]) -> list[Block]:
    """Return a block for each recording and settings; the two optima come last in each."""
    found: dict[tuple[str, Settings], list[Row]] = {}
    for row in rows:
        settings = Settings(**{field.name: getattr(row, field.name) for field in fields(Settings)})
        found.setdefault((row.trial, settings), []).append(row)
    return [
        Block(trial=trial, recordings=1, settings=settings, lines=(*map(_line, block), *_optima(block[0])))
        for (trial, settings), block in found.items()
    ]


def means(single: Sequence[Block]) -> list[Block]:
    """Return the means over recordings of the blocks with the same settings; none if there is only one recording."""
    found: dict[Settings, list[Block]] = {}
    for block in single:
        found.setdefault(block.settings, []).append(block)
    return [
        Block(
            trial=None,
            recordings=len(group),
            settings=settings,
            lines=tuple(_mean_line(lines) for lines in zip(*(block.lines for block in group), strict=True)),
        )
        for settings, group in found.items()
        if len(group) > 1
    ]


@cache
def t_quantile(freedom: int, confidence: float = CONFIDENCE) -> float:
    """Return the two-sided quantile of Student's t distribution with `freedom` degrees of freedom.

    The probability within ±t is the finite series of Abramowitz and Stegun, 26.7.3 and 26.7.4; it is inverted by
    bisection over the angle θ = atan(t / √freedom).
    """
    low, high = 0.0, math.pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        if _within(middle, freedom) < confidence:
            low = middle
        else:
            high = middle
    return math.sqrt(freedom) * math.tan(high)


def _within(angle: float, freedom: int) -> float:
    sine, square = math.sin(angle), math.cos(angle) ** 2
    odd = freedom % 2
    term, total = (math.cos(angle) if odd else 1.0), 0.0
    for index in range(freedom // 2):
        total += term
        term *= square * (2 * index + 1 + odd) / (2 * index + 2 + odd)
    return 2 / math.pi * (angle + sine * total) if odd else sine * total


def _line(row: Row) -> Line:
    figures = {
        key: value
        for key, value in row.flat().items()
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    }
    return Line(
        label=f"{row.label} (at rest)" if row.at_rest else row.label, codec=row.codec, values=figures, half_widths={}
    )


def _optima(row: Row) -> list[Line]:
    """Return the optima of a block, which are the same in all rows."""
    seconds = row.cost.sent / row.packets_per_s if row.cost.sent else math.inf
    return [
        Line(
            label=label,
            codec=None,
            values={
                "packets_per_s": packets / seconds,
                "packet_rate_reduction": 1.0 - packets / row.cost.samples,
                "over_optimum": packets / row.limits.holds if row.limits.holds else 1.0,
            },
            half_widths={},
        )
        for label, packets in ((HOLD_OPTIMUM, row.limits.holds), (LINE_OPTIMUM, row.limits.lines))
    ]


def _mean_line(lines: Sequence[Line]) -> Line:
    values: dict[str, Any] = {}
    half_widths: dict[str, float] = {}
    for key in lines[0].values:
        figures = [line.values[key] for line in lines]
        if any(figure is None for figure in figures):
            values[key] = None
            continue
        values[key] = statistics.fmean(figures)
        error = statistics.stdev(figures) / math.sqrt(len(figures))
        half_widths[key] = t_quantile(len(figures) - 1) * error
    return Line(label=lines[0].label, codec=lines[0].codec, values=values, half_widths=half_widths)
