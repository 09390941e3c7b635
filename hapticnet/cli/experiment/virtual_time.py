"""Sessions in virtual time with simulated observers, for several participants on all cores."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from hapticnet.cli.console import Console
    from hapticnet.device.profile import Profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.study.flow import Flow
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.rig import Outcome
    from hapticnet.study.rows import AnyRow
    from hapticnet.study.session import SessionSettings
    from hapticnet.study.store import Store


OnTrial: TypeAlias = Callable[[], None]
"""Called when a trial was answered."""


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


def conduct_in_virtual_time(
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
        As for `study.conduct.conduct`.
    """
    import asyncio

    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.study.conduct import conduct
    from hapticnet.study.rig import VirtualRig
    from hapticnet.study.schedule import participant_number
    from hapticnet.study.session import today, version
    from hapticnet.study.simulated_front import SimulatedFront

    def on_row(row: "AnyRow") -> None:
        if row.event == "trial":
            on_trial()

    number = participant_number(settings.participant)
    with _fingertip(settings.device, known, settings.seed + number) as fingertip:
        rig = VirtualRig(fingertip, MasterSettings())
        front = SimulatedFront(
            observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=True
        )
        with begin(settings, rig.now_us()) as (flow, store):
            session = conduct(
                flow, rig, front, store, date=today, version=version(), on_outcome=on_outcome, on_row=on_row
            )
            asyncio.run(session)
            return account(settings, flow)


@contextmanager
def _fingertip(device: str, known: "Profile", seed: int) -> Iterator["Fingertip"]:
    """Yield a simulated device with its force loop; raise SettingsError for a real one."""
    from hapticnet.control.limits import LimitSettings
    from hapticnet.errors import SettingsError
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.runtime import devices

    with devices.virtual_device(device, known, seed) as made:
        if made is None:
            raise SettingsError(f"device {device!r} cannot run in virtual time; add --wall-clock")
        yield Fingertip(made, LimitSettings(), devices.control_settings(known))
