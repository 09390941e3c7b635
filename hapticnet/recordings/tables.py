"""CSV tables that hapticnet writes, and tables of known columns that it reads back."""

import csv
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from hapticnet.arrays import FloatArray
from hapticnet.errors import FileError
from hapticnet.files import MAX_BYTES, check_readable, replacing
from hapticnet.recordings.columns import find_column
from hapticnet.recordings.delimited import DelimitedSource


def read_csv(path: Path, columns: Sequence[str] | None = None, *, max_bytes: int = MAX_BYTES) -> dict[str, FloatArray]:
    """Read columns of a CSV file, in any form that `DelimitedSource` understands.

    Parameters
    ----------
    columns
        Names, or numbers from 0; None: all columns. The other columns may hold anything.

    Returns
    -------
    dict
        The columns by name, each finite and of shape (rows,).

    Raises
    ------
    FileError
        If the file cannot be read, lacks a column, or has a cell there that is not a finite number.
    """
    check_readable(path, max_bytes)
    source = DelimitedSource(path)
    names = source.names if columns is None else tuple(columns)
    indices = range(len(names)) if columns is None else [find_column(path, source.names, name) for name in names]
    values = source.numbers(list(indices))
    faults = np.argwhere(~np.isfinite(values))
    if len(faults):
        row, column = faults[0]
        raise FileError(f'{path}, {source.place(int(row))}, column "{names[column]}": no finite number')
    return {name: np.ascontiguousarray(values[:, index]) for index, name in enumerate(names)}


def write_csv(target: Path | TextIO, columns: Mapping[str, Sequence[float] | NDArray[Any]]) -> None:
    """Write columns of equal length under a header of their names, to a file or an open stream.

    Numbers read back bit for bit.

    Raises
    ------
    FileError
        If the file cannot be written.
    ValueError
        If the columns differ in length.
    """
    values = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns.values()]
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns of unequal length: {lengths}")
    with replacing(target) if isinstance(target, Path) else nullcontext(target) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*values, strict=True))
