"""``hapticnet experiment``: the paper's study, with people or simulated observers, and its analysis."""

import typer

from hapticnet.cli.experiment import analyse, export, power

app = typer.Typer(no_args_is_help=True, help="Run the paper's study, analyse it, plan it, export its data.")
app.command(short_help="Make tables, figures and a report of the answers.")(analyse.analyse)
app.command(short_help="Simulate how often a study finds a difference.")(power.power)
app.command(short_help="Copy the data as BIDS or Psych-DS.")(export.export)
