"""Run a session with its plan, schedule, law and table, and record its trials."""

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import tomli_w

from hapticnet.errors import FileError, SettingsError, UnavailableError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import fresh_path, make_folder, replacing
from hapticnet.perception import WeberLaw
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.session import REPORT, Event, Session
from hapticnet.runtime.recorder import about_master, event_text
from hapticnet.runtime.system import start_background
from hapticnet_experiment.flow import Flow
from hapticnet_experiment.fronts import Front
from hapticnet_experiment.plan import PLAN_FILE, Plan, find_plan
from hapticnet_experiment.rig import Outcome, Rig
from hapticnet_experiment.rows import AnyRow, OrderRow, Row
from hapticnet_experiment.schedule import Schedule, participant_number
from hapticnet_experiment.store import Store, opened, read_table, stored_schedule
from hapticnet_experiment.tasks import LIMITS, ORDER, PRACTICE, LimitsFlow, OrderFlow, device_errors_n
from hapticnet_experiment.trial import Played
from hapticnet_experiment.weber import ParticipantFile, load_participant, participant_file

FLOWS: Final[dict[str, type[Flow[Any]]]] = {ORDER: OrderFlow, LIMITS: LimitsFlow}


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSettings:
    """The participant of a session, and its folder."""

    task: str  # `ORDER` or `LIMITS`
    participant: str  # number, such as "03"
    session: int
    seed: int
    plan: Plan
    out: Path
    observer: str | None  # name of the simulated observer; None for a person
    device: str
    resume: bool = False  # whether to continue an interrupted session

    @property
    def folder(self) -> Path:
        """Folder of the session."""
        return self.out / f"sub-{self.participant}" / f"ses-{self.session}" / self.task

    @property
    def table(self) -> Path:
        """Table of the session, named as in BIDS."""
        return self.folder / f"sub-{self.participant}_ses-{self.session}_task-{self.task}_beh.tsv"

    @property
    def constants(self) -> dict[str, Any]:
        """Values of columns that are the same in all rows."""
        return {name: getattr(self, name) for name in ("participant", "session", "observer", "device")}

    def schedule(self) -> Schedule:
        """Return the schedule of the session: the stored one if it continues, else a new one."""
        kind = FLOWS[self.task].schedule_kind
        stored = stored_schedule(self.folder) if self.resume else None
        if stored is None:
            return kind.draw(self.plan, self.participant, self.session, self.seed)
        schedule = kind.from_json(stored, str(self.folder))
        if schedule.plan != self.plan.digest():
            raise SettingsError("the session was begun with another plan; continue with that one")
        return schedule


def check_number(settings: SessionSettings) -> None:
    """Raise SettingsError if a participant is not a number, or spelled differently in the folder, such as 03 for 3."""
    number = participant_number(settings.participant)
    for folder in settings.out.glob("sub-*"):
        other = folder.name.removeprefix("sub-")
        if other != settings.participant and other.isdecimal() and int(other) == number:
            raise SettingsError(
                f"participant {settings.participant}: {settings.out} has participant {other}, who has the same number;"
                f" give --participant {other} to continue that one, or another number"
            )


def check_session(settings: SessionSettings) -> None:
    """Check that a session can begin or continue, before anything is opened.

    Raise SettingsError if the number cannot be used, the session exists but should not continue or vice versa, or
    the folder has the data of people and the session is of a simulated observer or vice versa.
    """
    check_number(settings)
    table = settings.table
    if table.exists() and not settings.resume:
        how = "continue it with --resume, or choose another --session"
        raise SettingsError(f"{table} exists; {how if settings.observer is None else 'choose another --out-dir'}")
    if settings.resume and not table.exists():
        raise SettingsError(
            f"{table} does not exist, so there is nothing to continue; check --participant, --session and --out-dir,"
            " or leave out --resume"
        )
    for other in sorted(settings.out.glob("sub-*/ses-*/*/*_beh.tsv")):
        for row in read_table(other, Row, most=1):
            if (row.observer is None) != (settings.observer is None) and other != table:
                theirs = "a person" if row.observer is None else f"the simulated observer {row.observer!r}"
                raise SettingsError(
                    f"{settings.out} has answers of {theirs} (participant {row.participant}); keep people and simulated"
                    " observers in separate folders, with --out-dir"
                )


def participant_path(out: Path, participant: str) -> Path:
    """Return the file with a participant's JND."""
    return out / "participants" / f"{participant}.toml"


def keep_plan(plan: Plan, out: Path) -> None:
    """Store the plan with the data; raise SettingsError if the folder holds data of another plan."""
    path = out / PLAN_FILE
    if path.exists():
        if find_plan(str(path)).digest() != plan.digest():
            raise SettingsError(f"{path} differs from the given plan; choose another folder with --out-dir")
        return
    make_folder(out)
    with replacing(path, follow=False) as file:
        file.write(tomli_w.dumps(plan.model_dump()))


@dataclass(frozen=True, slots=True)
class ChosenLaw:
    """The law of an ordering task at 1 JND."""

    law: WeberLaw
    source: str  # the participant's file, or the plan with the reason

    def describe(self) -> str:
        """Return a line for the experimenter."""
        return f"1 JND is {100 * self.law.weber_fraction:.4g} %, at least {self.law.floor_n:.4g} N, from {self.source}"


def law_of_participant(settings: SessionSettings) -> ChosenLaw:
    """Return the law at 1 JND: the session's initial one, or the participant's own, or the plan's.

    Raise SettingsError if the plan requires the participant's own JND and no valid one exists.
    """
    table, jnd = settings.table, settings.plan.jnd
    for row in read_table(table, OrderRow, most=1) if settings.resume and table.exists() else ():
        if row.weber_fraction is not None and row.floor_n is not None:
            began = WeberLaw(weber_fraction=row.weber_fraction, floor_n=row.floor_n)
            return ChosenLaw(began, row.jnd_source or "the start of the session")
    of_plan = WeberLaw(weber_fraction=jnd.weber_fraction, floor_n=jnd.floor_n)
    if jnd.measured == "ignored":
        return ChosenLaw(of_plan, "the plan, which ignores measured JNDs")
    first = participant_path(settings.out, settings.participant)
    refused = []
    for path in [first, *sorted(first.parent.glob(f"{settings.participant}-session-*.toml"))]:
        if path.exists():
            measured = load_participant(path)
            why_not = _unusable(measured, settings)
            if why_not is None:
                return ChosenLaw(measured.law, f"{path.relative_to(settings.out)}, measured")
            refused.append(f"{path.relative_to(settings.out)} {why_not}")
    reason = "; ".join(refused) or f"{first} does not exist"
    if jnd.measured == "required":
        raise SettingsError(
            f"the plan requires the participant's own JND, but {reason}: measure it first, with 'hapticnet experiment"
            f" limits --participant {settings.participant}' and the same --device"
        )
    return ChosenLaw(of_plan, f"the plan: {'; '.join(refused) or 'no JND was measured'}")


def _unusable(measured: ParticipantFile, settings: SessionSettings) -> str | None:
    if measured.simulated != settings.observer:
        return "is of a person" if measured.simulated is None else f"is of the simulated observer {measured.simulated}"
    if not same_device(measured.device, settings.device):
        return f"was measured with the device {measured.device}, not with {settings.device}"
    return f"is excluded: {'; '.join(measured.excluded)}" if measured.excluded else None


def same_device(one: str | None, other: str | None) -> bool:
    """Return whether two devices, as written for ``--device``, may be the same; a port changes with each plugging."""
    return one == other or bool(one and other and one.startswith("serial:") and other.startswith("serial:"))


@contextmanager
def open_session(settings: SessionSettings, now_us: int) -> Iterator[tuple[Flow[Any], Store[Any]]]:
    """Yield flow and table of a session."""
    check_number(settings)
    keep_plan(settings.plan, settings.out)
    flow, constants = FLOWS[settings.task], settings.constants
    if settings.task == ORDER:
        law = law_of_participant(settings)
        constants |= {"weber_fraction": law.law.weber_fraction, "floor_n": law.law.floor_n, "jnd_source": law.source}
    schedule, levels = settings.schedule(), settings.plan.texts.levels
    with opened(settings.table, flow.kind, schedule.to_json(), resume=settings.resume, levels=levels) as store:
        rows = _rows_to_go_on_with(settings, store)
        yield flow(settings.plan, schedule, rows, now_us, constants), store


def _rows_to_go_on_with(settings: SessionSettings, store: Store[Any]) -> list[Any]:
    """Return the rows of earlier runs; raise SettingsError if they are of another observer or device."""
    for row in store.rows[:1]:
        if row.observer != settings.observer:
            began = "a person" if row.observer is None else f"the simulated observer {row.observer!r}"
            raise SettingsError(f"{store.path} was begun by {began} and can only continue that way")
        if not same_device(row.device, settings.device):
            raise SettingsError(
                f"{store.path} was begun with the device {row.device}, not {settings.device}; continue with that,"
                " or begin another --session"
            )
    return store.rows


def write_participant(settings: SessionSettings, flow: LimitsFlow) -> tuple[Path, ParticipantFile]:
    """Write the measured JND; raise SettingsError if none was found. An earlier session keeps its file."""
    procedure = flow.procedure
    measured = participant_file(
        settings.participant,
        settings.plan.limits,
        procedure.by_reference(),
        device_errors_n=device_errors_n(flow.rows),
        false_alarms=procedure.false_alarms,
        catch_pairs=procedure.catch_pairs,
        simulated=settings.observer,
        device=settings.device,
        date=today(),
        version=version(),
    )
    path = participant_path(settings.out, settings.participant)
    make_folder(path.parent)
    if path.exists() and load_participant(path).measured_differently(measured):
        path = path.with_name(f"{settings.participant}-session-{settings.session}.toml")
    with replacing(path, follow=False) as file:
        file.write(measured.to_toml())
    return path, measured


def today() -> str:
    """Return date and time (UTC) for the rows."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def version() -> str:
    """Return the version of hapticnet."""
    return str(provenance()["version"])


def account_of(settings: SessionSettings, flow: Flow[Any]) -> dict[str, Any]:
    """Return the report of a session for the command line, without conditions and a person's scores.

    Writes the file of a participant whose JND was measured.
    """
    if isinstance(flow, LimitsFlow):
        try:
            path, measured = write_participant(settings, flow)
        except SettingsError as error:
            return {"participant": settings.participant, "no_jnd": str(error)}
        return {"file": str(path), **measured.model_dump()}
    trials = [row for row in flow.rows if row.event == "trial"]
    score = {} if settings.observer is None else {"correct": sum(row.correct or 0 for row in trials)}
    first = flow.rows[0]
    return {
        "participant": settings.participant,
        "weber_fraction": first.weber_fraction,
        "floor_n": first.floor_n,
        "jnd_source": first.jnd_source,
        "trials": len(trials),
        **score,
        "repeated": sum(row.event == "repeated" for row in flow.rows),
        "aborted": sum(row.event == "aborted" for row in flow.rows),
        "table": str(settings.table),
    }


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

    `on_outcome` is called in a thread with each row of an activity, once it is stored, and with the outcome of the
    activity; `on_row` with each row. Raise FileError if a row cannot be stored,
    UnavailableError if the session cannot continue.
    """
    own_version = version()

    def save() -> list[AnyRow]:
        rows = [replace(row, date=date(), version=own_version) for row in flow.take_rows()]
        for row in rows:
            store.append(row)
            on_row(row)
        return rows

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
        save()  # rows noted meanwhile do not belong to the activity
        flow.complete(outcome, rig.now_us())
        for row in save():
            if on_outcome is not None and row.event != "started":  # it belongs to the next activity
                await _beside(partial(on_outcome, row, outcome))  # the device continues meanwhile
    await front.show(flow)
    if flow.declined:
        raise UnavailableError("the participant did not agree to take part; nothing was asked or measured")
    if flow.failure is not None:
        raise UnavailableError(f"{flow.failure}; every answer is stored, continue with --resume")


async def _beside(work: Callable[[], None]) -> None:
    """Do work in a thread at normal priority, and wait for it without blocking the loop."""
    done = Future[None]()
    done.set_running_or_notify_cancel()  # a cancelled session does not cancel the recording

    def body() -> None:
        try:
            work()
            done.set_result(None)
        except BaseException as error:  # it is raised where it is awaited
            done.set_exception(error)

    start_background(body, "recording of a trial")
    await asyncio.wrap_future(done)


def record_trials(settings: SessionSettings, about: dict[str, Any]) -> Callable[[AnyRow, Outcome], None]:
    """Return the recorder of each played trial, answered or not; `about` is the session's configuration, for each."""
    folder = settings.folder / "recordings"
    study = {**settings.constants, "plan": settings.plan.name, "digest": settings.plan.digest()}
    about = {**about, "study": study, "provenance": provenance()}

    def keep(row: AnyRow, outcome: Outcome) -> None:
        if not isinstance(outcome, Played):
            return
        make_folder(folder)
        kind = "practice" if getattr(row, "condition", None) == PRACTICE else "trial"
        path = fresh_path(folder / f"{kind}-{row.this_n or 0:03d}-{row.attempt or 0}.npz")
        tables = {"tick": outcome.ticks, "datagram": outcome.datagrams}
        facts = about | about_master(outcome.settings) | {"trial": asdict(row), REPORT: {"outcome": row.event}}
        events = tuple(Event(t_us, type(each).__name__, event_text(each)) for t_us, each in outcome.in_force)
        try:
            export(Session("master", facts, outcome.unix_offset_us, tables, events), path)
        except FileError as error:
            raise FileError(f"{error}; its answer is safe") from error

    return keep
