"""Tables of numbers in CSV files: recorded motions and forces in, results out.

A table is UTF-8 text, one row a line, cells separated by commas. Lines that start with ``#`` and blank lines are
passed over; a byte order mark, CRLF line ends and quoted cells are understood. The first line is the header,
unless every cell of it is a number: then the columns are called "0", "1", ….
"""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapticnet.errors import FileError
from hapticnet.files import replacing

Numbers: TypeAlias = NDArray[np.float64]


class Table:
    """What a CSV file holds: named columns of equal length.

    Columns that are never asked for may hold anything, text too.

    Attributes
    ----------
    path
        The file it came from.
    names
        The columns' names, from left to right.
    """

    __slots__ = ("_cells", "_line_numbers", "_values", "names", "path")

    def __init__(
        self,
        path: Path,
        names: tuple[str, ...],
        *,
        line_numbers: list[int],
        values: Numbers | None = None,
        cells: list[list[str]] | None = None,
    ) -> None:
        self.path = path
        self.names = names
        self._line_numbers = line_numbers
        self._values = values
        self._cells = cells or []

    def __len__(self) -> int:
        return len(self._line_numbers)

    def line_of(self, row: int) -> int:
        """Return the number, from 1, of the line of the file that `row`, from 0, stands on."""
        return self._line_numbers[row]

    def column(self, name_or_number: str) -> Numbers:
        """Return one column, shape (rows,), every value of it finite.

        Parameters
        ----------
        name_or_number
            The column's name; where no column has that name, its number counted from 0.

        Raises
        ------
        FileError
            When there is no such column or several, or a cell of it is not a finite number; names line and column.
        """
        index = self._index(name_or_number)
        values = self._parsed(index) if self._values is None else np.ascontiguousarray(self._values[:, index])
        faults = np.flatnonzero(~np.isfinite(values))
        if faults.size:
            row = int(faults[0])
            seen = f'"{self._cells[row][index][:60]}"' if self._cells else str(values[row])
            raise FileError(
                f'{self.path}, line {self.line_of(row)}, column "{self.names[index]}": {seen} is not a finite number'
            )
        return values

    def _index(self, name_or_number: str) -> int:
        matches = self.names.count(name_or_number)
        if matches == 1:
            return self.names.index(name_or_number)
        if matches > 1:
            raise FileError(
                f'{self.path}: {matches} columns are called "{name_or_number}"; '
                f"choose one by its number, 0 to {len(self.names) - 1}"
            )
        if name_or_number.isdecimal() and int(name_or_number) < len(self.names):
            return int(name_or_number)
        raise FileError(
            f'{self.path}: no column "{name_or_number}"; there are {", ".join(self.names)} '
            f"(or numbers 0 to {len(self.names) - 1})"
        )

    def _parsed(self, index: int) -> Numbers:
        """Return a column of a file that is not all numbers, with NaN where there is none."""
        numbers = [_number(cells[index]) for cells in self._cells]
        return np.array([math.nan if number is None else number for number in numbers])


def read_csv(path: Path) -> Table:
    """Read a CSV file.

    Raises
    ------
    FileError
        When the file cannot be read, is not UTF-8, has no rows, or a row has more or fewer cells than the header.
    """
    lines = _lines(path)
    kept = [number for number, line in enumerate(lines) if line.lstrip()[:1] not in ("", "#")]
    if not kept:
        raise FileError(f"{path}: there is nothing in it; a CSV file with a header and rows is wanted")
    header = _split(path, lines, kept[:1])[0]
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise FileError(f"{path}, line {kept[0] + 1}: cells are separated by {name}; commas are wanted")
    if all(_number(cell) is not None for cell in header):
        names = tuple(str(index) for index in range(len(header)))
    else:
        names = tuple(cell.strip() for cell in header)
        del kept[0]
    if not kept:
        raise FileError(f"{path}: there are no rows under the header")
    line_numbers = [number + 1 for number in kept]
    try:
        # C code, a microsecond a row. It gives up at the first text or quote, or when rows differ in length.
        values = np.loadtxt([lines[number] for number in kept], delimiter=",", comments=None, ndmin=2)
        if values.shape[1] == len(names):
            return Table(path, names, line_numbers=line_numbers, values=values)
    except ValueError:
        pass
    cells = _split(path, lines, kept)
    for line_number, row in zip(line_numbers, cells, strict=True):
        if len(row) != len(names):
            raise FileError(f"{path}, line {line_number}: {len(row)} cells; the first line has {len(names)}")
    return Table(path, names, line_numbers=line_numbers, cells=cells)


def write_csv(target: Path | TextIO, columns: Mapping[str, Sequence[float] | NDArray[Any]]) -> None:
    """Write columns of equal length under a header of their names, to a file or an open stream.

    Numbers read back bit for bit.

    Raises
    ------
    FileError
        When the file cannot be written.
    ValueError
        When the columns differ in length.
    """
    values = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns.values()]
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns of unequal length: {lengths}")
    if isinstance(target, Path):
        with replacing(target) as file:
            _write_rows(file, columns, values)
    else:
        _write_rows(target, columns, values)


def _write_rows(file: TextIO, names: Iterable[str], values: list[Any]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(zip(*values, strict=True))


def _lines(path: Path) -> list[str]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line_number = content.count(b"\n", 0, error.start) + 1
        raise FileError(f"{path}, line {line_number}: not UTF-8 text; save it as UTF-8 CSV") from error
    # str.splitlines would also break lines at characters that may stand in a cell.
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _split(path: Path, lines: list[str], kept: list[int]) -> list[list[str]]:
    """Return the cells of the lines numbered, from 0, in `kept`."""
    reader = csv.reader(lines[number] for number in kept)
    rows: list[list[str]] = []
    try:
        for row in reader:
            if reader.line_num != len(rows) + 1:
                break  # A quote left open made the reader go on to the next line.
            rows.append(row)
    except csv.Error as error:
        raise FileError(f"{path}, line {kept[len(rows)] + 1}: {error}") from error
    if len(rows) < len(kept):
        raise FileError(f"{path}, line {kept[len(rows)] + 1}: a quote is opened and not closed")
    return rows


def _number(cell: str) -> float | None:
    """Return the number a cell holds, or None. Python's digit separators are no part of a CSV number."""
    if "_" in cell:
        return None
    try:
        return float(cell)
    except ValueError:
        return None
