"""The one table of results, and how it is written: on a terminal, and as CSV."""

import csv
import io
import shutil
import sys
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final

from hapticnet.errors import visible

UNKNOWN: Final = "–"
WIDEST: Final = 1000  # characters of a line that is not read on a terminal: more than any table needs


def line_width() -> int:
    """Return the characters of a line on stdout."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, width: int | None = None, left: int = 1) -> None:
    """Print a table on stdout; control characters become "?". A cell may have several lines.

    Columns that do not fit in `width` follow in further tables, each with the first `left` columns. No number is cut.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    widths = [
        2 + max(len(line) for cell in column for line in cell.split("\n")) for column in zip(head, *rows, strict=True)
    ]
    room = (line_width() if width is None else width) - 1 - sum(widths[:left])
    starts = [left]
    for index in range(left, len(head)):
        if index > starts[-1] and sum(widths[starts[-1] : index + 1]) > room:
            starts.append(index)
    console = Console(highlight=False, width=WIDEST)
    for start, end in pairwise([*starts, len(head)]):
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for index in (*range(left), *range(start, end)):
            justify: Any = "left" if index < left else "right"
            table.add_column(_shown(head[index]), justify=justify, no_wrap=True, vertical="bottom")
        for row in rows:
            table.add_row(*(Text(_shown(cell)) for cell in (*row[:left], *row[start:end])))
        console.print(table)


def csv_text(head: Sequence[str], rows: Iterable[Sequence[Any]], comments: Iterable[str] = ()) -> str:
    """Return rows as CSV below lines of comment; None is empty."""
    text = io.StringIO()
    text.writelines(f"# {line}\n" for line in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue()


def _shown(cell: str) -> str:
    return "\n".join(map(visible, cell.split("\n")))
