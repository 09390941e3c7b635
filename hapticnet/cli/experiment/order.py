"""``hapticnet experiment order``: let a participant order three tissues by stiffness."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hapticnet.cli import options
from hapticnet.cli.experiment import common
from hapticnet.cli.experiment import page as pages

if TYPE_CHECKING:
    from hapticnet.device.profile import Profile
    from hapticnet.study.observers import ObserverSettings
    from hapticnet.study.recordings import RecordingForm
    from hapticnet.study.session import SessionSettings


def order(
    participant: common.Participant,
    session: common.Session = 1,
    plan: common.PlanOption = "paper",
    seed: common.SeedOption = 0,
    out: common.Out = Path("study"),
    device: options.DeviceOption = "sim",
    profile: options.ProfileOption = None,
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
    key: options.KeyOption = None,
    peer_key: options.PeerKeyOption = None,
    insecure: options.Insecure = False,
    simulate: common.Simulate = None,
    real_time: common.RealTime = False,
    jobs: common.Jobs = None,
    record: Annotated[
        Literal["mcap", "npz", "none"] | None,
        typer.Option(help="Form of the recordings, one a trial; default: mcap in real time if installed, else npz."),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="With --simulate, end with report and figures.")
    ] = True,
    resume: common.Resume = False,
    dry_run: common.DryRun = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Let a participant order three tissues by stiffness, under each condition of the plan.

    Trials come in balanced orders that are drawn first and stored. Each answer is stored at once; --resume goes on
    after any interruption. Nothing that the participant sees tells the condition. With simulated observers, report and
    figures follow, as by 'hapticnet experiment analyse'.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.experiment.workers import workers
    from hapticnet.runtime import devices
    from hapticnet.study.recordings import usual_form
    from hapticnet.study.schedule import draw_order
    from hapticnet.study.session import SessionSettings, check_number, keep_plan, law_of_participant

    pages.check_page(page, simulate, operator)
    asked = common.check(participant, plan, simulate, real_time=real_time)
    if dry_run:
        for each in asked.participants:
            print(draw_order(asked.plan, each, session, seed).to_json(), end="")
        return
    known = devices.load(profile)
    devices.check_device(device)
    form = record or usual_form(real_time=asked.observer is None or real_time)
    console = Console("order", quiet=quiet)
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
        law_of_participant(own)
    keep_plan(asked.plan, out)
    accounts = []
    if asked.observer is None or real_time:
        from hapticnet.cli.experiment.real_time import Place, run_order

        with pages.opened(page, console) as opened:
            place = Place(
                operator=operator, page=opened, connect=connect, key=key, peer_key=peer_key, insecure=insecure
            )
            accounts.append(run_order(settings[0], known, asked.observer, place, form=form, say=console.say))
    else:
        shared = known, asked.observer, form
        with workers(common.jobs_for(jobs, len(settings)), shared) as in_order:
            for account in in_order(_in_virtual_time, settings):
                accounts.append(account)
                console.status(f"{len(accounts)} of {len(settings)} participants")
    console.finish()
    if asked.observer is not None and report:
        from hapticnet.cli.experiment.analyse import write_results

        write_results(out, out / "results", margin=None, seed=seed, figures=True, say=console.say)
    title = "Ordering task" if asked.observer is None else f"Ordering task, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _in_virtual_time(
    shared: "tuple[Profile, ObserverSettings, RecordingForm]", settings: "SessionSettings"
) -> dict[str, Any]:
    import asyncio

    from hapticnet.node.master_settings import MasterSettings
    from hapticnet.study.conduct import conduct
    from hapticnet.study.recordings import record_trials
    from hapticnet.study.rig import VirtualRig
    from hapticnet.study.schedule import participant_number
    from hapticnet.study.session import account_of, order_session, today, version
    from hapticnet.study.simulated_front import SimulatedFront

    known, observer, form = shared
    number = participant_number(settings.participant)
    with common.virtual_fingertip(settings.device, known, settings.seed + number) as fingertip:
        rig = VirtualRig(fingertip, MasterSettings())
        front = SimulatedFront(
            observer, rig, seed=settings.seed, participant=number, session=settings.session, waits=True
        )
        with order_session(settings, rig.now_us()) as (flow, store):
            keep = record_trials(settings, form, {"device": settings.device})
            asyncio.run(conduct(flow, rig, front, store, date=today, version=version(), on_outcome=keep))
        return account_of(settings, flow)
