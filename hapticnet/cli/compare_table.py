"""The comparison's table on a terminal: a block for each recording and setting, as wide as the terminal allows."""

import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table

from hapticnet.cli.console import show
from hapticnet.experiment.comparison import Row
from hapticnet.experiment.comparison_table import COLUMNS, Column, heading, notes
from hapticnet.experiment.summary import Block, blocks, means
from hapticnet.experiment.trials import Trial

WIDEST: Final = 1000
"""Characters of a line that is not read on a terminal: more than any table needs."""

LONGEST_LABEL: Final = 22
"""Characters of a codec with its parameters on one line of a terminal: enough for every codec's name."""

NOTE_WIDTH: Final = 120


def print_rows(rows: Sequence[Row], trials: Sequence[Trial], width: int | None = None) -> None:
    """Print a comparison on stdout.

    Parameters
    ----------
    width
        Characters of a line; None: those of the terminal, and any number if stdout is not a terminal. Columns that do
        not fit follow below in further tables. Numbers are never cut.
    """
    if width is None:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST
    single = blocks(rows)
    shown = single + means(single)
    for trial in trials:
        show(textwrap.fill(describe(trial), width, subsequent_indent="  "))
    for block in shown:
        show("\n" + textwrap.fill(heading(block, shown), width, subsequent_indent="  "))
        _print_block(block, width)
    print(textwrap.fill(" ".join(notes(shown)), min(width, NOTE_WIDTH)))


def describe(trial: Trial) -> str:
    """Return what a recording is, so that a wrong rate or a gap is noticed."""
    account = trial.account()
    return (
        f"{trial.name}: {account['samples']:,} samples, {account['seconds']:.1f} s, {account['period_ms']:g} ms apart,"
        f" longest gap {account['longest_gap_ms']:g} ms"
    )


def _print_block(block: Block, width: int) -> None:
    names = [line.label if width == WIDEST else _folded(line.label) for line in block.lines]
    room = width - 3 - max(len(part) for name in names for part in name.split("\n"))
    widths = [2 + max(map(len, (*column.heading.split("\n"), *map(column.cell, block.lines)))) for column in COLUMNS]
    starts = [0]
    for index in range(len(COLUMNS)):
        if index > starts[-1] and sum(widths[starts[-1] : index + 1]) > room:
            starts.append(index)
    console = Console(highlight=False, width=WIDEST)
    for start, end in pairwise([*starts, len(COLUMNS)]):
        console.print(_table(block, names, COLUMNS[start:end]))


def _table(block: Block, names: Sequence[str], columns: Sequence[Column]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("codec", no_wrap=True, vertical="bottom")
    for column in columns:
        table.add_column(column.heading, justify="right", no_wrap=True)
    for name, line in zip(names, block.lines, strict=True):
        table.add_row(name, *(column.cell(line) for column in columns))
    return table


def _folded(label: str) -> str:
    """Return a label on as many lines as it needs, broken before parameters."""
    lines = [""]
    for part in re.split(r"(?<=[:,])|(?= \()", label):
        if lines[-1] and len(lines[-1]) + len(part) > LONGEST_LABEL:
            lines.append("  ")
            part = part.lstrip()
        lines[-1] += part
    return "\n".join(lines)
