"""``hapticnet experiment order``: let a participant order three tissues by stiffness."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hapticnet import options
from hapticnet.cli.experiment import common
from hapticnet.cli.experiment import page as pages
from hapticnet.cli.experiment.virtual_time import OnTrial, conduct_all, conduct_in_virtual_time

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
    out_dir: common.OutDir = Path("study"),
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
    simulate: common.Simulate = None,
    wall_clock: common.WallClock = False,
    jobs: options.Jobs = None,
    record_format: Annotated[
        Literal["mcap", "npz", "none"] | None,
        typer.Option(help="Format of the recordings, one a trial; default: mcap in real time if installed, else npz."),
    ] = None,
    analyse: Annotated[bool, typer.Option(help="With --simulate, analyse the study at the end.")] = True,
    resume: common.Resume = False,
    dry_run: common.DryRun = False,
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
    from hapticnet.study.recordings import usual_form
    from hapticnet.study.schedule import draw_order
    from hapticnet.study.session import ORDER, keep_plan, law_of_participant

    pages.check_page(page, simulate, operator)
    asked = common.check(participant, plan, simulate, wall_clock=wall_clock)
    if dry_run:
        common.show_schedules([draw_order(asked.plan, each, session, seed) for each in asked.participants], asked, json)
        return
    known = devices.load(profile)
    devices.check_device(device)
    form = record_format or usual_form(real_time=asked.observer is None or wall_clock)
    console = Console("order", quiet=quiet)
    sessions = common.sessions_of(
        asked, ORDER, session=session, seed=seed, out=out_dir, device=device, resume=resume, wall_clock=wall_clock
    )
    laws: dict[str, list[str]] = {}
    for each_session in sessions:
        laws.setdefault(law_of_participant(each_session).describe(), []).append(each_session.participant)
    keep_plan(asked.plan, out_dir)
    common.remind_of_consent(asked, console.say)
    for law, people in laws.items():
        console.say(f"participant {', '.join(people)}: {law}")
    if asked.observer is None or wall_clock:
        from hapticnet.cli.experiment.real_time import Place, run_order

        with pages.opened(page, console, sessions[0].folder(ORDER), resume=resume) as opened:
            place = Place(
                operator=operator, page=opened, connect=connect, key=key, peer_key=peer_key, insecure=insecure
            )
            accounts = [run_order(sessions[0], known, asked.observer, place, form=form, say=console.say)]
    else:
        shared = known, asked.observer, form
        trials = len(sessions) * len(asked.plan.condition) * asked.plan.order.trials
        accounts = conduct_all(_in_virtual_time, shared, sessions, jobs, console, f"of {trials} trials")
    console.finish()
    if asked.observer is not None and analyse:
        from hapticnet.cli.experiment.analyse import write_results

        console.say("analysing the answers")
        write_results(out_dir, out_dir / "results", margin=None, seed=seed, plots=True, say=console.say)
    title = "Ordering task" if asked.observer is None else f"Ordering task, simulated observer {asked.observer.name}"
    deliver({"title": title, "participant": accounts}, as_json=json, file=None)


def _in_virtual_time(
    shared: "tuple[Profile, ObserverSettings, RecordingForm]", settings: "SessionSettings", on_trial: OnTrial
) -> dict[str, Any]:
    from hapticnet.study.recordings import record_trials
    from hapticnet.study.session import account_of, order_session

    known, observer, form = shared
    keep = record_trials(settings, form, {"device": settings.device})
    return conduct_in_virtual_time(known, observer, settings, order_session, account_of, on_trial, keep)
