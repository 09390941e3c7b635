"""Sessions in virtual time with simulated observers, for several participants on all cores."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapticnet.cli.console import Console
    from hapticnet.device.profile import Profile
    from hapticnet.node.fingertip import Fingertip
    from hapticnet.study.flow import Flow
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.rig import Outcome
    from hapticnet.study.rows import AnyRow
    from hapticnet.study.session import SessionSettings
    from hapticnet.study.store import Store


def conduct_all(
    conduct_one: "Callable[[Any, SessionSettings], dict[str, Any]]",
    shared: object,
    sessions: "list[SessionSettings]",
    jobs: int | None,
    console: "Console",
) -> list[dict[str, Any]]:
    """Call ``conduct_one(shared, settings)`` for each session, on `jobs` cores (None: all); return the accounts."""
    from hapticnet.experiment.workers import workers

    accounts = []
    with workers(min(jobs or len(os.sched_getaffinity(0)), len(sessions)), shared) as in_order:
        for account in in_order(conduct_one, sessions):
            accounts.append(account)
            console.status(f"{len(accounts)} of {len(sessions)} participants")
    return accounts


def conduct_in_virtual_time(
    known: "Profile",
    observer: "ObserverSettings",
    settings: "SessionSettings",
    begin: "Callable[[SessionSettings, int], AbstractContextManager[tuple[Flow[AnyRow], Store[AnyRow]]]]",
    account: "Callable[[SessionSettings, Any], dict[str, Any]]",
    on_outcome: "Callable[[AnyRow, Outcome], None] | None" = None,
) -> dict[str, Any]:
    """Conduct a session with a simulated observer; return its account.

    Parameters
    ----------
    begin
        ``(settings, now_us)``: flow and table of the session.
    account
        ``(settings, flow)``, called at the end.
    """
    import asyncio

    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.study.conduct import conduct
    from hapticnet.study.rig import VirtualRig
    from hapticnet.study.schedule import participant_number
    from hapticnet.study.session import today, version
    from hapticnet.study.simulated_front import SimulatedFront

    number = participant_number(settings.participant)
    with _fingertip(settings.device, known, settings.seed + number) as fingertip:
        rig = VirtualRig(fingertip, MasterSettings())
        front = SimulatedFront(
            observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=True
        )
        with begin(settings, rig.now_us()) as (flow, store):
            asyncio.run(conduct(flow, rig, front, store, date=today, version=version(), on_outcome=on_outcome))
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
