"""``hapticnet device``: the fingertip device by itself, without a slave."""

import typer

from hapticnet.cli.device import calibrate, find, info, monitor, sim, step, tune

app = typer.Typer(no_args_is_help=True, help="The fingertip device by itself: find, calibrate, tune and try it.")
app.command(short_help="List the serial ports there are.")(find.find)
app.command(short_help="Ask a device who it is.")(info.info)
app.command(short_help="Show live readings; the platform stays retracted.")(monitor.monitor)
app.command(short_help="Calibrate the force sensor with known forces.")(calibrate.calibrate)
app.command(short_help="Find out where the finger is, and how stiff.")(tune.tune)
app.command(short_help="Press with a step of force, report rise and settling.")(step.step)
app.command(short_help="Run the firmware, simulated, on a pseudo-terminal.")(sim.sim)
