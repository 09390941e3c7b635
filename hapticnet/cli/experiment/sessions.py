"""``hapticnet experiment limits`` and ``order``: sessions with people or with simulated observers."""

import os
import re
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias

import typer

from hapticnet import options
from hapticnet.cli.experiment import page as pages

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from hapticnet.cli.console import Console
    from hapticnet.device.profile import Profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.node.settings import MasterSettings
    from hapticnet.runtime.serial_port import Wire
    from hapticnet.runtime.udp import HostPort
    from hapticnet.study.flow import Flow
    from hapticnet.study.limits import LimitsFlow
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.plan import Plan
    from hapticnet.study.real_rig import RealRig
    from hapticnet.study.rig import Outcome
    from hapticnet.study.rows import AnyRow
    from hapticnet.study.runner import RecordingForm
    from hapticnet.study.schedule import Schedule
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

OnTrial: TypeAlias = Callable[[], None]
"""Called when a trial was answered."""


def limits(
    participant: Participant,
    session: Session = 1,
    plan: PlanOption = "paper",
    seed: SeedOption = 0,
    out_dir: OutDir = Path("study"),
    device: options.Device = "sim",
    profile: options.Profile = None,
    page: pages.PageOption = None,
    simulate: Simulate = None,
    wall_clock: WallClock = False,
    jobs: options.Jobs = None,
    resume: Resume = False,
    dry_run: DryRun = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Measure the JND of a participant at each reference force, and write DIR/participants/NUMBER.toml.

    The plan chooses the method: ascending limits, or a forced choice of two intervals with a 1-up-2-down or a Bayesian
    staircase. Forces pass the hold and the force loop, as in the ordering task; a pair that the device missed is
    presented again. Each answer is stored at once; --resume goes on after any interruption.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.runtime import devices
    from hapticnet.study.limits import draw_limits
    from hapticnet.study.session import LIMITS, keep_plan

    pages.check_page(page, simulate)
    asked = _check(participant, plan, simulate, wall_clock=wall_clock)
    if dry_run:
        _show_schedules([draw_limits(asked.plan, each, session, seed) for each in asked.participants], asked, json)
        return
    known = devices.load(profile)
    devices.check_device(device)
    console = Console("limits", quiet=quiet)
    sessions = _sessions_of(
        asked, LIMITS, session=session, seed=seed, out=out_dir, device=device, resume=resume, wall_clock=wall_clock
    )
    keep_plan(asked.plan, out_dir)
    _remind_of_consent(asked, console.say)
    if asked.observer is None or wall_clock:
        with pages.opened(page, console, sessions[0].folder(LIMITS), resume=resume) as opened:
            accounts = [_limits_in_real_time(sessions[0], known, asked.observer, opened, console.say)]
    else:
        shared = known, asked.observer
        accounts = conduct_all(_limits_in_virtual_time, shared, sessions, jobs, console, "pairs")
    console.finish()
    for account in accounts:
        for told in (*(f"excluded: {why}" for why in account.get("excluded", ())), *account.get("warnings", ())):
            console.warn(f"participant {account['participant']}: {told}")
    title = "JND" if asked.observer is None else f"JND, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _limits_in_virtual_time(
    shared: "tuple[Profile, ObserverSettings]", settings: "SessionSettings", on_trial: OnTrial
) -> dict[str, Any]:
    from hapticnet.study.session import limits_session

    return _conduct_in_virtual_time(*shared, settings, limits_session, _account, on_trial)


def _limits_in_real_time(
    settings: "SessionSettings",
    known: "Profile",
    observer: "ObserverSettings | None",
    opened: pages.OpenedPage | None,
    say: Any,
) -> dict[str, Any]:
    from hapticnet.node.settings import MasterSettings
    from hapticnet.runtime.system import now_us
    from hapticnet.study.real_rig import Body, RealRig
    from hapticnet.study.session import limits_session

    screen = None
    if opened is not None:
        screen = pages.make_screen(opened, None, "nobody", settings.plan)
    with (
        _real_fingertip(settings.device, known, settings.seed) as (fingertip, wire),
        limits_session(settings, now_us()) as (flow, store),
    ):
        body = Body(fingertip=fingertip, wire=wire, hand_watchers=() if screen is None else screen.watchers)
        rig = RealRig(body, MasterSettings(), None, tell=say)
        _run_session(_conduct_in_real_time(rig, flow, store, settings, observer, screen))
        return _account(settings, flow)


def _account(settings: "SessionSettings", flow: "LimitsFlow") -> dict[str, Any]:
    from hapticnet.errors import SettingsError
    from hapticnet.study.session import write_participant

    try:
        path, measured = write_participant(settings, flow)
    except SettingsError as error:
        return {"participant": settings.participant, "no_jnd": str(error)}
    return {
        "file": str(path),
        **measured.model_dump(exclude={"reference"}),
        "reference": measured.model_dump()["reference"],
    }


def order(
    participant: Participant,
    session: Session = 1,
    plan: PlanOption = "paper",
    seed: SeedOption = 0,
    out_dir: OutDir = Path("study"),
    device: options.Device = "sim",
    profile: options.Profile = None,
    page: pages.PageOption = None,
    operator: Annotated[
        str | None,
        typer.Option(
            metavar="OPERATOR",
            show_default="page with --page, else udp:47810",
            help="A person's hand: page, udp:[HOST:]PORT, trace:FILE or a class of yours.",
        ),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="A slave started with --scene hapticnet.study.scene:NamedTissues; else one is started here.",
        ),
    ] = None,
    key: options.Key = None,
    peer_key: options.PeerKey = None,
    insecure: options.Insecure = False,
    simulate: Simulate = None,
    wall_clock: WallClock = False,
    jobs: options.Jobs = None,
    record_format: Annotated[
        Literal["mcap", "npz", "none"] | None,
        typer.Option(help="Format of the recordings, one a trial; default: mcap in real time if installed, else npz."),
    ] = None,
    analyse: Annotated[bool, typer.Option(help="With --simulate, analyse the study at the end.")] = True,
    resume: Resume = False,
    dry_run: DryRun = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Let a participant order three tissues by stiffness, under each condition of the plan.

    Trials come in balanced orders that are drawn first and stored. Each answer is stored at once; --resume goes on
    after any interruption. Nothing that the participant sees tells the condition. With simulated observers, report and
    figures follow, as by 'hapticnet experiment analyse'; on two cores, eight participants take about two minutes.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.runtime import devices
    from hapticnet.study.order import draw_order
    from hapticnet.study.runner import usual_form
    from hapticnet.study.session import ORDER, keep_plan, law_of_participant

    pages.check_page(page, simulate, operator)
    asked = _check(participant, plan, simulate, wall_clock=wall_clock)
    if dry_run:
        _show_schedules([draw_order(asked.plan, each, session, seed) for each in asked.participants], asked, json)
        return
    known = devices.load(profile)
    devices.check_device(device)
    form = record_format or usual_form(real_time=asked.observer is None or wall_clock)
    console = Console("order", quiet=quiet)
    sessions = _sessions_of(
        asked, ORDER, session=session, seed=seed, out=out_dir, device=device, resume=resume, wall_clock=wall_clock
    )
    laws: dict[str, list[str]] = {}
    for each_session in sessions:
        laws.setdefault(law_of_participant(each_session).describe(), []).append(each_session.participant)
    keep_plan(asked.plan, out_dir)
    _remind_of_consent(asked, console.say)
    for law, people in laws.items():
        console.say(f"participant {', '.join(people)}: {law}")
    if asked.observer is None or wall_clock:
        with pages.opened(page, console, sessions[0].folder(ORDER), resume=resume) as opened:
            place = Place(
                operator=operator, page=opened, connect=connect, key=key, peer_key=peer_key, insecure=insecure
            )
            accounts = [_order_in_real_time(sessions[0], known, asked.observer, place, form=form, say=console.say)]
    else:
        shared = known, asked.observer, form
        trials = len(sessions) * len(asked.plan.condition) * asked.plan.order.trials
        accounts = conduct_all(_order_in_virtual_time, shared, sessions, jobs, console, f"of {trials} trials")
    console.finish()
    if asked.observer is not None and analyse:
        from hapticnet.cli.experiment.results import write_results

        console.say("analysing the answers")
        write_results(out_dir, out_dir / "results", margin=None, seed=seed, plots=True, say=console.say)
    title = "Ordering task" if asked.observer is None else f"Ordering task, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _order_in_virtual_time(
    shared: "tuple[Profile, ObserverSettings, RecordingForm]", settings: "SessionSettings", on_trial: OnTrial
) -> dict[str, Any]:
    from hapticnet.study.runner import record_trials
    from hapticnet.study.session import account_of, order_session

    known, observer, form = shared
    keep = record_trials(settings, form, {"device": settings.device})
    return _conduct_in_virtual_time(known, observer, settings, order_session, account_of, on_trial, keep)


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where hand and slave are."""

    operator: str | None
    page: pages.OpenedPage | None
    connect: str | None
    key: Path | None
    peer_key: str | None
    insecure: bool


def _order_in_real_time(
    settings: "SessionSettings",
    known: "Profile",
    observer: "ObserverSettings | None",
    place: Place,
    *,
    form: "RecordingForm",
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Conduct the ordering task and return its account."""
    from hapticnet.cli.operators import make_operator
    from hapticnet.runtime.system import now_us
    from hapticnet.study.real_rig import Body, RealRig
    from hapticnet.study.runner import record_trials
    from hapticnet.study.session import account_of, order_session

    source = place.operator or ("udp:47810" if place.page is None else "page")
    hand = None
    if observer is None:
        warn = lambda line: say(f"warning: {line}")  # noqa: E731
        hand = make_operator(source, insertions=1, seed=settings.seed, say=say, warn=warn)
    screen = None
    if place.page is not None and hand is not None:
        screen = pages.make_screen(place.page, hand.operator, source.partition(":")[0], settings.plan)
    with (
        _real_fingertip(settings.device, known, settings.seed) as (fingertip, wire),
        _slave(place) as (address, master_settings),
        order_session(settings, now_us()) as (flow, store),
    ):
        body = Body(
            fingertip=fingertip,
            wire=wire,
            hand=screen.hand if screen is not None else None if hand is None else hand.operator,
            hand_watchers=(*(() if hand is None else hand.watchers), *(() if screen is None else screen.watchers)),
        )
        rig = RealRig(body, master_settings, address, tell=say)
        about = {"operator": source if observer is None else "scripted", "connect": str(address)}
        keep = record_trials(settings, form, about)
        _run_session(_conduct_in_real_time(rig, flow, store, settings, observer, screen, keep))
        return account_of(settings, flow)


@contextmanager
def _slave(place: Place) -> "Iterator[tuple[HostPort, MasterSettings]]":
    """Yield the address of the slave and the settings of masters; start a slave if none is named."""
    from hapticnet.node.settings import MasterSettings
    from hapticnet.runtime.processes import Child
    from hapticnet.runtime.trust import master_key
    from hapticnet.runtime.udp import is_loopback, open_toward, parse_host_port
    from hapticnet.study.scene import SCENE_SPEC

    if place.connect is not None:
        address = parse_host_port(place.connect)
        sock, slave = open_toward(address)
        sock.close()
        key = master_key(address, is_loopback(slave), place.key, place.peer_key, place.insecure)
        yield address, MasterSettings(key=key)
        return
    child = Child(["slave", "--listen", "127.0.0.1:0", "--scene", SCENE_SPEC])
    try:
        yield parse_host_port(child.address()), MasterSettings()
    finally:
        child.end()


@dataclass(frozen=True, slots=True)
class Asked:
    """What was asked for, checked."""

    participants: tuple[str, ...]  # numbers; one, unless observers are simulated
    plan: "Plan"
    observer: "ObserverSettings | None"


def _check(participant: str, plan: str, simulate: str | None, *, wall_clock: bool) -> Asked:
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


def _sessions_of(
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


def _show_schedules(schedules: "Sequence[Schedule]", asked: Asked, as_json: bool) -> None:
    """Print what ``--dry-run`` asks for: a few lines for a person, or everything that was drawn as JSON."""
    import json

    from hapticnet.cli.console import show

    if as_json:
        print(json.dumps([json.loads(each.to_json()) for each in schedules], indent=1))
    else:
        show("\n".join(line for each in schedules for line in each.lines(asked.plan)))


@contextmanager
def _real_fingertip(device: str, known: "Profile", seed: int) -> Iterator["tuple[Fingertip, Wire | None]"]:
    """Yield a device with its force loop for real time, and its wire."""
    from hapticnet.cli.console import complain
    from hapticnet.control.hold import LimitSettings
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


def _remind_of_consent(asked: Asked, say: "Callable[[str], None]") -> None:
    """Tell an experimenter who is about to show a person the consent that is shipped."""
    from hapticnet.study.plan import ASK
    from hapticnet.study.texts import english

    if asked.observer is None and asked.plan.consent == ASK and asked.plan.texts.consent == english().consent:
        say(
            "the consent is the one that is shipped, which names neither the study nor whom to ask: adapt it with"
            " 'hapticnet experiment texts' and texts = in the plan"
        )


def _run_session(session: "Coroutine[Any, Any, None]") -> None:
    """Run a session in real time; say how to go on if it is interrupted."""
    import asyncio

    from hapticnet.cli.console import complain
    from hapticnet.runtime.system import run

    try:
        run(session)
    except (KeyboardInterrupt, asyncio.CancelledError) as error:
        complain("interrupted; everything answered is stored, go on with --resume")
        raise KeyboardInterrupt from error


async def _conduct_in_real_time(
    rig: "RealRig",
    flow: "Flow[AnyRow]",
    store: "Store[AnyRow]",
    settings: "SessionSettings",
    observer: "ObserverSettings | None",
    screen: "pages.Screen | None",
    on_outcome: "Callable[[AnyRow, Outcome], None] | None" = None,
) -> None:
    """Conduct a session in real time with a person at a page or at the terminal, or with a simulated observer."""
    import asyncio
    import signal

    from hapticnet.cli.console import complain
    from hapticnet.runtime.system import prefer_realtime
    from hapticnet.study.fronts import Keyboard, SimulatedFront, TerminalFront
    from hapticnet.study.runner import conduct
    from hapticnet.study.schedule import participant_number

    prefer_realtime()
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - for the type checker
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    async with rig:
        if observer is not None:
            number = participant_number(settings.participant)
            front = SimulatedFront(
                observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=False
            )
            await conduct(flow, rig, front, store, on_outcome=on_outcome)
        elif screen is not None:
            with Keyboard(screen.front.hear_experimenter):
                await conduct(flow, rig, screen.front, store, on_outcome=on_outcome)
        else:
            if settings.plan.masking_noise:
                complain("masking noise: only the page plays it (--page); play white noise from another program")
            with TerminalFront(settings.plan.texts) as terminal:
                await conduct(flow, rig, terminal, store, on_outcome=on_outcome)


def conduct_all(
    conduct_one: "Callable[[Any, SessionSettings, OnTrial], dict[str, Any]]",
    shared: object,
    sessions: "list[SessionSettings]",
    jobs: int | None,
    console: "Console",
    trials: str,
) -> list[dict[str, Any]]:
    """Call ``conduct_one(shared, settings, on_trial)`` for each session, on `jobs` cores; return the accounts.

    Parameters
    ----------
    jobs
        None for all cores.
    trials
        What is counted in the lines of progress, such as "of 320 trials".
    """
    import multiprocessing
    from threading import Thread

    from hapticnet.experiment.workers import workers

    accounts: list[dict[str, Any]] = []
    answered = 0
    arriving, leaving = multiprocessing.Pipe(duplex=False)

    def show() -> None:
        console.progress(f"{answered} {trials}, {len(accounts)} of {len(sessions)} participants")

    def count() -> None:
        nonlocal answered
        while arriving.recv():
            answered += 1
            show()

    counting = Thread(target=count, daemon=True)
    counting.start()
    try:
        with workers(
            min(jobs or len(os.sched_getaffinity(0)), len(sessions)), (conduct_one, shared, leaving)
        ) as in_order:
            for account in in_order(_conduct, sessions):
                accounts.append(account)
                show()
    finally:
        leaving.send(False)
        counting.join()
    return accounts


def _conduct(
    shared: "tuple[Callable[[Any, SessionSettings, OnTrial], dict[str, Any]], Any, Connection]",
    settings: "SessionSettings",
) -> dict[str, Any]:
    conduct_one, passed_on, leaving = shared
    return conduct_one(passed_on, settings, lambda: leaving.send(True))


def _conduct_in_virtual_time(
    known: "Profile",
    observer: "ObserverSettings",
    settings: "SessionSettings",
    begin: "Callable[[SessionSettings, int], AbstractContextManager[tuple[Flow[AnyRow], Store[AnyRow]]]]",
    account: "Callable[[SessionSettings, Any], dict[str, Any]]",
    on_trial: OnTrial,
    on_outcome: "Callable[[AnyRow, Outcome], None] | None" = None,
) -> dict[str, Any]:
    """Conduct a session with a simulated observer; return its account.

    Parameters
    ----------
    begin
        ``(settings, now_us)``: flow and table of the session.
    account
        ``(settings, flow)``, called at the end.
    on_outcome
        As for `study.runner.conduct`.
    """
    import asyncio

    from hapticnet.node.settings import MasterSettings
    from hapticnet.study.fronts import SimulatedFront
    from hapticnet.study.rig import VirtualRig
    from hapticnet.study.runner import conduct
    from hapticnet.study.schedule import participant_number

    def on_row(row: "AnyRow") -> None:
        if row.event == "trial":
            on_trial()

    number = participant_number(settings.participant)
    with _virtual_fingertip(settings.device, known, settings.seed + number) as fingertip:
        rig = VirtualRig(fingertip, MasterSettings())
        front = SimulatedFront(
            observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=True
        )
        with begin(settings, rig.now_us()) as (flow, store):
            asyncio.run(conduct(flow, rig, front, store, on_outcome=on_outcome, on_row=on_row))
            return account(settings, flow)


@contextmanager
def _virtual_fingertip(device: str, known: "Profile", seed: int) -> Iterator["Fingertip"]:
    """Yield a simulated device with its force loop; raise SettingsError for a real one."""
    from hapticnet.control.hold import LimitSettings
    from hapticnet.errors import SettingsError
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.runtime import devices

    with devices.virtual_device(device, known, seed) as made:
        if made is None:
            raise SettingsError(f"device {device!r} cannot run in virtual time; add --wall-clock")
        yield Fingertip(made, LimitSettings(), devices.control_settings(known))
