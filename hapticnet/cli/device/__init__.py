"""``hapticnet device``: the fingertip device without a slave."""

import typer

from hapticnet.cli.device import calibrate, force_loop, new_package, wired

app = typer.Typer(no_args_is_help=True, help="Find, calibrate, tune and test a fingertip device.")
app.command(short_help="List the serial ports.")(wired.find)
app.command(short_help="Show the identity of a device.")(wired.info)
app.command(short_help="Calibrate the force sensor with known forces.")(calibrate.calibrate)
app.command(short_help="Measure the position and stiffness of the finger.")(force_loop.tune)
app.command(short_help="Apply a step of force; report rise and settling.")(force_loop.step)
app.command(short_help="Write a package for a device of your own.")(new_package.new)
app.command(short_help="Run the simulated firmware on a pseudo-terminal.")(wired.sim)
