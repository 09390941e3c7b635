"""Set up a session: its plan, its schedule, its law, its table."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import tomli_w

from hapticnet.errors import SettingsError
from hapticnet.experiment.provenance import provenance
from hapticnet.files import make_folder, replacing
from hapticnet.perception import WeberLaw
from hapticnet.study.limits_flow import LimitsFlow, LimitsSchedule, device_errors_n, draw_limits
from hapticnet.study.order_flow import OrderFlow
from hapticnet.study.plan import Plan, find_plan
from hapticnet.study.rows import AnyRow, LimitsRow, OrderRow
from hapticnet.study.schedule import OrderSchedule, draw_order, participant_number
from hapticnet.study.store import Store, opened, session_folder, stored_schedule, table_name
from hapticnet.study.weber import ParticipantFile, load_participant, participant_file

PLAN_FILE: Final = "plan.toml"
ORDER: Final = "order"
LIMITS: Final = "limits"


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSettings:
    """Whose session it is, and where its data go.

    Attributes
    ----------
    participant
        Number of the participant, such as "03".
    observer
        Name of the simulated observer; None for a person.
    device
        Description of the device.
    resume
        Whether an interrupted session goes on.
    hurried
        Whether breaks last no time, for a simulated observer in real time.
    """

    participant: str
    session: int
    seed: int
    plan: Plan
    out: Path
    observer: str | None
    device: str
    resume: bool = False
    hurried: bool = False

    @property
    def conducted_plan(self) -> Plan:
        """The plan as it is conducted."""
        if not self.hurried:
            return self.plan
        parts = {"order": self.plan.order, "limits": self.plan.limits}
        return self.plan.model_copy(
            update={name: part.model_copy(update={"break_s": 0.0}) for name, part in parts.items()}
        )

    @property
    def constants(self) -> dict[str, Any]:
        """Values of columns that are the same in all rows."""
        return {
            "participant": self.participant,
            "session": self.session,
            "observer": self.observer,
            "device": self.device,
        }

    def folder(self, task: str) -> Path:
        """Return the folder of a part of the study."""
        return session_folder(self.out, self.participant, self.session, task)

    def table(self, task: str) -> Path:
        """Return the table of a part of the study."""
        return self.folder(task) / table_name(self.participant, self.session, task)


def check_number(settings: SessionSettings) -> None:
    """Check the number of a participant, and that the folder does not have it in another spelling.

    Raises
    ------
    SettingsError
        If it is not a number, or the folder has the data of participant 03 and 3 is given.
    """
    number = participant_number(settings.participant)
    for folder in settings.out.glob("sub-*"):
        other = folder.name.removeprefix("sub-")
        if other != settings.participant and other.isdecimal() and int(other) == number:
            raise SettingsError(
                f"participant {settings.participant}: {settings.out} has participant {other}, who has the same number;"
                f" give --participant {other} to go on with that one, or another number"
            )


def participant_path(out: Path, participant: str) -> Path:
    """Return the file with a participant's JND."""
    return out / "participants" / f"{participant}.toml"


def keep_plan(plan: Plan, out: Path) -> None:
    """Store the plan with the data; a folder holds the data of one plan.

    Raises
    ------
    SettingsError
        If the folder holds data of another plan.
    FileError
        If it cannot be written.
    """
    path = out / PLAN_FILE
    if path.exists():
        if find_plan(str(path)).digest() != plan.digest():
            raise SettingsError(f"{path} is another plan than the one given; choose another folder with --out")
        return
    make_folder(out)
    with replacing(path) as file:
        file.write(tomli_w.dumps(plan.model_dump()))


def order_schedule(settings: SessionSettings) -> OrderSchedule:
    """Return the schedule of a session: the stored one if it goes on, else a new one."""
    stored = stored_schedule(settings.folder(ORDER)) if settings.resume else None
    if stored is None:
        return draw_order(settings.plan, settings.participant, settings.session, settings.seed)
    schedule = OrderSchedule.from_json(stored, str(settings.folder(ORDER)))
    _check_plan(schedule.plan, settings.plan)
    return schedule


def limits_schedule(settings: SessionSettings) -> LimitsSchedule:
    """Return the schedule of a measurement: the stored one if it goes on, else a new one."""
    stored = stored_schedule(settings.folder(LIMITS)) if settings.resume else None
    if stored is None:
        return draw_limits(settings.plan, settings.participant, settings.session, settings.seed)
    schedule = LimitsSchedule.from_json(stored, str(settings.folder(LIMITS)))
    _check_plan(schedule.plan, settings.plan)
    return schedule


def law_of_participant(settings: SessionSettings) -> WeberLaw:
    """Return the law at 1 JND: the plan's, or the participant's own where the plan asks for it.

    Raises
    ------
    SettingsError
        If the participant's JND was not measured but is needed.
    FileError
        If it cannot be read.
    """
    jnd = settings.plan.jnd
    if not jnd.measured:
        return WeberLaw(weber_fraction=jnd.weber_fraction, floor_n=jnd.floor_n)
    path = participant_path(settings.out, settings.participant)
    if not path.exists():
        raise SettingsError(
            f"{path} does not exist, but the plan asks for the participant's own JND: measure it first, with"
            f" 'hapticnet experiment limits --participant {settings.participant}'"
        )
    return load_participant(path).law


@contextmanager
def order_session(settings: SessionSettings, now_us: int) -> Iterator[tuple[OrderFlow, Store[OrderRow]]]:
    """Yield flow and table of the ordering task."""
    check_number(settings)
    keep_plan(settings.plan, settings.out)
    law, schedule = law_of_participant(settings), order_schedule(settings)
    name = settings.table(ORDER).name
    with opened(settings.folder(ORDER), name, OrderRow, schedule=schedule.to_json(), resume=settings.resume) as store:
        _check_observer(settings, store)
        yield OrderFlow(settings.conducted_plan, schedule, law, store.rows, now_us, settings.constants), store


@contextmanager
def limits_session(settings: SessionSettings, now_us: int) -> Iterator[tuple[LimitsFlow, Store[LimitsRow]]]:
    """Yield flow and table of the measurement of the JND."""
    check_number(settings)
    keep_plan(settings.plan, settings.out)
    schedule = limits_schedule(settings)
    name = settings.table(LIMITS).name
    with opened(settings.folder(LIMITS), name, LimitsRow, schedule=schedule.to_json(), resume=settings.resume) as store:
        _check_observer(settings, store)
        yield LimitsFlow(settings.conducted_plan, schedule, store.rows, now_us, settings.constants), store


def write_participant(settings: SessionSettings, flow: LimitsFlow) -> tuple[Path, ParticipantFile]:
    """Write what was measured; an earlier session of the same participant keeps its file under its own name.

    Raises
    ------
    SettingsError
        If no JND was found.
    """
    procedure = flow.procedure
    catches = getattr(procedure, "catches", None)
    measured = participant_file(
        settings.participant,
        settings.plan.limits.method,
        procedure.by_reference(),
        device_errors_n=device_errors_n(flow.rows),
        false_alarms=getattr(procedure, "false_alarms", None),
        catch_series=catches,
        simulated=settings.observer,
        date=today(),
        version=version(),
    )
    path = participant_path(settings.out, settings.participant)
    make_folder(path.parent)
    if path.exists() and load_participant(path).measured_differently(measured):
        path = path.with_name(f"{settings.participant}-session-{settings.session}.toml")
    with replacing(path) as file:
        file.write(measured.to_toml())
    return path, measured


def today() -> str:
    """Return date and time (UTC) for the rows."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def version() -> str:
    """Return the version of hapticnet."""
    return str(provenance()["version"])


def _check_observer(settings: SessionSettings, store: Store[AnyRow]) -> None:
    """Raise SettingsError if a session of a person would go on with an observer, or of one observer with another."""
    for row in store.rows[:1]:
        if row.observer != settings.observer:
            began = "a person" if row.observer is None else f"the simulated observer {row.observer!r}"
            raise SettingsError(f"{store.path} was begun by {began}; it can only go on so")


def _check_plan(digest: str, plan: Plan) -> None:
    if digest != plan.digest():
        raise SettingsError("the session was begun with another plan; go on with that one")


def account_of(settings: SessionSettings, flow: OrderFlow) -> dict[str, Any]:
    """Return the account of an ordering task for the command line: no condition, and no score of a person."""
    trials = [row for row in flow.rows if row.event == "trial"]
    score = {} if settings.observer is None else {"correct": sum(row.correct or 0 for row in trials)}
    return {
        "participant": settings.participant,
        "trials": len(trials),
        **score,
        "repeated": sum(row.event == "repeated" for row in flow.rows),
        "aborted": sum(row.event == "aborted" for row in flow.rows),
        "table": str(settings.table(ORDER)),
    }
