"""A session recording of each trial beside the table, as ``hapticnet info``, ``export`` and ``replay`` read it."""

from collections.abc import Callable
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import FileError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import make_folder
from hapticnet.recordings.session.archive import FORMATS, check_mcap
from hapticnet.recordings.session.frames import Heading, Table
from hapticnet.recordings.session.session import REPORT
from hapticnet.runtime.recorder import event_text
from hapticnet.runtime.session_recordings import about_master
from hapticnet.study.order_flow import PRACTICE
from hapticnet.study.rig import Outcome
from hapticnet.study.rows import AnyRow
from hapticnet.study.session import ORDER, SessionSettings
from hapticnet.study.trial import Played

RecordingForm: TypeAlias = Literal["mcap", "npz", "none"]

MASTER: Final = "master"


def usual_form(*, real_time: bool) -> RecordingForm:
    """Return the form of recordings unless one is asked for.

    MCAP in real time where it is installed; NPZ in virtual time, where it takes a tenth of the time to write.
    """
    return "mcap" if real_time and find_spec("mcap") is not None else "npz"


def record_trials(
    settings: SessionSettings, form: RecordingForm, about: dict[str, Any]
) -> Callable[[AnyRow, Outcome], None] | None:
    """Return what records each trial that was played, answered or not; None if nothing is recorded.

    A recording is never overwritten.

    Parameters
    ----------
    about
        Configuration of the session, for every file.

    Raises
    ------
    UnavailableError
        If the form needs an extra that is not installed.
    """
    if form == "none":
        return None
    if form == "mcap":
        check_mcap()
    folder = settings.folder(ORDER) / "recordings"
    about = {**about, "study": _about(settings), "provenance": provenance()}

    def keep(row: AnyRow, outcome: Outcome) -> None:
        if not isinstance(outcome, Played):
            return
        make_folder(folder)
        number = 0 if row.this_n is None else row.this_n
        kind = "practice" if getattr(row, "condition", None) == PRACTICE else "trial"
        path = _fresh(folder, f"{kind}-{number:03d}-{row.attempt or 0}", form)
        account = asdict(row)
        tables = {"tick": outcome.ticks, "datagram": outcome.datagrams}
        heading = Heading(
            path=path,
            side=MASTER,
            tables=tuple(Table.of(name, tuple(columns)) for name, columns in tables.items()),
            unix_offset_us=outcome.unix_offset_us,
            about=about | about_master(outcome.settings) | {"trial": account},
        )
        try:
            writer = FORMATS[path.suffix](heading)
            for t_us, settings_in_force in outcome.in_force:
                writer.event(t_us, type(settings_in_force).__name__, event_text(settings_in_force))
            for index, columns in enumerate(tables.values()):
                if rows := _rows(columns):
                    writer.rows(index, rows[0])
            writer.finish({REPORT: {"outcome": row.event}})
        except (OSError, UnavailableError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FileError(f"{path}: the recording cannot be written: {reason}; its answer is safe") from error

    return keep


def _fresh(folder: Path, stem: str, form: RecordingForm) -> Path:
    """Return the path of a file that does not exist."""
    path, number = folder / f"{stem}.{form}", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.{form}", number + 1
    return path


def _rows(columns: dict[str, FloatArray]) -> list[FloatArray]:
    """Return the rows of a table, shape (n, columns), or nothing if there are none."""
    table = np.column_stack(list(columns.values()))
    return [table] if len(table) else []


def _about(settings: SessionSettings) -> dict[str, Any]:
    return {**settings.constants, "plan": settings.plan.name, "digest": settings.plan.digest()}
