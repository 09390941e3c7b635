"""``hapticnet experiment limits``: measure a participant's JND."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticnet import options
from hapticnet.cli.experiment import common
from hapticnet.cli.experiment import page as pages
from hapticnet.cli.experiment.virtual_time import OnTrial, conduct_all, conduct_in_virtual_time

if TYPE_CHECKING:
    from hapticnet.device.profile import Profile
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.session import SessionSettings


def limits(
    participant: common.Participant,
    session: common.Session = 1,
    plan: common.PlanOption = "paper",
    seed: common.SeedOption = 0,
    out_dir: common.OutDir = Path("study"),
    device: options.Device = "sim",
    profile: options.Profile = None,
    page: pages.PageOption = None,
    simulate: common.Simulate = None,
    wall_clock: common.WallClock = False,
    jobs: options.Jobs = None,
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
    from hapticnet.runtime import devices
    from hapticnet.study.limits_flow import draw_limits
    from hapticnet.study.session import LIMITS, keep_plan

    pages.check_page(page, simulate)
    asked = common.check(participant, plan, simulate, wall_clock=wall_clock)
    if dry_run:
        common.show_schedules(
            [draw_limits(asked.plan, each, session, seed) for each in asked.participants], asked, json
        )
        return
    known = devices.load(profile)
    devices.check_device(device)
    console = Console("limits", quiet=quiet)
    sessions = common.sessions_of(
        asked, LIMITS, session=session, seed=seed, out=out_dir, device=device, resume=resume, wall_clock=wall_clock
    )
    keep_plan(asked.plan, out_dir)
    common.remind_of_consent(asked, console.say)
    if asked.observer is None or wall_clock:
        with pages.opened(page, console, sessions[0].folder(LIMITS), resume=resume) as opened:
            accounts = [_in_real_time(sessions[0], known, asked.observer, opened, console.say)]
    else:
        shared = known, asked.observer
        accounts = conduct_all(_in_virtual_time, shared, sessions, jobs, console, "pairs")
    console.finish()
    for account in accounts:
        for told in (*(f"excluded: {why}" for why in account.get("excluded", ())), *account.get("warnings", ())):
            console.warn(f"participant {account['participant']}: {told}")
    title = "JND" if asked.observer is None else f"JND, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _in_virtual_time(
    shared: "tuple[Profile, ObserverSettings]", settings: "SessionSettings", on_trial: OnTrial
) -> dict[str, Any]:
    from hapticnet.study.session import limits_session

    return conduct_in_virtual_time(*shared, settings, limits_session, _account, on_trial)


def _in_real_time(
    settings: "SessionSettings",
    known: "Profile",
    observer: "ObserverSettings | None",
    opened: pages.OpenedPage | None,
    say: Any,
) -> dict[str, Any]:
    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.runtime.system import now_us
    from hapticnet.study.real_rig import Body, RealRig
    from hapticnet.study.session import limits_session

    screen = None
    if opened is not None:
        screen = pages.make_screen(opened, None, "nobody", settings.plan)
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
