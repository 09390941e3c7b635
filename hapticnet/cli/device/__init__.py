"""``hapticnet device``: the fingertip device by itself, without a slave."""

import typer

from hapticnet.cli.device import calibrate, find, info, monitor, sim, step, tune

app = typer.Typer(no_args_is_help=True, help="The fingertip device by itself: find, calibrate, tune and try it.")
app.command()(find.find)
app.command()(info.info)
app.command()(monitor.monitor)
app.command()(calibrate.calibrate)
app.command()(tune.tune)
app.command()(step.step)
app.command()(sim.sim)
