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
    hand: Annotated[
        str | None, typer.Option(metavar="HAND[,KEY=VALUE…]", help="Say when this hand would swing; needs --delay.")
    ] = None,
    delay: Annotated[str | None, typer.Option(metavar="TIME", help="Round trip to the slave, such as 50ms.")] = None,
    scene: Annotated[str | None, typer.Option(metavar="SCENE", help="What that hand touches.")] = None,
) -> None:
    """Say whether this machine can run a slave and a master, and what to do if it cannot.

    Looks at timer, scheduling, CPUs and socket buffers. Measures round trip and ticks with a slave and a master at
    1 kHz on loopback for 3 s. With --hand, also says whether a hand on a device that pushes it would swing.

    Changes nothing on this machine. Each finding is ok, a warning (it works, but worse than it could) or a problem (it
    will not work).

    Exit code: 0 if there is no problem, 1 if there is one, 2 if the options are wrong.
    """
    from hapticnet.channel.settings import parse_time_us
    from hapticnet.cli.console import Console
    from hapticnet.errors import SettingsError
    from hapticnet.runtime.doctor import Verdict, examine, examine_trial, judge_stability

    if (hand is None) != (delay is None) or (scene is not None and hand is None):
        raise SettingsError("--hand needs --delay, and --delay and --scene need --hand")
    console = Console("doctor")
    findings = examine()
    if hand is not None and delay is not None:
        findings.append(judge_stability(hand, 1e-6 * parse_time_us(delay), scene))
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
