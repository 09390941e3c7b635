"""``hapticnet doctor``: whether this machine is fit."""

import shutil
import sys
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Final

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from hapticnet.runtime.doctor import Finding, Step

NARROWEST: Final = 40
WIDEST: Final = 100
"""Shortest and longest line: shorter ones leave no room for values, and longer ones read badly."""

INDENT: Final = 12
"""Column of titles, and of the text below them."""


def doctor(
    quick: Annotated[bool, typer.Option(help="Leave out the 3 s of measuring.")] = False,
) -> None:
    """Say whether this machine can run a slave and a master, and what to do if it cannot.

    Looks at timer, scheduling, CPUs and socket buffers. Measures round trip and ticks with a slave and a master at
    1 kHz on loopback for 3 s.

    Changes nothing on this machine. Each finding is ok, a warning (it works, but worse than it could) or a problem (it
    will not work).

    Exit code: 0 if there is no problem, 1 if there is one, 2 if the options are wrong.
    """
    from hapticnet.cli.console import Console
    from hapticnet.runtime.doctor import Verdict, examine, examine_trial

    console = Console("doctor")
    findings = examine()
    if not quick:
        console.status("measuring for 3 s")
        findings += examine_trial()
    console.finish()
    if sys.stdout is not None:  # which the parent process may have closed
        text = "".join(f"{line.rstrip()}\n" for line in page(findings, shutil.get_terminal_size().columns))
        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(text.encode(encoding, "replace").decode(encoding))
    if any(finding.verdict is Verdict.PROBLEM for finding in findings):
        raise typer.Exit(1)


def page(findings: "Sequence[Finding]", columns: int) -> "Iterator[str]":
    """Yield the lines of the findings, and of the answer at the end."""
    from hapticnet.runtime.doctor import Verdict

    width = max(NARROWEST, min(columns, WIDEST))
    said: tuple[Step, ...] = ()
    for finding in findings:
        first, *lines = wrap(f"{finding.title:<20} {finding.value}", width - INDENT, subsequent_indent=" " * 21)
        yield f"  {finding.verdict:<{INDENT - 2}}{first}"
        lines += wrap(finding.meaning, width - INDENT)
        for step in () if finding.to_do == said else finding.to_do:
            lines += wrap(f"> {step.text}", width - INDENT)
            if step.command:  # in one piece, so that it can be copied
                lines.append(f"    {step.command}")
        said = finding.to_do or said
        yield from (" " * INDENT + line for line in lines)
    yield ""
    problems, warnings = (
        ", ".join(finding.title for finding in findings if finding.verdict is verdict)
        for verdict in (Verdict.PROBLEM, Verdict.WARNING)
    )
    answer = "This machine can run hapticnet."
    if problems:
        answer = f"This machine is not ready. First fix: {problems}."
    elif warnings:
        answer = f"This machine can run hapticnet; what would help: {warnings}."
    yield from wrap(answer, width)
