"""The command line: one thin module per verb. Nothing heavy is imported before a verb needs it."""

import sys

import typer

from hapticnet.cli import channel, codecs, compare, demo, device, doctor, encode, experiment, key, master, scene, slave
from hapticnet.cli.console import complain
from hapticnet.errors import HapticnetError
from hapticnet.runtime.outlet import abandon

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Haptic teleoperation with perceptual deadband compression.",
)
app.command(short_help="Play the paper's conditions with a slave and a master.")(demo.demo)
app.command(short_help="Host the virtual tissues.")(slave.slave)
app.command(short_help="Send the operator's motion, render the force that comes back.")(master.master)
app.command(short_help="Stand between the two as a worse network would.")(channel.channel)
app.command(short_help="Run a codec over a recorded force.")(encode.encode)
app.command(short_help="Compare every codec on recordings with the best possible.")(compare.compare)
app.command(short_help="List the codecs with their rules and parameters.")(codecs.codecs)
app.command(short_help="Check whether this machine is fit, and say what to do.")(doctor.doctor)
app.add_typer(scene.app, name="scene")
app.add_typer(device.app, name="device")
app.add_typer(key.app, name="key")
app.add_typer(experiment.app, name="experiment")


@app.callback(invoke_without_command=True)
def _root(version: bool = typer.Option(False, "--version", help="Print the version and exit.")) -> None:
    if version:
        from hapticnet import __version__

        print(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line. Errors are one line on stderr and exit code 2; never a traceback."""
    try:
        code = app(standalone_mode=False, prog_name="hapticnet")
        if sys.stdout is not None:
            sys.stdout.flush()
    except HapticnetError as error:
        complain(str(error))
        code = 2
    except KeyboardInterrupt:
        code = 130
    except BrokenPipeError:  # the reader of stdout has gone
        abandon(sys.stdout)
        code = 1
    except OSError as error:  # print() met a full disk
        abandon(sys.stdout)
        complain(f"output cannot be written: {error.strerror or error}")
        code = 2
    except Exception as error:
        if not hasattr(error, "format_message"):  # what the argument parser raises
            raise
        message = error.format_message()
        if message.startswith("Usage:"):  # a verb is missing, and this is the help
            print(message, file=sys.stderr)
        else:
            complain(f"{message} (see {_command_path(error)} --help)")
        code = 2
    sys.exit(code if isinstance(code, int) else 0)


def _command_path(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return str(context.command_path) if context else "hapticnet"
