"""Text tables: CSV, TSV and columns separated by spaces, with decimal points or decimal commas."""

import codecs
import csv
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.errors import FileError
from hapticnet.recordings.columns import printable
from hapticnet.recordings.layout import OPEN_QUOTE, csv_reason, find_layout, is_missing, number_of, split_cells
from hapticnet.recordings.numpy_files import check_columns
from hapticnet.recordings.times import is_stamp, stamp_us

LONGEST_LINE: Final = 2**20
"""Limit of the characters in a line; a file with a longer one is not a table."""

_SAMPLE_ROWS: Final = 100
_BLOCK_BYTES: Final = 2**20
_SKIPPED: Final = ("", "#", "%")


class _IrregularError(Exception):
    """A line that NumPy's parser cannot read as this class does."""


class DelimitedSource:
    """A text table as columns; satisfies `sources.Source`. `layout.find_layout` finds its separators and header.

    Blank lines and lines that start with ``#`` or ``%`` are skipped. Columns that are not requested may contain
    anything. The file is read line by line, so memory holds the requested columns only.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
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
        self._layout = find_layout(path, sample, comment)
        self.names = self._layout.names
        self.notes = self._layout.notes
        if self._encoding == "latin-1":
            self.notes = ("the text is not UTF-8; it is read as Latin-1", *self.notes)
        if len(sample) == self._layout.header_rows:
            raise FileError(f"{path}: there are no rows under the header")
        self._sample = [split_cells(line, self._layout.separator) for _, line in sample[self._layout.header_rows :]]

    def numbers(self, indices: Sequence[int]) -> FloatArray:
        """Return columns, shape (rows, columns), with NaN where a cell is empty or says NaN, NA, N/A or null.

        Raises
        ------
        FileError
            If a cell is not a finite number, or a row has more or fewer cells than the header.
        """
        fast = self._numbers_at_once(indices)
        return self._numbers_by_cell(indices) if fast is None else fast

    def has_stamps(self, index: int) -> bool:
        """Return whether a column holds dates and times in ISO 8601: its first cell that is not empty does."""
        cells = (row[index] for row in self._sample if index < len(row))
        return is_stamp(next((cell for cell in cells if not is_missing(cell)), ""))

    def stamps_us(self, index: int) -> IntArray:
        """Return a column of ISO 8601 stamps in µs since 1970, shape (rows,); `times.NO_STAMP` where it is empty.

        Raises
        ------
        FileError
            If a cell is not such a stamp.
        """
        stamps = []
        for row, cells in enumerate(self._cells()):
            stamp = stamp_us(cells[index])
            if stamp is None:
                raise self._fault(row, index, cells[index], "a date and time in ISO 8601")
            stamps.append(stamp)
        return np.array(stamps, dtype=np.int64)

    def place(self, row: int) -> str:
        """Return where a row is in the file, for a message."""
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
                number = math.nan if is_missing(cell) else number_of(cell, comma=self._layout.separator != ",")
                if number is None or math.isinf(number):
                    raise self._fault(row, index, cell, "a finite number")
                point = point or (cell if "." in cell else "")
                comma = comma or (cell if "," in cell else "")
                if point and comma:
                    raise FileError(
                        f"{self._cell(row, index)}: numbers with a decimal point and with a decimal comma in one file:"
                        f' "{printable(point)}" and "{printable(comma)}"'
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
                    raise csv.Error(OPEN_QUOTE)
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
            raise FileError(f"{self.path}, {self.place(row)}: {csv_reason(error)}") from error

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
            yield line

    def _fault(self, row: int, index: int, cell: str, expected: str) -> FileError:
        return FileError(f'{self._cell(row, index)}: "{printable(cell[:60])}" is not {expected}')

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
