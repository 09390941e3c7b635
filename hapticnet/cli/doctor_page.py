"""The page that ``hapticnet doctor`` prints. Verdicts are words; colour only repeats them."""

import sys
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, Final

from rich.console import Console
from rich.padding import Padding
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from hapticnet.runtime.doctor.finding import Finding, Step, Verdict, count

WIDEST: Final = 100
"""Characters of a line that still reads well."""

VERDICT_WIDTH: Final = 11
TITLE_WIDTH: Final = 20
INDENT: Final = 2 + VERDICT_WIDTH + 1
"""Column of titles, and of all that is said below them."""

COLOURS: Final = {
    Verdict.OK: "green",
    Verdict.WARNING: "bold yellow",
    Verdict.PROBLEM: "bold red",
    Verdict.ABSENT: "dim",
}

PLAIN: Final = str.maketrans({"µ": "u", "…": "..."})

PLURALS: Final = {Verdict.WARNING: "warnings", Verdict.PROBLEM: "problems"}

SUBJECTS: Final = {
    "timing": "Timer, scheduling, clock",
    "processor": "Processor",
    "software": "Python",
    "network": "Network",
    "serial": "Fingertip device on a serial port",
    "simulator": "Simulated device",
    "measured": "Measured for 3 s: a slave and a master at 1 kHz on loopback",
}
"""Heading of each subject."""


def print_page(findings: Sequence[Finding], origin: Mapping[str, Any], *, measured: bool) -> None:
    """Print the findings on stdout, with provenance at the top and a summary at the end."""
    if sys.stdout is None:  # closed by the parent process
        return
    console = Console(highlight=False, emoji=False, markup=False)
    console.width = min(console.width, WIDEST)
    with console.capture() as page:
        _draw(console, findings, origin, measured=measured)
    text = "".join(f"{line.rstrip()}\n" for line in page.get().splitlines())
    sys.stdout.write(in_encoding(text, sys.stdout.encoding or "utf-8"))
    sys.stdout.flush()


def in_encoding(text: str, encoding: str) -> str:
    """Return a text as a terminal can show it that has no Unicode."""
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return text.translate(PLAIN).encode(encoding, "replace").decode(encoding)
    return text


def _draw(console: Console, findings: Sequence[Finding], origin: Mapping[str, Any], *, measured: bool) -> None:
    machine = origin["machine"]
    console.print(Text(f"hapticnet doctor {origin['version']}, {origin['date']}", style="bold"))
    console.print(Text(f"{machine['processor']}, {machine['system']}"))
    for subject, group in groupby(findings, lambda finding: finding.subject):
        console.print()
        console.print(Text(SUBJECTS.get(subject, subject), style="bold"))
        said: tuple[Step, ...] = ()
        for finding in group:
            _draw_finding(console, finding, () if finding.to_do == said else finding.to_do)
            said = finding.to_do or said
    _draw_summary(console, findings, measured=measured)


def _draw_finding(console: Console, finding: Finding, to_do: Sequence[Step]) -> None:
    """Print a finding, and what to do unless the finding before it has said so."""
    verdict = Text(finding.verdict.value, style=COLOURS[finding.verdict])
    row = _row((VERDICT_WIDTH, verdict), (TITLE_WIDTH, Text(finding.title)), (None, Text(finding.value)))
    console.print(Padding(row, (0, 0, 0, 2)))
    if finding.verdict is not Verdict.OK and finding.meaning:
        console.print(Padding(Text(finding.meaning), (0, 0, 0, INDENT)))
    if finding.scale:
        console.print(Padding(Text(finding.scale, style="dim"), (0, 0, 0, INDENT)))
    for step in to_do:
        console.print(Padding(_row((1, Text(">")), (None, Text(step.text))), (0, 0, 0, INDENT)))
        if step.command:  # in one piece, so that it can be copied
            console.print(Text(" " * (INDENT + 4) + step.command, style="bold"), soft_wrap=True)


def _row(*cells: tuple[int | None, Text]) -> Table:
    """Return cells of the given widths side by side; None takes what is left."""
    row = Table.grid(padding=(0, 1, 0, 0))
    for width, _ in cells:
        row.add_column(width=width, ratio=1 if width is None else None)
    row.add_row(*(text for _, text in cells))
    return row


def _draw_summary(console: Console, findings: Sequence[Finding], *, measured: bool) -> None:
    problems, warnings = (
        [finding.title for finding in findings if finding.verdict is verdict]
        for verdict in (Verdict.PROBLEM, Verdict.WARNING)
    )
    if problems:
        answer, worst = f"This machine is not ready. Solve first: {', '.join(problems)}.", Verdict.PROBLEM
    elif warnings:
        answer, worst = "This machine can run hapticnet; the warnings above say what would help.", Verdict.WARNING
    else:
        answer, worst = "This machine can run hapticnet.", Verdict.OK
    console.print()
    console.print(Rule(style="dim", characters="-"))
    console.print(Text(answer, style=COLOURS[worst]))
    if warnings:
        console.print(Text(f"Warnings: {', '.join(warnings)}."))
    counts = ", ".join(
        f"{number} {verdict.value if number == 1 else PLURALS.get(verdict, verdict.value)}"
        for verdict, number in count(findings).items()
    )
    console.print(Text(f"{counts}{'' if measured else '; nothing was measured (--quick)'}."))
