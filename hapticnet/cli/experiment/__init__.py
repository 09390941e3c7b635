"""``hapticnet experiment``: the paper's study, with people or simulated observers, and its analysis."""

import typer

from hapticnet.cli.experiment import results
from hapticnet.cli.experiment.asked import LimitsOptions, OrderOptions

app = typer.Typer(
    no_args_is_help=True, help="Run the paper's study with people or simulated observers, and analyse it."
)


def limits(asked: LimitsOptions) -> None:
    """Measure the JND of a participant at each reference force, and write DIR/participants/NUMBER.toml.

    The plan chooses the method: ascending limits, or a forced choice of two intervals with a 1-up-2-down staircase.
    Forces pass the hold and the force loop, as in the ordering task; a pair that the device missed is presented again.
    Each answer is stored at once; --resume continues after any interruption.
    """
    from hapticnet.cli.experiment.conducting import run

    run(asked)


def order(asked: OrderOptions) -> None:
    """Let a participant order three tissues by stiffness, under each condition of the plan.

    Trials come in balanced orders that are drawn first and stored. Each answer is stored at once; --resume continues
    after any interruption. The participant's screen never reveals the condition. With simulated observers, report and
    figures follow, as by 'hapticnet experiment analyse'; on two cores, eight participants take about two minutes.
    """
    from hapticnet.cli.experiment.conducting import run

    run(asked)


app.command(short_help="Measure a participant's JND.")(limits)
app.command(short_help="Let a participant order three tissues by stiffness.")(order)
app.command(short_help="Print what participants read, to change or translate it.")(results.texts)
app.command(short_help="Make tables, figures and a report of the answers.")(results.analyse)
