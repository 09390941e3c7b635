"""``hapticnet experiment``: the paper's study, with people or simulated observers, and its analysis."""

from typing import Final

import typer

from hapticnet.cli.verbs import equip
from hapticnet_experiment.cli import results
from hapticnet_experiment.cli.asked import LimitsOptions, OrderOptions

EXAMPLES: Final = {
    ("experiment",): (
        "hapticnet experiment limits --participant 03 --device serial:auto --profile device.toml",
        "hapticnet experiment order --participant 01-08 --simulate literature",
        "hapticnet experiment analyse study",
    ),
    ("experiment", "limits"): (
        "hapticnet experiment limits --participant 03 --device serial:auto --profile device.toml",
        "hapticnet experiment limits --participant 03 --simulate literature --out-dir rehearsal",
    ),
    ("experiment", "order"): (
        "hapticnet experiment order --participant 03 --plan reachable --device serial:auto --profile device.toml",
        "hapticnet experiment order --participant 01-08 --simulate literature --out-dir rehearsal",
    ),
    ("experiment", "texts"): ("hapticnet experiment texts >my-texts.toml",),
    ("experiment", "analyse"): ("hapticnet experiment analyse study --no-plots",),
}
"""Examples at the end of each ``--help``. A test parses every line."""

app = typer.Typer(
    no_args_is_help=True, help="Run the paper's study with people or simulated observers, and analyse it."
)


def limits(asked: LimitsOptions) -> None:
    """Measure the JND of a participant at each reference force, and write DIR/participants/NUMBER.toml.

    The plan chooses the method: ascending limits, or a forced choice of two intervals with a 1-up-2-down staircase.
    Forces pass the hold and the force loop, as in the ordering task; a pair that the device missed is presented again.
    Each answer is stored at once; --resume continues after any interruption.
    """
    from hapticnet_experiment.cli.conducting import run

    run(asked)


def order(asked: OrderOptions) -> None:
    """Let a participant order three tissues by stiffness, under each condition of the plan.

    Trials come in balanced orders that are drawn first and stored. Each answer is stored at once; --resume continues
    after any interruption. The participant's screen never reveals the condition. With simulated observers, report and
    figures follow, as by 'hapticnet experiment analyse'; on two cores, eight participants take about two minutes.
    """
    from hapticnet_experiment.cli.conducting import run

    run(asked)


app.command(short_help="Measure a participant's JND.")(limits)
app.command(short_help="Let a participant order three tissues by stiffness.")(order)
app.command(short_help="Print what participants read, to change or translate it.")(results.texts)
app.command(short_help="Make tables, figures and a report of the answers.")(results.analyse)
equip(app, ("experiment",), EXAMPLES)
