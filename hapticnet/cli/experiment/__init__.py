"""``hapticnet experiment``: the paper's study, with people or simulated observers, and its analysis."""

import typer

from hapticnet.cli.experiment import results, sessions

app = typer.Typer(
    no_args_is_help=True, help="Run the paper's study with people or simulated observers, and analyse it."
)
app.command(short_help="Measure a participant's JND.")(sessions.limits)
app.command(short_help="Let a participant order three tissues by stiffness.")(sessions.order)
app.command(short_help="Print what participants read, to change or translate it.")(results.texts)
app.command(short_help="Make tables, figures and a report of the answers.")(results.analyse)
app.command(short_help="Simulate how often a study finds a difference.")(results.power)
app.command(short_help="Copy the data as BIDS.")(results.export)
