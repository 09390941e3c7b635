"""How far a sweep is, on stderr: a bar on a terminal, a line now and then elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from hapticnet.cli.console import Console

if TYPE_CHECKING:
    from hapticnet.sweep.conduct import Progress

LINE_S: Final = 30.0
"""Time [s] between two lines where there is no terminal."""


class Shown:
    """Shows the progress of a sweep.

    Parameters
    ----------
    bar
        A `rich.progress.Progress` with one task; None: print lines.
    """

    def __init__(self, console: Console, bar: Any = None) -> None:
        self._console = console
        self._bar = bar
        self._said_s = 0.0

    def update(self, progress: "Progress") -> None:
        """Show how far it is."""
        if self._bar is not None:
            self._bar.update(
                self._bar.task_ids[0], total=progress.runs, completed=progress.done, state=_state(progress)
            )
        elif progress.seconds - self._said_s >= LINE_S:
            self._said_s = progress.seconds
            self._console.say(f"{progress.done:,} of {progress.runs:,} runs, {_state(progress)}")

    def notes(self, progress: "Progress") -> None:
        """Say what a person must know at the end."""
        if progress.failed:
            self._console.warn(
                f"{progress.failed:,} runs have an error in the place of figures, the first: {progress.first_error}"
            )
        if progress.stopped:
            self._console.say(f"stopped with {progress.done:,} of {progress.runs:,} runs; the same command goes on")


@contextmanager
def shown(name: str, *, quiet: bool) -> Iterator[Shown]:
    """Yield what shows the progress of a study."""
    console = Console("sweep", quiet=quiet)
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield Shown(console)
        return
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(bar_width=20), MofNCompleteColumn(), TextColumn("{task.fields[state]}"))
    with Bar(*columns, console=Terminal(stderr=True), transient=True) as bar:
        bar.add_task(name, total=None, state="")
        yield Shown(console, bar)


def _state(progress: "Progress") -> str:
    if progress.stopped:
        return "finishing the shards in hand"
    parts = [f"{progress.runs_per_s:.3g} runs/s", f"{progress.workers} workers"]
    if progress.left_s is not None:
        parts.append(f"{_time(progress.left_s)} left")
    if progress.failed:
        parts.append(f"{progress.failed:,} failed")
    if progress.broken:
        parts.append(f"{progress.broken} workers lost")
    return ", ".join(parts)


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
