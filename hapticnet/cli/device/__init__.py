"""``hapticnet device``: the fingertip device without a slave."""

import typer

from hapticnet.cli.device import calibrate, find, info, monitor, sim, step, tune

app = typer.Typer(no_args_is_help=True, help="Find, calibrate, tune and test a fingertip device.")
app.command(short_help="List the serial ports.")(find.find)
app.command(short_help="Show the identity of a device.")(info.info)
app.command(short_help="Show live readings; the platform stays retracted.")(monitor.monitor)
app.command(short_help="Calibrate the force sensor with known forces.")(calibrate.calibrate)
app.command(short_help="Measure the position and stiffness of the finger.")(tune.tune)
app.command(short_help="Apply a step of force; report rise and settling.")(step.step)
app.command(short_help="Run the simulated firmware on a pseudo-terminal.")(sim.sim)
