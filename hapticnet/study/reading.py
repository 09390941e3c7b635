"""Reading of a study's tables, wherever they lie in a folder."""

import csv
from pathlib import Path
from typing import TypeVar

from hapticnet.errors import FileError
from hapticnet.files import MAX_BYTES, read_text
from hapticnet.study.rows import LimitsRow, OrderRow, Row, from_cells

AnyRow = TypeVar("AnyRow", bound=Row)


def read_rows(folder: Path, kind: type[AnyRow]) -> list[AnyRow]:
    """Return the rows of every table of a kind in a folder and below, table by table.

    The last line of a table may be torn by a crash; without its line feed it is left out.

    Raises
    ------
    FileError
        If the folder does not exist or a table cannot be read.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    mark = "order_true" if kind is OrderRow else "reference_n"
    found: list[AnyRow] = []
    for file in sorted(folder.rglob("*.tsv")):
        text = read_text(file, MAX_BYTES)
        lines = text[: text.rfind("\n") + 1].split("\n")[:-1]
        table = list(csv.reader(lines, delimiter="\t", quoting=csv.QUOTE_NONE))
        if not table or mark not in table[0] or "event" not in table[0]:
            continue
        for number, cells in enumerate(table[1:], start=2):
            try:
                found.append(from_cells(kind, table[0], cells))
            except FileError as error:
                raise FileError(f"{file}, line {number}: {error}") from error
    return found


def read_limits(folder: Path) -> list[LimitsRow]:
    """Return the accepted answers of the measurement of the JND in a folder and below."""
    return [row for row in read_rows(folder, LimitsRow) if row.event == "trial"]
