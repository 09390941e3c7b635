"""``hapticnet experiment limits``: measure a participant's JND."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticnet.cli import options
from hapticnet.cli.experiment import common
from hapticnet.cli.experiment import page as pages

if TYPE_CHECKING:
    from hapticnet.device.profile import Profile
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.session import SessionSettings


def limits(
    participant: common.Participant,
    session: common.Session = 1,
    plan: common.PlanOption = "paper",
    seed: common.SeedOption = 0,
    out: common.Out = Path("study"),
    device: options.DeviceOption = "sim",
    profile: options.ProfileOption = None,
    page: pages.PageOption = None,
    simulate: common.Simulate = None,
    real_time: common.RealTime = False,
    jobs: common.Jobs = None,
    resume: common.Resume = False,
    dry_run: common.DryRun = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Measure the JND of a participant at each reference force, and write DIR/participants/NUMBER.toml.

    The plan chooses the method: ascending limits, or a forced choice of two intervals with a 1-up-2-down or a Bayesian
    staircase. Forces pass the hold and the force loop, as in the ordering task; a pair that the device missed is
    presented again. Each answer is stored at once; --resume goes on after any interruption.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.experiment.workers import workers
    from hapticnet.runtime import devices
    from hapticnet.study.limits_flow import draw_limits
    from hapticnet.study.session import SessionSettings, check_number, keep_plan

    pages.check_page(page, simulate)
    asked = common.check(participant, plan, simulate, real_time=real_time)
    if dry_run:
        for each in asked.participants:
            print(draw_limits(asked.plan, each, session, seed).to_json(), end="")
        return
    known = devices.load(profile)
    devices.check_device(device)
    console = Console("limits", quiet=quiet)
    settings = [
        SessionSettings(
            participant=each,
            session=session,
            seed=seed,
            plan=asked.plan,
            out=out,
            observer=None if asked.observer is None else asked.observer.name,
            device=device,
            resume=resume,
            hurried=real_time,
        )
        for each in asked.participants
    ]
    for own in settings:
        check_number(own)
    keep_plan(asked.plan, out)
    accounts = []
    if asked.observer is None or real_time:
        with pages.opened(page, console) as opened:
            accounts.append(_in_real_time(settings[0], known, asked.observer, opened, console.say))
    else:
        shared = known, asked.observer
        with workers(common.jobs_for(jobs, len(settings)), shared) as in_order:
            for account in in_order(_in_virtual_time, settings):
                accounts.append(account)
                console.status(f"{len(accounts)} of {len(settings)} participants")
    console.finish()
    title = "JND" if asked.observer is None else f"JND, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _in_virtual_time(shared: "tuple[Profile, ObserverSettings]", settings: "SessionSettings") -> dict[str, Any]:
    import asyncio

    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.study.conduct import conduct
    from hapticnet.study.rig import VirtualRig
    from hapticnet.study.schedule import participant_number
    from hapticnet.study.session import limits_session, today, version
    from hapticnet.study.simulated_front import SimulatedFront

    known, observer = shared
    number = participant_number(settings.participant)
    with common.virtual_fingertip(settings.device, known, settings.seed + number) as fingertip:
        rig = VirtualRig(fingertip, MasterSettings())
        front = SimulatedFront(
            observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=True
        )
        with limits_session(settings, rig.now_us()) as (flow, store):
            asyncio.run(conduct(flow, rig, front, store, date=today, version=version()))
        return _account(settings, flow)


def _in_real_time(
    settings: "SessionSettings",
    known: "Profile",
    observer: "ObserverSettings | None",
    opened: pages.OpenedPage | None,
    say: Any,
) -> dict[str, Any]:
    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.runtime.clock import now_us
    from hapticnet.study.real_rig import Body, RealRig
    from hapticnet.study.session import limits_session

    screen = None
    if opened is not None:
        screen = pages.make_screen(opened, None, "nobody", masking_noise=settings.plan.masking_noise)
    with (
        common.real_fingertip(settings.device, known, settings.seed) as (fingertip, wire),
        limits_session(settings, now_us()) as (flow, store),
    ):
        body = Body(fingertip=fingertip, wire=wire, hand_watchers=() if screen is None else screen.watchers)
        rig = RealRig(body, MasterSettings(), None, tell=say)
        common.run_session(common.conduct_in_real_time(rig, flow, store, settings, observer, screen))
        return _account(settings, flow)


def _account(settings: "SessionSettings", flow: Any) -> dict[str, Any]:
    from hapticnet.errors import SettingsError
    from hapticnet.study.session import write_participant

    try:
        path, measured = write_participant(settings, flow)
    except SettingsError as error:
        return {"participant": settings.participant, "no_jnd": str(error)}
    return {"file": str(path), **measured.model_dump(exclude={"reference"}), "reference": _lines(measured.reference)}


def _lines(references: Any) -> list[dict[str, Any]]:
    return [each.model_dump() for each in references]
