"""The measures of the ordering task, each computed from some trials of one participant."""

from collections.abc import Callable, Iterable, Sequence
from statistics import fmean, median
from typing import Final, TypeAlias

from hapticnet.study.rows import OrderRow

Measure: TypeAlias = Callable[[Sequence[OrderRow]], float | None]
"""A figure of some trials; None where they do not say."""


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are known; None without any."""
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _share(rows: Sequence[OrderRow]) -> float | None:
    return mean(row.correct for row in rows)


def _per_penetration(attribute: str) -> Measure:
    def measure(rows: Sequence[OrderRow]) -> float | None:
        told = [row for row in rows if getattr(row, attribute) is not None and row.penetrations]
        through = sum(row.penetrations or 0 for row in told)
        return sum(getattr(row, attribute) for row in told) / through if through else None

    return measure


def _delivered(rows: Sequence[OrderRow]) -> float | None:
    """Return the mean share of the held peak that was sensed."""
    return mean(
        sensed / held
        for row in rows
        for held, sensed in zip(row.peaks_held_n, row.peaks_sensed_n, strict=True)
        if held and sensed is not None
    )


def _median_time(rows: Sequence[OrderRow]) -> float | None:
    times = [row.contact_to_answer_s for row in rows if row.contact_to_answer_s is not None]
    return median(times) if times else None


MEASURES: Final[dict[str, tuple[str, Measure]]] = {
    "correct": ("correct orders", _share),
    "pairs": (
        "correct pairs",
        lambda rows: mean(row.pairs_correct / 3 for row in rows if row.pairs_correct is not None),
    ),
    "kendall": ("Kendall's distance", lambda rows: mean(row.kendall for row in rows)),
    "bytes": ("bytes per penetration", _per_penetration("penetration_bytes")),
    "packets": ("packets per penetration", _per_penetration("penetration_packets")),
    "time_s": ("time from contact to answer [s]", _median_time),
    "insertions": ("insertions", lambda rows: mean(row.insertions for row in rows)),
    "penetrations": ("penetrations", lambda rows: mean(row.penetrations for row in rows)),
    "peak_n": (
        "force at contact: largest sensed [N]",
        lambda rows: mean(max((peak or 0.0) for peak in row.peaks_sensed_n) for row in rows),
    ),
    "delivered": ("sensed over held peak", _delivered),
    "error": ("perceptual error of the held force", lambda rows: mean(row.perceptual_error for row in rows)),
    "speed_m_per_s": ("largest speed in contact", lambda rows: mean(row.peak_speed_m_per_s for row in rows)),
}
"""The measures: name in tables, and how it is computed from the trials of one participant."""

WITH_MARGIN: Final = ("correct",)
"""Measures for which a margin of equivalence is stated."""

SHARES: Final = ("correct", "pairs")
"""Compared measures that are shares, from 0 to 1."""

COMPARED: Final = (*WITH_MARGIN, "pairs", "kendall", "time_s", "insertions", "peak_n", "rating")
"""Measures that are compared between conditions."""

NAMES: Final[dict[str, str]] = {**{key: name for key, (name, _) in MEASURES.items()}, "rating": "rating, 1 to 7"}
"""Name of every measure in tables, and of the rating."""
