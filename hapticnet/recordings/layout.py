"""How a text table is laid out: its separator, decimal mark, header and units row, found from its first lines."""

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from hapticnet.errors import FileError
from hapticnet.recordings.columns import FORCE_UNITS, LENGTH_UNITS, OTHER_UNITS, TIME_UNITS, printable, split_unit
from hapticnet.recordings.times import is_stamp

OPEN_QUOTE: Final = "a quote is opened and not closed"

_SEPARATORS: Final = ("\t", ";", ",", None)
_MISSING: Final = frozenset(("", "nan", "na", "n/a", "null"))
_UNITS: Final = frozenset((*FORCE_UNITS, *LENGTH_UNITS, *TIME_UNITS, *OTHER_UNITS))
# White space does not part a name from its unit in brackets.
_HEADER_SPACE: Final = re.compile(r" (?![\[(])")


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a text table.

    Attributes
    ----------
    separator
        Character between cells; None: any white space.
    decimal_comma
        Whether numbers are known to have decimal commas.
    names
        Names of the columns.
    header_rows
        Rows before the first row of data.
    notes
        What the user should know about how the file is read.
    """

    separator: str | None
    decimal_comma: bool
    names: tuple[str, ...]
    header_rows: int
    notes: tuple[str, ...]


def find_layout(path: Path, sample: Sequence[tuple[int, str]], comment: str) -> Layout:
    """Return the layout of a table.

    The separator is that of tab, semicolon, comma and white space that gives every line the same number of cells; if
    several do, the one that gives numbers rather than text, and then the one that gives most cells. If none does, it
    is the first of these that the first line has. Where the separator is not a comma, ``1,5`` is a number with a
    decimal comma.

    The first line is a header unless its cells are numbers, stamps or empty. Then the names come from a comment above
    it if that has the same number of cells and no numbers, as `numpy.savetxt` writes it; otherwise they are "0", "1",
    …. A row of units may follow the header.

    Parameters
    ----------
    sample
        Number and text of the first lines that are not blank or comments, at least one.
    comment
        Last comment line before them, or "".

    Raises
    ------
    FileError
        If a quoted cell is not closed.
    """
    lines = [line for _, line in sample]
    separator = _separator(lines)
    try:
        cells = [split_cells(line, separator) for line in lines]
    except csv.Error as error:
        number = next(number for number, line in sample if not _splits(line, separator))
        raise FileError(f"{path}, line {number}: {csv_reason(error)}") from error
    decimal_comma = separator != "," and any(
        "," in cell and number_of(cell, comma=True) is not None for row in cells for cell in row
    )
    notes = ("numbers are read with decimal commas",) if decimal_comma else ()
    if _is_data(cells[0], separator):
        layout = Layout(separator, decimal_comma, tuple(str(index) for index in range(len(cells[0]))), 0, notes)
        names = _comment_names(comment, separator, len(cells[0]))
        if names is None:
            return layout
        return replace(layout, names=names, notes=(*notes, "column names are taken from the comment above the data"))
    names = tuple(printable(cell).strip('"') for cell in split_cells(lines[0], separator, header=True))
    layout = Layout(separator, decimal_comma, names, 1, notes)
    units = [cell.strip().strip("[]()") for cell in cells[1]] if len(cells) > 1 else []
    if len(units) == len(names) and any(unit in _UNITS for unit in units) and not any(map(_is_number, cells[1])):
        named = (f"{name} [{unit}]" if unit in _UNITS else name for name, unit in zip(names, units, strict=True))
        return replace(layout, names=tuple(named), header_rows=2)
    return layout


def split_cells(line: str, separator: str | None, *, header: bool = False) -> list[str]:
    """Return the cells of a line."""
    if separator is None:
        return _HEADER_SPACE.split(" ".join(line.split())) if header else line.split()
    return next(csv.reader([line], delimiter=separator, strict=True), [""])


def number_of(cell: str, *, comma: bool) -> float | None:
    """Return the number in a cell, where `comma` allows a decimal comma; None if there is none."""
    if "_" in cell:  # digit separators of Python, not of CSV
        return None
    if comma and "," in cell and "." not in cell:
        cell = cell.replace(",", ".", 1)
    try:
        return float(cell)
    except ValueError:
        return None


def is_missing(cell: str) -> bool:
    """Return whether a cell stands for a value that was not recorded."""
    return cell.strip().lower() in _MISSING


def csv_reason(error: csv.Error) -> str:
    """Return why the csv module refused a line."""
    return OPEN_QUOTE if "end of data" in str(error) else str(error)


def _separator(lines: Sequence[str]) -> str | None:
    """Return the separator that fits the lines best."""
    found: list[tuple[bool, bool, int, str | None]] = []
    for separator in _SEPARATORS:
        if not all(_splits(line, separator) for line in lines):
            continue
        header, *rows = (split_cells(line, separator, header=number == 0) for number, line in enumerate(lines))
        # A separator at the end of a row is common in the output of loggers.
        widths = {len(row) - (len(row) == len(header) + 1 and not row[-1].strip()) for row in rows}
        one_column = len(header) == 1 and separator in (",", None) and not set(lines[0]) & set("\t;,")
        if (len(header) > 1 or one_column) and widths <= {len(header)}:
            rows_are_data = all(_is_data(row, separator) for row in rows)
            found.append((rows_are_data, rows_are_data and _is_data(header, separator), len(header), separator))
    if found:
        return max(found, key=lambda fit: fit[:3])[3]
    return next((separator for separator in ("\t", ";") if separator in lines[0]), ",")


def _splits(line: str, separator: str | None) -> bool:
    try:
        split_cells(line, separator)
    except csv.Error:
        return False
    return True


def _is_data(cells: Sequence[str], separator: str | None) -> bool:
    """Return whether a row is data: numbers, stamps and empty cells, and not all of them empty."""
    values = [cell for cell in cells if not is_missing(cell)]
    return bool(values) and all(
        number_of(cell, comma=separator != ",") is not None or is_stamp(cell) for cell in values
    )


def _is_number(cell: str) -> bool:
    number = number_of(cell, comma=True)
    return number is not None and math.isfinite(number)


def _comment_names(comment: str, separator: str | None, width: int) -> tuple[str, ...] | None:
    """Return the column names in a comment line; None if it is a remark."""
    text = comment.strip().lstrip("#%").strip()
    if not text or not _splits(text, separator):
        return None
    names = tuple(printable(cell).strip('"') for cell in split_cells(text, separator, header=True))
    if len(names) != width or not all(names) or any(map(_is_number, names)):
        return None
    # One word is rather a remark, unless it carries a unit.
    return names if width > 1 or split_unit(names[0])[1] in _UNITS else None
