"""Options and steps that both parts of a study share."""

import re
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias

import typer

if TYPE_CHECKING:
    from hapticnet.cli.experiment.page import Screen
    from hapticnet.device.profile import Profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.runtime.serial_port import Wire
    from hapticnet.study.flow import Flow
    from hapticnet.study.limits_flow import LimitsSchedule
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.plan import Plan
    from hapticnet.study.real_rig import RealRig
    from hapticnet.study.rig import Outcome
    from hapticnet.study.rows import AnyRow
    from hapticnet.study.schedule import OrderSchedule
    from hapticnet.study.session import SessionSettings
    from hapticnet.study.store import Store

MOST_PARTICIPANTS: Final = 10_000

Participant: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="NUMBER", help="Number of the participant, such as 03; names are not stored. Simulated: also 01-08."
    ),
]
Session: TypeAlias = Annotated[int, typer.Option(min=1, help="Number of the session.")]
PlanOption: TypeAlias = Annotated[
    str, typer.Option("--plan", metavar="PLAN", help="paper, reachable (1.8, 3.15 and 4.5 N), or a TOML file.")
]
SeedOption: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed from which the whole session is drawn.")]
OutDir: TypeAlias = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the study.")]
Resume: TypeAlias = Annotated[bool, typer.Option(help="Go on with an interrupted session.")]
DryRun: TypeAlias = Annotated[bool, typer.Option(help="Print the schedule (with --json all of it); do nothing else.")]
Simulate: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="OBSERVER", help="A simulated observer in the participant's place, such as literature."),
]
WallClock: TypeAlias = Annotated[
    bool, typer.Option(help="Run a simulated observer in real time, as a person is, not in virtual time.")
]


@dataclass(frozen=True, slots=True)
class Asked:
    """What was asked for, checked.

    Attributes
    ----------
    participants
        Numbers of the participants; one, unless observers are simulated.
    observer
        The simulated observer, or None.
    """

    participants: tuple[str, ...]
    plan: "Plan"
    observer: "ObserverSettings | None"


def check(participant: str, plan: str, simulate: str | None, *, wall_clock: bool) -> Asked:
    """Return what was asked for; raise SettingsError if it cannot be done."""
    from hapticnet.errors import SettingsError
    from hapticnet.study.observers import parse_observer
    from hapticnet.study.plan import find_plan

    observer = None if simulate is None else parse_observer(simulate)
    if wall_clock and observer is None:
        raise SettingsError("--wall-clock is for simulated observers; a person is always in real time")
    participants = _participants(participant)
    if len(participants) > 1 and (observer is None or wall_clock):
        raise SettingsError(f"participants {participant}: several at once are for --simulate in virtual time")
    return Asked(participants, find_plan(plan), observer)


def _participants(text: str) -> tuple[str, ...]:
    """Return the participants written as 03 or 01-08."""
    from hapticnet.errors import SettingsError
    from hapticnet.study.schedule import participant_number

    match = re.fullmatch(r"([0-9]{1,6})-([0-9]{1,6})", text)
    if match is None:
        participant_number(text)
        return (text,)
    first, last = (int(number) for number in match.groups())
    if not first <= last < first + MOST_PARTICIPANTS:
        raise SettingsError(f"participants {text}: expected the first and the last, such as 01-08")
    width = len(match.group(1))
    return tuple(f"{number:0{width}d}" for number in range(first, last + 1))


def sessions_of(
    asked: Asked, task: str, *, session: int, seed: int, out: Path, device: str, resume: bool, wall_clock: bool
) -> "list[SessionSettings]":
    """Return the settings of each participant's session; raise SettingsError if one cannot begin."""
    from dataclasses import replace

    from hapticnet.study.session import SessionSettings, check_session

    sessions = [
        SessionSettings(
            participant=each,
            session=session,
            seed=seed,
            plan=asked.plan,
            out=out,
            observer=None if asked.observer is None else asked.observer.name,
            device=device,
            resume=resume,
            hurried=wall_clock,
            replays=resume and asked.observer is not None and not wall_clock,
        )
        for each in asked.participants
    ]
    begun = [each.table(task).exists() for each in sessions]
    if resume and any(begun):  # of several simulated participants, the last ones may not have begun
        sessions = [each if here else replace(each, resume=False) for each, here in zip(sessions, begun, strict=True)]
    for each in sessions:
        check_session(each, task)
    return sessions


def show_schedules(schedules: "Sequence[OrderSchedule | LimitsSchedule]", asked: Asked, as_json: bool) -> None:
    """Print what ``--dry-run`` asks for: a few lines for a person, or everything that was drawn as JSON."""
    import json

    from hapticnet.cli.console import show

    if as_json:
        print(json.dumps([json.loads(each.to_json()) for each in schedules], indent=1))
    else:
        show("\n".join(line for each in schedules for line in each.lines(asked.plan)))


@contextmanager
def real_fingertip(device: str, known: "Profile", seed: int) -> Iterator["tuple[Fingertip, Wire | None]"]:
    """Yield a device with its force loop for real time, and its wire."""
    from hapticnet.cli.console import complain
    from hapticnet.control.limits import LimitSettings
    from hapticnet.device.user import UserActuator
    from hapticnet.errors import SettingsError
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.runtime import devices

    if device == "none":
        raise SettingsError("the study needs a fingertip device; choose --device sim to rehearse without one")
    with devices.real_time_device(device, known, seed, complain) as (made, wire):
        if made is None or isinstance(made, UserActuator):
            raise SettingsError(f"device {device} renders forces by itself; the study measures its force loop")
        yield Fingertip(made, LimitSettings(), devices.control_settings(known)), wire


def remind_of_consent(asked: Asked, say: "Callable[[str], None]") -> None:
    """Tell an experimenter who is about to show a person the consent that is shipped."""
    from hapticnet.study.plan import ASK
    from hapticnet.study.texts import english

    if asked.observer is None and asked.plan.consent == ASK and asked.plan.texts.consent == english().consent:
        say(
            "the consent is the one that is shipped, which names neither the study nor whom to ask: adapt it with"
            " 'hapticnet experiment texts' and texts = in the plan"
        )


def run_session(session: "Coroutine[Any, Any, None]") -> None:
    """Run a session in real time; say how to go on if it is interrupted."""
    import asyncio

    from hapticnet.cli.console import complain
    from hapticnet.runtime.system import run

    try:
        run(session)
    except (KeyboardInterrupt, asyncio.CancelledError) as error:
        complain("interrupted; everything answered is stored, go on with --resume")
        raise KeyboardInterrupt from error


async def conduct_in_real_time(
    rig: "RealRig",
    flow: "Flow[AnyRow]",
    store: "Store[AnyRow]",
    settings: "SessionSettings",
    observer: "ObserverSettings | None",
    screen: "Screen | None",
    on_outcome: "Callable[[AnyRow, Outcome], None] | None" = None,
) -> None:
    """Conduct a session in real time with a person at a page or at the terminal, or with a simulated observer."""
    import asyncio
    import signal
    from contextlib import nullcontext

    from hapticnet.cli.console import complain
    from hapticnet.runtime.system import prefer_realtime
    from hapticnet.study.conduct import conduct
    from hapticnet.study.keyboard import Keyboard
    from hapticnet.study.noise import masking_noise
    from hapticnet.study.schedule import participant_number
    from hapticnet.study.session import today, version
    from hapticnet.study.simulated_front import SimulatedFront
    from hapticnet.study.terminal_front import TerminalFront

    prefer_realtime()
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - for the type checker
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    async with rig:
        if observer is not None:
            front = SimulatedFront(
                observer,
                rig,
                seed=settings.seed,
                participant=participant_number(settings.participant),
                session=settings.session,
                waits=False,
            )
            await conduct(flow, rig, front, store, date=today, version=version(), on_outcome=on_outcome)
            return
        if screen is not None:
            with Keyboard(screen.front.hear_experimenter):
                await conduct(flow, rig, screen.front, store, date=today, version=version(), on_outcome=on_outcome)
            return
        noise = masking_noise(complain) if settings.plan.masking_noise else nullcontext(0.0)
        with TerminalFront(settings.plan.texts) as terminal, noise as level:
            if level:
                flow.note_noise(level, rig.now_us())
            await conduct(flow, rig, terminal, store, date=today, version=version(), on_outcome=on_outcome)
