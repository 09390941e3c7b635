"""The page's part on how fair the comparison is: packets at equal error, and what other settings would have done."""

import itertools
import math
from collections.abc import Sequence

from page_codecs import OURS, at
from page_markdown import Row, table

RIVALS = ("deadband", OURS, "linear-predictive", "least-squares", "level-crossing")


def equal_error(results: Row) -> list[str]:
    """Return packets at the error that the deadband makes at 1 JND."""
    trials = [row["name"] for row in results["signals"]]
    lines = []
    for codec in RIVALS:
        cells = []
        for trial in trials:
            own = curve(results, codec, trial)
            (plain,) = [row for row in at(results["rows"], 1.0) if (row["codec"], row["trial"]) == ("deadband", trial)]
            packets = interpolated(own, plain["rmse_n"])
            cells.append("–" if packets is None else f"{packets / max(plain['sent'], 1):.2f}")
        lines.append((codec, *cells))
    return [
        (
            "A codec that errs less at a threshold would do with fewer packets at the same error. Packets at the RMSE that the"
            " deadband makes at 1 JND, as shares of the deadband's: interpolated between the thresholds"
            f" {', '.join(f'{each:g}' for each in results['thresholds'])} JND, both on logarithmic scales; a dash where that"
            " error lies beyond them."
        ),
        table(("codec", *trials), lines),
    ]


def curve(results: Row, codec: str, trial: str) -> list[tuple[float, float]]:
    """Return RMSE [N] and packets of a codec at every threshold, errors rising."""
    return sorted(
        (row["rmse_n"], float(row["sent"]))
        for row in results["rows"]
        if (row["codec"], row["trial"], row["loss"], row["step_n"]) == (codec, trial, 0.0, 0.0)
    )


def interpolated(points: Sequence[tuple[float, float]], error_n: float) -> float | None:
    """Return the packets at an error; None where it is not between two thresholds."""
    for (low_n, many), (high_n, few) in itertools.pairwise(points):
        if 0.0 < low_n <= error_n <= high_n and min(many, few) > 0.0:
            if high_n == low_n:
                return many
            share = math.log(error_n / low_n) / math.log(high_n / low_n)
            return many * (few / many) ** share
    return points[0][1] if len(points) == 1 and points[0][0] == error_n else None


def sampling(results: Row) -> list[str]:
    """Return packets over the optimum at lower sampling rates."""
    aimed_at, *others = results["sets"]
    rows = results["rates"]
    codecs = list(dict.fromkeys(row["codec"] for row in rows))
    found = {(row["codec"], row["every"]): row for row in rows}
    return [
        (
            "The same signals with samples left out, so that the force moves on further from one to the next; packets at 1 JND"
            " over the optimal hold of what is left, each codec with the settings it has at 1 kHz."
        ),
        table(
            ("samples/s", *(f"{codec}: {name}" for name in (aimed_at, *others) for codec in codecs)),
            (
                (
                    f"{1000 / every:g}",
                    *(f"{found[codec, every][which]:.2f}" for which in ("aimed_at", "made") for codec in codecs),
                )
                for every in dict.fromkeys(row["every"] for row in rows)
            ),
        ),
    ]


def settings(results: Row) -> list[str]:
    """Return packets over the optimum with other settings than the usual ones."""
    aimed_at, *others = results["sets"]
    return [
        (
            "Packets at 1 JND over the optimal hold with one setting changed, means as above. Those of our codec were chosen"
            " on the first column's signals; the others' are the usual ones, and a reader with one kind of signal will tune"
            " either."
        ),
        table(
            ("codec", "setting", aimed_at, *others),
            (
                (
                    row["codec"],
                    ", ".join(f"`{key}={value:g}`" for key, value in row["parameters"].items()),
                    f"{row['aimed_at']:.2f}",
                    f"{row['made']:.2f}",
                )
                for row in results["settings"]
            ),
        ),
    ]
