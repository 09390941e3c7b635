"""``hapticnet experiment power``: what a study of so many participants and trials would find."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.study.plan import Plan
    from hapticnet.study.power import Answers, Power


def power(
    plan: Annotated[str, typer.Argument(metavar="PLAN", help="Plan: paper, reachable or a TOML file.")] = "paper",
    shares: Annotated[
        str | None,
        typer.Option(
            metavar="S[,S…]",
            show_default="the paper's, for a plan with its conditions",
            help="Shares of correct orders that you expect, one for each condition, such as 0.775,0.8,0.675,0.5375.",
        ),
    ] = None,
    simulate: Annotated[
        str | None,
        typer.Option(
            metavar="OBSERVER",
            help="In place of shares, play the plan for a simulated observer; most lose nothing by a deadband, see"
            " docs/understand/observers.md.",
        ),
    ] = None,
    participants: Annotated[str, typer.Option(metavar="N[,N…]", help="Numbers of participants.")] = "8,16,24",
    trials: Annotated[
        str | None, typer.Option(metavar="N[,N…]", help="Trials of each condition; default: the plan's.")
    ] = None,
    experiments: Annotated[int, typer.Option(metavar="N", help="Simulated experiments of each design.")] = 1000,
    margin: Annotated[float | None, typer.Option(help="Margin of equivalence; default: the plan's.")] = None,
    motions: Annotated[int, typer.Option(min=1, max=100, help="Motions of the hand played for each order.")] = 2,
    seed: options.Seed = 1,
    jobs: options.Jobs = None,
    out_dir: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for power.csv and the figure.")] = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Simulate experiments: power of the tests, and widths of the intervals. No person takes part.

    The effect is assumed: a study is large enough if it finds the smallest fall in correct orders that matters to you.
    """
    import json as json_module
    import os
    from dataclasses import asdict

    from hapticnet.cli.console import Console, check_new, check_outputs, show, write_text
    from hapticnet.cli.experiment.analyse import plain
    from hapticnet.errors import UnavailableError
    from hapticnet.experiment.provenance import provenance, provenance_lines
    from hapticnet.study.plan import find_plan
    from hapticnet.study.power import power as power_of
    from hapticnet.study.power_table import csv_text, lines

    chosen = find_plan(plan)
    designs = [
        (people, each)
        for each in _numbers("trials", str(chosen.order.trials) if trials is None else trials)
        for people in _numbers("participants", participants)
    ]
    if out_dir is not None:
        check_outputs(out_dir / "power.csv")
        check_new(out_dir / "power.csv", overwrite=overwrite)
    console = Console("experiment", quiet=json)
    cores = jobs or os.cpu_count() or 1
    try:
        answers, source = _answers(chosen, simulate, shares, motions, seed, cores, console.progress)
        found = power_of(
            answers,
            designs,
            experiments=experiments,
            margin=chosen.order.equivalence_margin if margin is None else margin,
            seed=seed,
            jobs=cores,
            on_design=lambda people, each: console.progress(f"{people} participants, {each} trials"),
        )
    except KeyboardInterrupt:
        console.finish()
        console.say("stopped; nothing was written")
        raise
    console.finish()
    if out_dir is not None:
        write_text(out_dir / "power.csv", csv_text(found, [f"SIMULATED: {source}", *provenance_lines()]), follow=False)
        console.say(f"table: {out_dir / 'power.csv'}")
        try:
            _draw(found, source, out_dir, console.say)
        except UnavailableError as error:
            console.say(str(error))
    if json:
        account = {"provenance": provenance(), "simulated": source, "designs": [asdict(each) for each in found]}
        print(json_module.dumps(plain(account), indent=1))
    else:
        show("\n".join(lines(found, source)))


def _draw(found: "list[Power]", source: str, out: Path, say: "object") -> None:
    from hapticnet.study.figures import draw_power

    for file in draw_power(found, source, out):
        say(f"picture: {file}")  # type: ignore[operator]


def _answers(
    plan: "Plan", observer: str | None, shares: str | None, motions: int, seed: int, jobs: int, status: "object"
) -> "tuple[Answers, str]":
    from hapticnet.errors import SettingsError
    from hapticnet.study.library import play_library
    from hapticnet.study.observers import labelled, parse_observer
    from hapticnet.study.power import ObserverAnswers, ShareAnswers

    if shares is not None and observer is not None:
        raise SettingsError("--shares and --simulate both say how people answer; give one of them")
    if observer is None:
        shares = shares or _paper_shares(plan)
        try:
            values = tuple(float(part) for part in shares.split(","))
        except ValueError:
            raise SettingsError(f"shares {shares!r} must be numbers from 0 to 1, such as 0.775,0.8") from None
        multipliers = tuple(each.threshold for each in plan.condition)
        assumed = ShareAnswers(tuple(each.name for each in plan.condition), multipliers, values)
        return assumed, f"assumed shares {shares}"
    settings = parse_observer(observer)
    library = play_library(
        plan,
        motions=motions,
        seed=seed,
        jobs=jobs,
        on_trial=lambda done, of: status(f"playing {done} of {of} trials"),  # type: ignore[operator]
    )
    return ObserverAnswers(tuple(library), settings), f"observer {labelled(settings.name)}"


def _paper_shares(plan: "Plan") -> str:
    """Return the paper's shares of correct orders; raise SettingsError if the plan has another condition."""
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.conditions import CONDITIONS

    known = {("raw", 0.0) if each.codec == "raw" else (each.codec, each.multiplier): each for each in CONDITIONS}
    for each in plan.condition:
        if (each.codec, each.threshold) not in known:
            example = ",".join(["0.775", *["0.675"] * (len(plan.condition) - 1)])
            names = ", ".join(condition.name for condition in plan.condition)
            raise SettingsError(
                f"condition {each.name!r} is none of the paper's, so nothing is known of its share of correct orders:"
                f" say what you expect of {names}, such as --shares {example}"
            )
    return ",".join(f"{known[each.codec, each.threshold].paper_correct:g}" for each in plan.condition)


def _numbers(name: str, text: str) -> list[int]:
    from hapticnet.errors import SettingsError

    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise SettingsError(f"{name} {text!r} must be whole numbers, such as 8,16,24") from None
