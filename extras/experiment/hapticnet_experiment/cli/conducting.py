"""Conduct the sessions of ``hapticnet experiment limits`` and ``order``: many in virtual time, or one in real time."""

import asyncio
import multiprocessing
import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from hapticnet.cli.console import Console, complain, deliver
from hapticnet.cli.operators import make_operator
from hapticnet.cli.pages import listen_for, page_address, say_addresses
from hapticnet.device.profile import Profile
from hapticnet.device.user import UserActuator
from hapticnet.errors import SettingsError
from hapticnet.experiment.workers import workers
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.settings import MasterSettings
from hapticnet.runtime import devices
from hapticnet.runtime.processes import Child
from hapticnet.runtime.serial_port import Wire
from hapticnet.runtime.system import now_us, prefer_realtime
from hapticnet.runtime.system import run as run_loop
from hapticnet.runtime.trust import master_key
from hapticnet.runtime.udp import HostPort, is_loopback, open_toward, parse_host_port
from hapticnet_experiment.cli.asked import LimitsOptions, OrderOptions
from hapticnet_experiment.cli.results import write_results
from hapticnet_experiment.fronts import Keyboard, SimulatedFront, TerminalFront
from hapticnet_experiment.observers import ObserverSettings, parse_observer
from hapticnet_experiment.plan import ASK, Plan, find_plan
from hapticnet_experiment.real_rig import RealRig
from hapticnet_experiment.rig import VirtualRig
from hapticnet_experiment.rows import Row
from hapticnet_experiment.scene import SCENE_SPEC
from hapticnet_experiment.schedule import participant_number
from hapticnet_experiment.screens import english
from hapticnet_experiment.session import (
    SessionSettings,
    account_of,
    check_session,
    conduct,
    keep_plan,
    law_of_participant,
    open_session,
    record_trials,
)
from hapticnet_experiment.tasks import LIMITS, ORDER

if TYPE_CHECKING:
    import socket

    from hapticnet.node.events import NodeEvent
    from hapticnet.operator.base import Operator
    from hapticnet.runtime.watching import Watcher
    from hapticnet.web.access import Access
    from hapticnet_experiment.page import ParticipantPage

MOST_PARTICIPANTS: Final = 10_000
NO_NOISE: Final = "masking noise: only the page plays it (--page); play white noise from another program"
OnTrial: TypeAlias = Callable[[], None]  # called when a trial was answered


def run(asked: LimitsOptions) -> None:
    """Conduct the requested sessions, and print their outcome."""
    page_address(asked.page)
    if asked.page is not None and asked.simulate is not None:
        raise SettingsError("--page is for a person; a simulated observer needs none")
    if asked.page is None and isinstance(asked, OrderOptions) and asked.operator == "page":
        raise SettingsError("--operator page needs --page")
    observer = None if asked.simulate is None else parse_observer(asked.simulate)
    sessions = _sessions(asked, find_plan(asked.plan), observer)
    plan = sessions[0].plan
    known = devices.load(asked.profile)
    devices.check_device(asked.device)
    is_order = isinstance(asked, OrderOptions)
    console = Console(sessions[0].task, quiet=asked.quiet)
    laws: dict[str, list[str]] = {}
    for each in sessions:
        check_session(each)
    for each in sessions if is_order else ():
        laws.setdefault(law_of_participant(each).describe(), []).append(each.participant)
    keep_plan(plan, asked.out_dir)
    if observer is None and plan.consent == ASK and plan.texts.consent == english().consent:
        console.say(
            "the consent is hapticnet's default, which names neither the study nor a contact: adapt it with"
            " 'hapticnet experiment texts' and texts = in the plan"
        )
    for law, people in laws.items():
        console.say(f"participant {', '.join(people)}: {law}")
    if observer is not None:
        trials = len(sessions) * len(plan.condition) * plan.order.trials
        counted = f"of {trials} trials" if is_order else "pairs"
        accounts = conduct_all(_conduct_in_virtual_time, (known, observer), sessions, asked.jobs, console, counted)
    else:
        with _socket_of_page(asked.page, console) as opened:
            accounts = [_conduct_in_real_time(asked, sessions[0], known, opened, console)]
    console.finish()
    for account in accounts:
        for told in (*(f"excluded: {why}" for why in account.get("excluded", ())), *account.get("warnings", ())):
            console.warn(f"participant {account['participant']}: {told}")
    if observer is not None and is_order:
        console.say("analysing the answers")
        out = asked.out_dir
        write_results(out, out / "results", plots=True, say=console.say)
    title = "Ordering task" if is_order else "JND"
    title = title if observer is None else f"{title}, simulated observer {observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=asked.json, file=None)


def _sessions(asked: LimitsOptions, plan: Plan, observer: ObserverSettings | None) -> list[SessionSettings]:
    participants = _participants(asked.participant)
    if len(participants) > 1 and observer is None:
        raise SettingsError(f"participants {asked.participant}: several at once are for --simulate")
    if asked.resume and observer is not None:
        raise SettingsError("--resume is for people; begin simulated sessions again, with another --out-dir")
    return [
        SessionSettings(
            task=ORDER if isinstance(asked, OrderOptions) else LIMITS,
            participant=participant,
            session=asked.session,
            seed=asked.seed,
            plan=plan,
            out=asked.out_dir,
            observer=None if observer is None else observer.name,
            device=asked.device,
            resume=asked.resume,
        )
        for participant in participants
    ]


def _participants(text: str) -> tuple[str, ...]:
    """Return the participants written as 03 or 01-08."""
    match = re.fullmatch(r"([0-9]{1,6})-([0-9]{1,6})", text)
    if match is None:
        participant_number(text)
        return (text,)
    first, last = (int(number) for number in match.groups())
    if not first <= last < first + MOST_PARTICIPANTS:
        raise SettingsError(f"participants {text}: expected the first and the last, such as 01-08")
    width = len(match.group(1))
    return tuple(f"{number:0{width}d}" for number in range(first, last + 1))


def _seeds(settings: SessionSettings) -> tuple[int, int, int]:
    return settings.seed, participant_number(settings.participant), settings.session


def _conduct_in_virtual_time(
    shared: tuple[Profile, ObserverSettings], settings: SessionSettings, on_trial: OnTrial
) -> dict[str, Any]:
    known, observer = shared

    def on_row(row: Row) -> None:
        if row.event == "trial":
            on_trial()

    device_seed = settings.seed + participant_number(settings.participant)
    with devices.virtual_device(settings.device, known, device_seed) as made:
        if made is None:
            raise SettingsError(f"device {settings.device!r} cannot run in virtual time, as --simulate does")
        rig = VirtualRig(Fingertip(made, devices.control_settings(known)), MasterSettings())
        front = SimulatedFront(observer, rig, _seeds(settings))
        keep = record_trials(settings, {"device": settings.device})
        with open_session(settings, rig.now_us()) as (flow, store):
            asyncio.run(conduct(flow, rig, front, store, on_outcome=keep, on_row=on_row))
            return account_of(settings, flow)


def _conduct_in_real_time(
    asked: LimitsOptions,
    settings: SessionSettings,
    known: Profile,
    opened: "tuple[socket.socket, Access] | None",
    console: Console,
) -> dict[str, Any]:
    """Conduct a session with a person at a page or a terminal; return its account."""
    source = "nobody"
    hand: Operator | None = None
    page: ParticipantPage | None = None
    watchers: tuple[Watcher[NodeEvent], ...] = ()
    if isinstance(asked, OrderOptions):
        source = asked.operator or ("udp:47810" if opened is None else "page")
        warn = lambda line: console.say(f"warning: {line}")  # noqa: E731
        made = make_operator(source, insertions=1, seed=settings.seed, say=console.say, warn=warn)
        hand, watchers = made.operator, tuple(made.watchers)
    if opened is not None:
        from hapticnet.web.server import Server
        from hapticnet_experiment import page as pages  # loads aiohttp, which a rehearsal does not use

        sock, access = opened
        seen, plan = None if hand is None else pages.SeenHand(hand), settings.plan
        where = source.partition(":")[0]
        page = pages.ParticipantPage(seen, where, texts=plan.texts, masking_noise=plan.masking_noise, say=console.say)
        hand, watchers = seen, (*watchers, Server(page, access, sock), page)
    with (
        _fingertip(settings, known) as (fingertip, wire),
        _slave(asked) as (address, master_settings),
        open_session(settings, now_us()) as (flow, store),
    ):
        rig = RealRig(fingertip, master_settings, address, tell=console.say, wire=wire, hand=hand, watchers=watchers)
        keep = record_trials(settings, {"operator": source, "connect": str(address)})

        async def session() -> None:
            prefer_realtime()
            task = asyncio.current_task()
            assert task is not None  # noqa: S101 - for the type checker
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
            async with rig:
                if page is not None:
                    with Keyboard(page.hear_experimenter):
                        await conduct(flow, rig, page, store, on_outcome=keep)
                else:
                    if settings.plan.masking_noise:
                        complain(NO_NOISE)
                    with TerminalFront(settings.plan.texts) as terminal:
                        await conduct(flow, rig, terminal, store, on_outcome=keep)

        try:
            run_loop(session())
        except (KeyboardInterrupt, asyncio.CancelledError) as error:
            complain("interrupted; every answer is stored, continue with --resume")
            raise KeyboardInterrupt from error
        return account_of(settings, flow)


@contextmanager
def _socket_of_page(page: str | None, console: Console) -> "Iterator[tuple[socket.socket, Access] | None]":
    """Yield where the participant's page will be served, opened early so that a wrong address is reported at once."""
    if page is None:
        yield None
        return
    sock, access = listen_for(page, ("operator",), console)
    with sock:
        say_addresses({"the participant's page: ": "operator"}, access, console)
        console.say("press Escape here to stop what the participant feels, Ctrl-C to interrupt the session")
        yield sock, access


@contextmanager
def _fingertip(settings: SessionSettings, known: Profile) -> Iterator[tuple[Fingertip, Wire | None]]:
    """Yield a device with its force loop for real time, and its wire."""
    device = settings.device
    if device == "none":
        raise SettingsError("the study needs a fingertip device; choose --device sim to rehearse without one")
    with devices.real_time_device(device, known, settings.seed, complain) as (made, wire):
        if made is None or isinstance(made, UserActuator):
            raise SettingsError(f"device {device} renders forces by itself; the study measures its force loop")
        yield Fingertip(made, devices.control_settings(known)), wire


@contextmanager
def _slave(asked: LimitsOptions) -> Iterator[tuple[HostPort | None, MasterSettings]]:
    """Yield the address of the slave and the settings of masters; start a slave if needed and not named."""
    if not isinstance(asked, OrderOptions):
        yield None, MasterSettings()
    elif asked.connect is not None:
        address = parse_host_port(asked.connect)
        sock, slave = open_toward(address)
        sock.close()
        key = master_key(address, is_loopback(slave), asked.key, asked.peer_key, asked.insecure)
        yield address, MasterSettings(key=key)
    else:
        child = Child(["slave", "--listen", "127.0.0.1:0", "--scene", SCENE_SPEC])
        try:
            yield parse_host_port(child.address()), MasterSettings()
        finally:
            child.end()


ConductOne: TypeAlias = Callable[[Any, SessionSettings, OnTrial], dict[str, Any]]


def conduct_all(
    conduct_one: ConductOne,
    shared: object,
    sessions: list[SessionSettings],
    jobs: int | None,
    console: Console,
    counted: str,
) -> list[dict[str, Any]]:
    """Call ``conduct_one(shared, settings, on_trial)`` for each session, on `jobs` cores or all; return the accounts.

    `counted` is what the lines of progress count, such as "of 320 trials".
    """
    accounts: list[dict[str, Any]] = []
    answered = 0
    arriving, leaving = multiprocessing.Pipe(duplex=False)

    def tell() -> None:
        console.progress(f"{answered} {counted}, {len(accounts)} of {len(sessions)} participants")

    def count() -> None:
        nonlocal answered
        while arriving.recv():
            answered += 1
            tell()

    counting = Thread(target=count, daemon=True)
    counting.start()
    try:
        with workers(
            min(jobs or len(os.sched_getaffinity(0)), len(sessions)), (conduct_one, shared, leaving)
        ) as in_order:
            for account in in_order(_conduct, sessions):
                accounts.append(account)
                tell()
    finally:
        leaving.send(False)
        counting.join()
    return accounts


def _conduct(shared: tuple[ConductOne, Any, Connection], settings: SessionSettings) -> dict[str, Any]:
    conduct_one, passed_on, leaving = shared
    return conduct_one(passed_on, settings, lambda: leaving.send(True))
