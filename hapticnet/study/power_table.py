"""Tables of the power of a study, for a terminal and as CSV."""

import csv
import dataclasses
import io
import math
from collections.abc import Sequence
from itertools import groupby
from typing import Final

from hapticnet.study.power import Power

LEAST_EFFECT: Final = 0.03
NO_EFFECT: Final = (
    "These answers hardly differ between conditions, so no number of participants finds a difference. Choose the number"
    " with --shares and the smallest fall that matters to you."
)


def lines(found: Sequence[Power], source: str) -> list[str]:
    """Return the table for a terminal, one block for each design."""
    told = [f"SIMULATED, {source}: power of exact sign-flip tests at 5 %, each condition against the first", ""]
    for (people, trials), group in groupby(found, key=lambda each: (each.participants, each.trials)):
        own = list(group)
        told.append(f"{people} participants, {trials} trials of each condition")
        told.append("  condition        correct [95 % of experiments]  difference  power  equivalent  half width")
        for each in own:
            share = f"{100 * each.share:5.1f} % [{100 * each.low:.0f}, {100 * each.high:.0f}]"
            if each is own[0]:
                told.append(f"  {each.condition:<16} {share:<28}")
                continue
            width = f"{100 * each.half_width:.1f}"
            told.append(
                f"  {each.condition:<16} {share:<28} {100 * each.difference:+9.1f}  {100 * each.power:4.0f} %"
                f"  {100 * each.equivalent:8.0f} %  {width:>10}"
            )
        if math.isfinite(own[0].left_at):
            spread = f" ± {own[0].left_spread:.1f}" if math.isfinite(own[0].left_spread) else ""
            told.append(f"  the curve leaves the margin at {own[0].left_at:.1f}{spread} JND (median, half of 95 %)")
        told.append("")
    if all(abs(each.difference) < LEAST_EFFECT for each in found):
        told += [NO_EFFECT, ""]
    return told[:-1]


def csv_text(found: Sequence[Power], comments: Sequence[str]) -> str:
    """Return every figure as CSV."""
    buffer = io.StringIO()
    buffer.writelines(f"# {line}\n" for line in comments)
    names = [field.name for field in dataclasses.fields(Power)]
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(names)
    for each in found:
        values = [getattr(each, name) for name in names]
        writer.writerow([_cell(value) for value in values])
    return buffer.getvalue()


def _cell(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.6g}" if math.isfinite(value) else "n/a"
