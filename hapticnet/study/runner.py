"""Run a session: let a front and a rig play a flow, store each row before the next event begins, record each trial.

The recordings are beside the table, and ``hapticnet info``, ``export`` and ``replay`` read them.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias

from hapticnet.errors import FileError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import make_folder
from hapticnet.recordings.session.archive import check_mcap
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.session import REPORT, Event, Session
from hapticnet.runtime.recorder import about_master, event_text
from hapticnet.runtime.system import start_background
from hapticnet.study.flow import Flow
from hapticnet.study.fronts import Front
from hapticnet.study.rig import Outcome, Rig
from hapticnet.study.rows import AnyRow
from hapticnet.study.session import SessionSettings, today, version
from hapticnet.study.store import Store
from hapticnet.study.tasks import PRACTICE
from hapticnet.study.trial import Played

RecordingForm: TypeAlias = Literal["mcap", "npz", "none"]


async def conduct(
    flow: Flow[AnyRow],
    rig: Rig,
    front: Front,
    store: Store[AnyRow],
    *,
    date: Callable[[], str] = today,
    on_outcome: Callable[[AnyRow, Outcome], None] | None = None,
    on_row: Callable[[AnyRow], None] = lambda _row: None,
) -> None:
    """Conduct a session to its end.

    `on_outcome` is called in a thread with each row that an activity left and with what came of the activity, once the
    row is stored; `on_row` with each row, also with one that was stored before the session went on.

    Raise FileError if a row cannot be stored, UnavailableError if the session cannot go on.
    """
    own_version = version()

    def save() -> list[AnyRow]:
        rows = [replace(row, date=date(), version=own_version) for row in flow.take_rows()]
        new = [row for row in rows if store.append(row)]
        for row in rows:
            on_row(row)
        return new

    save()
    while not flow.done:
        await front.show(flow)
        if flow.activity is None:
            key = await front.key(flow)
            if key:
                flow.press(key, rig.now_us())
            save()
            continue
        activity = asyncio.ensure_future(rig.run(flow.activity))
        try:
            outcome = await front.attend(flow, activity, rig)
        finally:
            if not activity.done():
                rig.stop()
                await activity
        save()  # what was noted meanwhile did not come of the activity
        flow.complete(outcome, rig.now_us())
        for row in save():
            if on_outcome is not None and row.event != "started":  # it is of the next activity
                await _beside(partial(on_outcome, row, outcome))  # the device goes on meanwhile
    await front.show(flow)
    if flow.declined:
        raise UnavailableError("the participant did not agree to take part; nothing was asked or measured")
    if flow.failure is not None:
        raise UnavailableError(f"{flow.failure}; everything answered is stored, go on with --resume")


async def _beside(work: Callable[[], None]) -> None:
    """Do work in a thread at normal priority, and wait for it without holding up the loop."""
    done = Future[None]()
    done.set_running_or_notify_cancel()  # a session that is cancelled does not cancel the recording

    def body() -> None:
        try:
            work()
            done.set_result(None)
        except BaseException as error:  # it is raised where it is awaited
            done.set_exception(error)

    start_background(body, "recording of a trial")
    await asyncio.wrap_future(done)


def usual_form(*, real_time: bool) -> RecordingForm:
    """Return the form of recordings unless one is asked for.

    MCAP in real time where it is installed; NPZ in virtual time, where it takes a tenth of the time to write.
    """
    return "mcap" if real_time and find_spec("mcap") is not None else "npz"


def record_trials(
    settings: SessionSettings, form: RecordingForm, about: dict[str, Any]
) -> Callable[[AnyRow, Outcome], None] | None:
    """Return what records each trial that was played, answered or not; None if nothing is recorded.

    A recording is never overwritten. `about` is the configuration of the session, for every file.
    Raise UnavailableError if the form needs an extra that is not installed.
    """
    if form == "none":
        return None
    if form == "mcap":
        check_mcap()
    folder = settings.folder / "recordings"
    study = {**settings.constants, "plan": settings.plan.name, "digest": settings.plan.digest()}
    about = {**about, "study": study, "provenance": provenance()}

    def keep(row: AnyRow, outcome: Outcome) -> None:
        if not isinstance(outcome, Played):
            return
        make_folder(folder)
        kind = "practice" if getattr(row, "condition", None) == PRACTICE else "trial"
        path = _unused(folder, f"{kind}-{row.this_n or 0:03d}-{row.attempt or 0}", form)
        tables = {"tick": outcome.ticks, "datagram": outcome.datagrams}
        facts = about | about_master(outcome.settings) | {"trial": asdict(row), REPORT: {"outcome": row.event}}
        events = tuple(Event(t_us, type(each).__name__, event_text(each)) for t_us, each in outcome.in_force)
        try:
            export(Session("master", facts, outcome.unix_offset_us, tables, events), path)
        except (FileError, UnavailableError) as error:
            raise FileError(f"{error}; the answer to it is safe") from error

    return keep


def _unused(folder: Path, stem: str, form: RecordingForm) -> Path:
    """Return the path of a file that does not exist."""
    path, number = folder / f"{stem}.{form}", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.{form}", number + 1
    return path
