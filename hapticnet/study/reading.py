"""Reading of a study's files, wherever they lie in a folder."""

from pathlib import Path

from hapticnet.errors import FileError
from hapticnet.files import open_regular
from hapticnet.study import store
from hapticnet.study.rows import AnyRow, OrderRow, columns
from hapticnet.study.weber import ParticipantFile, load_participant


def table_files(folder: Path, kind: type[AnyRow]) -> list[Path]:
    """Return the tables of a kind in a folder and below, in order of their names.

    Raises
    ------
    FileError
        If the folder does not exist.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    mark = "order_true" if kind is OrderRow else "reference_n"
    found = []
    for file in sorted(folder.rglob("*.tsv")):
        with open_regular(file) as lines:
            names = lines.readline(100_000).decode(errors="replace").rstrip("\r\n").split("\t")
        if mark in names and "event" in names:
            _check_names(file, kind, names)
            found.append(file)
    return found


def _check_names(file: Path, kind: type[AnyRow], names: list[str]) -> None:
    """Raise FileError if a table has a column that no session writes; what is missing counts as not available."""
    strange = [name for name in names if name not in columns(kind)]
    if strange or len(set(names)) < len(names):
        which = f'the column "{strange[0][:40]}"' if strange else "a column twice"
        raise FileError(f"{file}: has {which}, which no session writes: it was changed, or by another version")


def read_rows(folder: Path, kind: type[AnyRow]) -> list[AnyRow]:
    """Return the rows of every table of a kind in a folder and below, table by table.

    Raises
    ------
    FileError
        If the folder does not exist, a table cannot be read, or two tables have the same session of a participant.
    """
    found: list[AnyRow] = []
    tables: dict[tuple[str, int], Path] = {}
    for file in table_files(folder, kind):
        rows = store.read_rows(file, kind)
        for session in dict.fromkeys((row.participant, row.session) for row in rows):
            if session in tables:
                raise FileError(
                    f"{tables[session]} and {file} both have session {session[1]} of participant {session[0]};"
                    " keep one of them, or name the folder of one"
                )
            tables[session] = file
        found += rows
    return found


def read_people(folder: Path) -> list[ParticipantFile]:
    """Return what was measured of each participant, from ``participants/*.toml`` in a folder and below."""
    return [load_participant(file) for file in sorted(folder.rglob("participants/*.toml"))]
