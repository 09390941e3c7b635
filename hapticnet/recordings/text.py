"""Text tables: CSV, TSV and columns separated by spaces, with decimal points or decimal commas."""

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple, TextIO

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError, visible
from hapticnet.files import MAX_BYTES, check_readable
from hapticnet.recordings.columns import (
    FORCE_UNITS,
    LENGTH_UNITS,
    OTHER_UNITS,
    TIME_UNITS,
    check_columns,
    find_column,
    is_stamp,
    split_unit,
    stamp_us,
)

LONGEST_LINE: Final = 2**20  # limit of the characters in a line; a file with a longer one is not a table
_SAMPLE_ROWS: Final = 100
_BLOCK_BYTES: Final = 2**20
_SKIPPED: Final = ("", "#", "%")
_OPEN_QUOTE: Final = "a quote is opened and not closed"
_SEPARATORS: Final = ("\t", ";", ",", None)
_MISSING: Final = frozenset(("", "nan", "na", "n/a", "null"))
_UNITS: Final = frozenset((*FORCE_UNITS, *LENGTH_UNITS, *TIME_UNITS, *OTHER_UNITS))
# White space does not separate a name from its unit in brackets.
_HEADER_SPACE: Final = re.compile(r" (?![\[(])")


def read_csv(path: Path, columns: Sequence[str] | None = None, *, max_bytes: int = MAX_BYTES) -> dict[str, FloatArray]:
    """Return columns (names, or numbers from 0; None: all) of a CSV file by name, each finite, shape (rows,).

    The other columns may hold anything. FileError if the file cannot be read, or lacks a column or a number.
    """
    check_readable(path, max_bytes)
    source = TextSource(path)
    names = source.names if columns is None else tuple(columns)
    indices = range(len(names)) if columns is None else [find_column(path, source.names, name) for name in names]
    values = source.numbers(list(indices))
    faults = np.argwhere(~np.isfinite(values))
    if len(faults):
        row, column = faults[0]
        raise FileError(f'{path}, {source.place(int(row))}, column "{names[column]}": no finite number')
    return {name: np.ascontiguousarray(values[:, index]) for index, name in enumerate(names)}


class _IrregularError(Exception):
    """A line that NumPy's parser reads differently from this class."""


class TextSource:
    """A text table as columns, with only the requested ones in memory; the others may contain anything.

    Blank lines and lines that start with ``#`` or ``%`` are skipped. Of a `torn` table, whose writer may have
    been killed, a last line without a line end is left out. `_find_layout` finds separators and header.
    """

    def __init__(self, path: Path, *, torn: bool = False) -> None:
        self.path = path
        self._torn = torn
        self._encoding = _encoding_of(path)
        comment = ""
        sample: list[tuple[int, str]] = []
        with self._text() as file:
            for number, line in enumerate(self._lines(file), start=1):
                if line.lstrip()[:1] in ("#", "%"):
                    comment = comment if sample else line
                elif line.strip():
                    check_columns(
                        path, 1 + max(line.count("\t"), line.count(";"), line.count(","), len(line.split()) - 1)
                    )
                    sample.append((number, line.rstrip("\n")))
                    if len(sample) == _SAMPLE_ROWS:
                        break
        if not sample:
            raise FileError(f"{path}: the file has no data; expected a table with a header and rows")
        self._layout = _find_layout(path, sample, comment)
        self.names = self._layout.names
        self.notes = self._layout.notes
        if self._encoding == "latin-1":
            self.notes = ("the text is not UTF-8; it is read as Latin-1", *self.notes)
        if len(sample) == self._layout.header_rows:
            raise FileError(f"{path}: there are no rows under the header")
        self._sample = [_split_cells(line, self._layout.separator) for _, line in sample[self._layout.header_rows :]]

    def numbers(self, indices: Sequence[int]) -> FloatArray:
        """Return columns, shape (rows, columns), NaN where a cell is missing; FileError for other cells or rows."""
        fast = self._numbers_at_once(indices)
        return self._numbers_by_cell(indices) if fast is None else fast

    def has_stamps(self, index: int) -> bool:
        """Return whether a column holds dates and times in ISO 8601: its first cell that is not empty does."""
        cells = (row[index] for row in self._sample if index < len(row))
        return is_stamp(next((cell for cell in cells if not _is_missing(cell)), ""))

    def stamps_us(self, index: int) -> IntArray:
        """Return a column of ISO 8601 stamps in µs since 1970, shape (rows,); `NO_STAMP` where it is empty."""
        stamps = []
        for row, cells in enumerate(self._cells()):
            stamp = stamp_us(cells[index])
            if stamp is None:
                raise self._fault(row, index, cells[index], "a date and time in ISO 8601")
            stamps.append(stamp)
        return np.array(stamps, dtype=np.int64)

    def place(self, row: int) -> str:
        """Return the place of a row in the file, for a message."""
        number, _ = next(islice(self._rows(), row, None), (None, ""))
        return f"row {row}" if number is None else f"line {number}"

    def _numbers_at_once(self, indices: Sequence[int]) -> FloatArray | None:
        """Return the columns, read by NumPy's compiled parser; None if the file needs a closer look."""
        separator, decimal_comma = self._layout.separator, self._layout.decimal_comma
        separators = len(self.names) - 1
        twice, last = ("\0", ("\0",)) if separator is None else (2 * separator, (separator, f"{separator}\n"))
        rows = 0

        def lines() -> Iterator[str]:
            nonlocal rows
            for _, line in self._rows():
                found = line.count(separator) if separator is not None else len(line.split()) - 1
                if found != separators or (decimal_comma and "." in line):
                    raise _IrregularError
                if twice in line or line[0] == separator or line.endswith(last):
                    line = twice[0].join(cell if cell.strip() else "nan" for cell in line.split(separator))
                rows += 1
                yield line.replace(",", ".") if decimal_comma else line

        try:
            values = np.loadtxt(lines(), delimiter=separator, comments=None, quotechar='"', usecols=indices, ndmin=2)
        except (ValueError, _IrregularError):
            return None
        # Fewer rows than lines: a quote was left open. Infinity is reported with its cell by the careful reader.
        return None if len(values) != rows or np.isinf(values).any() else values

    def _numbers_by_cell(self, indices: Sequence[int]) -> FloatArray:
        values: list[list[float]] = []
        point = comma = ""
        for row, cells in enumerate(self._cells()):
            numbers = []
            for index in indices:
                cell = cells[index]
                number = math.nan if _is_missing(cell) else _number_of(cell, comma=self._layout.separator != ",")
                if number is None or math.isinf(number):
                    raise self._fault(row, index, cell, "a finite number")
                point = point or (cell if "." in cell else "")
                comma = comma or (cell if "," in cell else "")
                if point and comma:
                    raise FileError(
                        f"{self._cell(row, index)}: numbers with a decimal point and with a decimal comma in one file:"
                        f' "{visible(point.strip())}" and "{visible(comma.strip())}"'
                    )
                numbers.append(number)
            values.append(numbers)
        return np.array(values)

    def _cells(self) -> Iterator[list[str]]:
        """Yield the cells of each row; a trailing separator is ignored."""
        row, complete = -1, True

        def lines() -> Iterator[str]:
            nonlocal row, complete
            for _, line in self._rows():
                if not complete:  # the last line ended within a quoted cell
                    raise csv.Error(_OPEN_QUOTE)
                row, complete = row + 1, False
                yield line

        width, separator = len(self.names), self._layout.separator
        rows: Iterator[list[str]] = (
            (line.split() for line in lines())
            if separator is None
            else csv.reader(lines(), delimiter=separator, strict=True)
        )
        try:
            for cells in rows:
                complete = True
                if len(cells) == width + 1 and not cells[-1].strip():
                    cells.pop()
                if len(cells) != width:
                    raise FileError(f"{self.path}, {self.place(row)}: {len(cells)} cells; the first line has {width}")
                yield cells
        except csv.Error as error:
            raise FileError(f"{self.path}, {self.place(row)}: {_csv_reason(error)}") from error

    def _rows(self) -> Iterator[tuple[int, str]]:
        """Yield number and text of each line that holds a row of data."""
        with self._text() as file:
            lines = enumerate(self._lines(file), start=1)
            kept = ((number, line) for number, line in lines if line.lstrip()[:1] not in _SKIPPED)
            yield from islice(kept, self._layout.header_rows, None)

    @contextmanager
    def _text(self) -> Iterator[TextIO]:
        """Open the file as text; errors while it is read become a FileError."""
        try:
            with self.path.open(encoding=self._encoding) as file:
                yield file
        except UnicodeError as error:
            raise FileError(f"{self.path}: not UTF-16 text, as its first bytes say; save the file as UTF-8") from error
        except OSError as error:
            raise FileError(f"{self.path}: {error.strerror or error}") from error

    def _lines(self, file: TextIO) -> Iterator[str]:
        """Yield the lines of an open file; FileError if one has `LONGEST_LINE` characters or more."""
        for line in iter(partial(file.readline, LONGEST_LINE), ""):
            if len(line) == LONGEST_LINE:
                raise FileError(f"{self.path}: a line is longer than {LONGEST_LINE} characters; this is not a table")
            if self._torn and not line.endswith("\n"):
                return
            yield line

    def _fault(self, row: int, index: int, cell: str, expected: str) -> FileError:
        return FileError(f'{self._cell(row, index)}: "{visible(cell[:60].strip())}" is not {expected}')

    def _cell(self, row: int, index: int) -> str:
        return f'{self.path}, {self.place(row)}, column "{self.names[index][:60]}"'


def _encoding_of(path: Path) -> str:
    """Return the encoding of a text: UTF-16 with a byte order mark, UTF-8, or else Latin-1."""
    with path.open("rb") as file:
        if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return "utf-16"
        file.seek(0)
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            for block in iter(partial(file.read, _BLOCK_BYTES), b""):
                decoder.decode(block)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "latin-1"
    return "utf-8-sig"


class Layout(NamedTuple):
    """Layout of a text table."""

    separator: str | None  # character between cells; None: any white space
    decimal_comma: bool  # numbers are known to have decimal commas
    names: tuple[str, ...]  # of the columns
    header_rows: int  # rows before the first row of data
    notes: tuple[str, ...]  # notes for the user about how the file is read


def _find_layout(path: Path, sample: Sequence[tuple[int, str]], comment: str) -> Layout:
    """Return the layout of a table; raise FileError if a quoted cell is not closed.

    The separator is whichever of tab, semicolon, comma and white space gives every line the same number of cells; if
    several do, the one that gives numbers rather than text, and then the one that gives most cells. If none does, it is
    the first of these that the first line has. Where it is not a comma, ``1,5`` is a number with a decimal comma.

    The first line is a header unless its cells are numbers, stamps or empty. Then the names come from a comment above
    it if that has the same number of cells and no numbers, as written by `numpy.savetxt`; otherwise they are "0", "1",
    …. A row of units may follow the header. `sample` has number and text of the first lines that are not blank or
    comments, at least one; `comment` is the last comment line before them, or "".
    """
    lines = [line for _, line in sample]
    separator = _separator(lines)
    try:
        cells = [_split_cells(line, separator) for line in lines]
    except csv.Error as error:
        number = next(number for number, line in sample if not _splits(line, separator))
        raise FileError(f"{path}, line {number}: {_csv_reason(error)}") from error
    decimal_comma = separator != "," and any(
        "," in cell and _number_of(cell, comma=True) is not None for row in cells for cell in row
    )
    notes = ("numbers are read with decimal commas",) if decimal_comma else ()
    if _is_data(cells[0], separator):
        layout = Layout(separator, decimal_comma, tuple(str(index) for index in range(len(cells[0]))), 0, notes)
        names = _comment_names(comment, separator, len(cells[0]))
        if names is None:
            return layout
        return layout._replace(names=names, notes=(*notes, "column names are taken from the comment above the data"))
    names = tuple(visible(cell.strip()).strip('"') for cell in _split_cells(lines[0], separator, header=True))
    layout = Layout(separator, decimal_comma, names, 1, notes)
    units = [cell.strip().strip("[]()") for cell in cells[1]] if len(cells) > 1 else []
    if len(units) == len(names) and any(unit in _UNITS for unit in units) and not any(map(_is_number, cells[1])):
        named = (f"{name} [{unit}]" if unit in _UNITS else name for name, unit in zip(names, units, strict=True))
        return layout._replace(names=tuple(named), header_rows=2)
    return layout


def _split_cells(line: str, separator: str | None, *, header: bool = False) -> list[str]:
    if separator is None:
        return _HEADER_SPACE.split(" ".join(line.split())) if header else line.split()
    return next(csv.reader([line], delimiter=separator, strict=True), [""])


def _number_of(cell: str, *, comma: bool) -> float | None:
    """Return the number in a cell, where `comma` allows a decimal comma; None if there is none."""
    if "_" in cell:  # digit separators of Python, not of CSV
        return None
    if comma and "," in cell and "." not in cell:
        cell = cell.replace(",", ".", 1)
    try:
        return float(cell)
    except ValueError:
        return None


def _is_missing(cell: str) -> bool:
    """Return whether a cell stands for a value that was not recorded."""
    return cell.strip().lower() in _MISSING


def _csv_reason(error: csv.Error) -> str:
    return _OPEN_QUOTE if "end of data" in str(error) else str(error)


def _separator(lines: Sequence[str]) -> str | None:
    found: list[tuple[bool, bool, int, str | None]] = []
    for separator in _SEPARATORS:
        if not all(_splits(line, separator) for line in lines):
            continue
        header, *rows = (_split_cells(line, separator, header=number == 0) for number, line in enumerate(lines))
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
        _split_cells(line, separator)
    except csv.Error:
        return False
    return True


def _is_data(cells: Sequence[str], separator: str | None) -> bool:
    """Return whether a row is data: numbers, stamps and empty cells, and not all of them empty."""
    values = [cell for cell in cells if not _is_missing(cell)]
    return bool(values) and all(
        _number_of(cell, comma=separator != ",") is not None or is_stamp(cell) for cell in values
    )


def _is_number(cell: str) -> bool:
    number = _number_of(cell, comma=True)
    return number is not None and math.isfinite(number)


def _comment_names(comment: str, separator: str | None, width: int) -> tuple[str, ...] | None:
    text = comment.strip().lstrip("#%").strip()
    if not text or not _splits(text, separator):
        return None
    names = tuple(visible(cell.strip()).strip('"') for cell in _split_cells(text, separator, header=True))
    if len(names) != width or not all(names) or any(map(_is_number, names)):
        return None
    # A single word is probably a remark, unless it has a unit.
    return names if width > 1 or split_unit(names[0])[1] in _UNITS else None
