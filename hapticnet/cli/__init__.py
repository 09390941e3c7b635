"""The command line: one thin module per verb. Nothing heavy is imported before a verb needs it."""

import os
import sys
from typing import Any, Final

import typer

from hapticnet.cli import (
    codecs,
    compare,
    demo,
    device,
    doctor,
    gallery,
    key,
    recordings,
    replay,
    scene,
    stability,
    sweep,
)
from hapticnet.cli.console import complain
from hapticnet.cli.given import MasterOptions, SlaveOptions
from hapticnet.cli.plugins import Verbs
from hapticnet.cli.verbs import SOURCE, equip
from hapticnet.errors import FileError, HapticnetError, SettingsError, in_words
from hapticnet.interrupts import ignore_further
from hapticnet.options import AUTO
from hapticnet.runtime.nonblocking_log import abandon

INTERNAL: Final = 70  # exit code of a fault in hapticnet itself (EX_SOFTWARE of sysexits.h)
INTERRUPTED: Final = 130  # exit code of a program that SIGINT ended, as in shells
READER_GONE: Final = 141  # and of one that SIGPIPE ended
SHOW_TRACEBACK: Final = "HAPTICNET_TRACEBACK"  # environment variable that shows where an internal error comes from

WRONG: Final = {  # messages for invalid values, by pydantic's type of error
    "int_parsing": "is not a whole number",
    "float_parsing": "is not a number",
    "greater_than_equal": "is too small; it must be at least {ge:g}",
    "less_than_equal": "is too large; it must be at most {le:g}",
}

app = typer.Typer(
    cls=Verbs,
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Haptic teleoperation with perceptual deadband compression.",
)
app.command(short_help="Play the paper's conditions with a slave and a master.")(demo.demo)
app.command(short_help="Serve five demonstrations for a talk, each one click.")(gallery.gallery)


@app.command(short_help="Host the virtual tissues.")
def slave(given: SlaveOptions) -> None:
    """Host the virtual tissues: each master touches its own scene.

    On loopback, anyone is served unless --key or --masters is given. Elsewhere, only listed masters are
    served: --key and --masters, by default key.toml and masters.toml in ~/.config/hapticnet.

    Ends on Ctrl-C, SIGTERM or after --duration, and then prints its report. A second signal ends --drain.
    """
    from hapticnet.cli.slave import serve

    serve(given)


@app.command(short_help="Send the operator's motion, render the force that comes back.")
def master(given: MasterOptions) -> None:
    """Stream the operator's position to a slave and drive the fingertip device with the force that comes back.

    Sessions with other hosts need --peer-key, and --key or ~/.config/hapticnet/key.toml.

    Waits for the slave if it is not running yet, and again if it disappears. Ends on Ctrl-C, SIGTERM or when the
    operator is done, and then prints its report.
    """
    from hapticnet.cli.master import join

    join(given)


app.command(short_help="Compare every codec on recordings with the best possible.")(compare.compare)
app.command(short_help="Say where a late force makes a hand swing.")(stability.stability)
app.command(short_help="Print what a recording holds.")(recordings.info)
app.command(short_help="Write a recording as CSV, NumPy or MCAP.")(recordings.export)
app.command(short_help="Show one or two recordings on a page.")(replay.replay)
app.command(short_help="List the codecs with their rules and parameters.")(codecs.codecs)
app.command(short_help="Check whether this machine is fit, and say what to do.")(doctor.doctor)
app.add_typer(scene.app, name="scene")
app.add_typer(device.app, name="device")
app.add_typer(key.app, name="key")
app.add_typer(sweep.app, name="sweep", short_help="Compute every combination of the settings in a study.")
equip(app)


@app.callback(invoke_without_command=True)
def _root(version: bool = typer.Option(False, "--version", help="Print the version and exit.")) -> None:
    if version:
        from hapticnet import __version__
        from hapticnet.compiled import describe_core

        print(f"hapticnet {__version__} ({describe_core()})")
        raise typer.Exit


def main() -> None:
    """Run the command line. Errors are one line on stderr, never a traceback.

    docs/use/service.md lists the exit codes.
    """
    try:
        if not os.environ.get("COLUMNS", "").strip("0"):  # rich would print nothing in 0 columns
            os.environ.pop("COLUMNS", None)
        code = app(with_page_address(sys.argv[1:]), standalone_mode=False, prog_name="hapticnet")
        if sys.stdout is not None:
            sys.stdout.flush()
    except HapticnetError as error:
        complain(str(error))
        code = error.exit_code
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BrokenPipeError:  # the reader of stdout has gone
        abandon(sys.stdout)
        code = READER_GONE
    except OSError as error:  # print() met a full disk
        abandon(sys.stdout)
        complain(f"output cannot be written: {error.strerror or error}")
        code = FileError.exit_code
    except Exception as error:
        code = _tell(error)
    ignore_further()
    sys.exit(code if isinstance(code, int) else 0)


def _tell(error: Exception) -> int:
    """Print what the argument parser or a fault of hapticnet raised; return the exit code."""
    if not hasattr(error, "format_message"):
        if os.environ.get(SHOW_TRACEBACK):
            raise error
        complain(f"internal error: {in_words(error)}; please report it with what {SHOW_TRACEBACK}=1 shows")
        return INTERNAL
    _reword(error)
    message = error.format_message()
    if message.startswith("Usage:"):  # a verb is missing, so this is the help
        print(message, file=sys.stderr)
    else:
        complain(f"{_source(error)}{message} (see {_command_path(error)} --help)")
    return SettingsError.exit_code


def _reword(error: Any) -> None:
    """Translate typer's message about a value, in pydantic's words, into plain words."""
    mistakes = error.__cause__.errors() if hasattr(error.__cause__, "errors") else []
    for mistake in mistakes[:1]:
        if (words := WRONG.get(mistake["type"])) is not None:
            error.message = f"{mistake['input']!r} {words.format(**mistake.get('ctx', {}))}"
        else:
            error.message = error.message.removeprefix("Value error, ").removesuffix(".")


def with_page_address(arguments: list[str]) -> list[str]:
    """Return the command line with an address after each ``--page`` that has none, because the parser needs one."""
    following = [*arguments[1:], "-"]
    return [
        f"--page={AUTO}" if argument == "--page" and next_one.startswith("-") else argument
        for argument, next_one in zip(arguments, following, strict=False)
    ]


def _command_path(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return str(context.command_path) if context else "hapticnet"


def _source(error: Any) -> str:
    """Return the file and table that gave an invalid value; an empty text for the command line."""
    if getattr(error, "ctx", None) is None or getattr(error, "param", None) is None:
        return ""
    source = error.ctx.get_parameter_source(error.param.name)
    return f"{error.ctx.meta[SOURCE]}: " if source is not None and source.name == "DEFAULT_MAP" else ""
