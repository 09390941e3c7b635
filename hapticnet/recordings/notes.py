"""Plausibility of a recording: gaps, repeated stamps, peaks far outside the rest."""

from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray

GAP_STEPS: Final = 5
"""A gap is a step in time longer than this many median steps."""

PEAK_SHARE: Final = 1e-3
"""Share of the samples that may be peaks, at least one sample."""

PEAK_RATIO: Final = 10
"""How many times farther from the median than the rest a peak is."""

FEWEST_SAMPLES: Final = 10
"""Fewer samples are not searched for peaks."""


def time_notes(t_us: IntArray) -> list[str]:
    """Return notes on the times [µs] of a recording, shape (n,), which do not run backwards."""
    steps = np.diff(t_us)
    notes = []
    repeated = int((steps == 0).sum())
    if repeated:
        notes.append(f"{repeated} of {len(t_us)} samples repeat the time stamp of the sample before")
    rising = steps[steps > 0]
    median_us = float(np.median(rising)) if len(rising) else 0.0
    gaps = np.flatnonzero(steps > GAP_STEPS * median_us) if len(rising) else rising
    if len(gaps):
        longest = int(gaps[np.argmax(steps[gaps])])
        notes.append(
            f"{len(gaps)} {'gap' if len(gaps) == 1 else 'gaps'} in time (more than {GAP_STEPS} times the median step of"
            f" {median_us / 1e3:g} ms), the longest {steps[longest] / 1e6:g} s after sample {longest}"
        )
    return notes


def peak_note(values: FloatArray, what: str, unit: str) -> str | None:
    """Return a note on values far outside the rest, shape (n, a); None if there are none.

    With m = `PEAK_SHARE` · n rounded down, but at least 1, a peak is a value whose distance from the median of its axis
    is more than `PEAK_RATIO` times the (m + 1)-th largest such distance. So at most m samples of an axis are peaks,
    peaks of any size do not hide each other, and a contact that lasts for more than m samples is not a peak.
    """
    if len(values) < FEWEST_SAMPLES or not values.shape[1]:
        return None
    rest_at = len(values) - 1 - max(1, int(len(values) * PEAK_SHARE))
    distance = np.abs(values - np.median(values, axis=0))
    outside = distance > PEAK_RATIO * np.partition(distance, rest_at, axis=0)[rest_at]
    rows = np.flatnonzero(outside.any(axis=1))
    if not len(rows):
        return None
    row = int(rows[np.argmax(np.where(outside, distance, 0.0)[rows].max(axis=1))])
    axis = int(np.argmax(np.where(outside, distance, 0.0)[row]))
    rest = np.delete(values[:, axis], rows)
    return (
        f"{what}: {len(rows)} {'sample is' if len(rows) == 1 else 'samples are'} far outside the rest, up to"
        f" {values[row, axis]:g} {unit} at sample {row}; the rest is between {rest.min():g} and {rest.max():g} {unit}"
    )
