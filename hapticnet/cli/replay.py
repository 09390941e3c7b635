"""``hapticnet replay``: one or two recordings on a page, with pause, seek, speed and loop."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.web.tape import Tape

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Recording of a master or slave, or any file with a force and its times.")
]
Second = Annotated[Path | None, typer.Argument(metavar="FILE", help="Another one, to be shown beside it.")]


def replay(
    file: File,
    second: Second = None,
    page: options.Page = None,
    speed: Annotated[float, typer.Option(help="Speed at first, from 0.1 to 4; the page can change it.")] = 1.0,
    loop: Annotated[bool, typer.Option(help="Start again at the end; the page can change it.")] = False,
    force_column: options.ForceColumn = None,
    position_column: options.PositionColumn = None,
    time_column: options.TimeColumn = None,
    sampling_rate: options.SamplingRate = None,
    missing: options.MissingValues = "refuse",
    max_size: options.MaxSize = options.MAX_SIZE,
) -> None:
    """Show a recording on a page as it was, or two side by side, with pause, seek, speed and loop.

    Each page plays independently, and starts when it becomes visible. Columns, rate and missing
    values matter only for files of other programs. Ends on Ctrl-C or SIGTERM.
    """
    from hapticnet.checks import check_parameter
    from hapticnet.cli.console import Console
    from hapticnet.cli.pages import listen_for, say_addresses, until_signal
    from hapticnet.runtime.system import run

    check_parameter("--speed", speed, 0.1, 4.0)
    console = Console("replay")
    sock, access = listen_for(page, ("watch",), console, can="watch the recordings")
    from hapticnet.recordings.loading import load_recording
    from hapticnet.recordings.session.reading import ForeignError, read_session
    from hapticnet.web.replay import Replay
    from hapticnet.web.server import Server
    from hapticnet.web.tape import tape_of_force, tape_of_session

    def load(path: Path) -> "Tape":
        console.status(f"reading {path}")
        try:
            tape = tape_of_session(path, read_session(path, max_bytes=max_size))
        except ForeignError:
            recording = load_recording(
                path, columns=force_column, position=position_column, time=time_column, rate_hz=sampling_rate,
                missing=missing, max_bytes=max_size,
            )  # fmt: skip
            tape = tape_of_force(path, recording)
        for note in tape.notes:
            console.say(f"{path}: {note}")
        return tape

    try:
        shown = Replay(
            [load(each) for each in (file, second) if each is not None], console.warn, speed=speed, loop=loop
        )
        say_addresses({"watch it here: ": "watch"}, access, console)
        run(until_signal(Server(shown, access, sock), shown))
    finally:
        sock.close()
        console.finish()
