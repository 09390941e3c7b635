"""``hapticnet doctor``: whether this machine is fit. Verdicts are words; colour only repeats them."""

import sys
from itertools import groupby
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Final

import typer

from hapticnet import options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hapticnet.runtime.doctor import Finding, Step

NARROWEST: Final = 40
WIDEST: Final = 100
"""Shortest and longest line: shorter ones leave no room for values, and longer ones read badly."""

INDENT: Final = 14
"""Column of titles, and of the text below them."""

COLOURS: Final = {"ok": "green", "warning": "bold yellow", "problem": "bold red"}

SUBJECTS: Final = {
    "timing": "Timer and scheduling",
    "processor": "Processor",
    "network": "Network",
    "measured": "Measured for 3 s: a slave and a master at 1 kHz on loopback",
}
"""Heading of each subject."""


def doctor(
    quick: Annotated[bool, typer.Option(help="Leave out the 3 s of measuring.")] = False,
    json: options.Json = False,
) -> None:
    """Say whether this machine can run a slave and a master, and what to do if it cannot.

    Looks at timer, scheduling, CPUs and socket buffers. Measures round trip and ticks with a slave and a master on
    loopback for 3 s.

    Changes nothing on this machine. Each finding is ok, a warning (it works, but worse than it could) or a problem (it
    will not work).

    Exit code: 0 if there is no problem, 1 if there is one, 2 if the options are wrong.
    """
    from hapticnet.cli.console import Console, deliver
    from hapticnet.runtime.doctor import Verdict, as_json, examine, examine_trial, probes

    console = Console("doctor")
    findings = list(examine(probes(), lambda subject: console.status(f"looking at {subject}")))
    if not quick:
        console.status("measuring for 3 s")
        findings += examine_trial()
    console.finish()
    if json:
        deliver(as_json(findings), as_json=True, file=None)
    elif sys.stdout is not None:  # which the parent process may have closed
        print_page(findings, measured=not quick)
    if any(finding.verdict is Verdict.PROBLEM for finding in findings):
        raise typer.Exit(1)


def print_page(findings: "Sequence[Finding]", *, measured: bool) -> None:
    """Print the findings on stdout, with version and machine at the top and a summary at the end."""
    from rich.console import Console
    from rich.text import Text

    from hapticnet.experiment.provenance import provenance

    origin = provenance()
    machine = origin["machine"]
    console = Console(highlight=False, emoji=False, markup=False)
    width = max(NARROWEST, min(console.width, WIDEST))
    head = f"hapticnet doctor {origin['version']}, {origin['date']}"
    about = f"{machine['processor']}, {machine['system']}, {machine['python']}"
    page = [Text(line, style=style) for text, style in ((head, "bold"), (about, "")) for line in wrap(text, width)]
    for subject, group in groupby(findings, lambda finding: finding.subject):
        page += [Text(), *(Text(line, style="bold") for line in wrap(SUBJECTS.get(subject, subject), width))]
        said: tuple[Step, ...] = ()
        for finding in group:
            first, *lines = wrap(f"{finding.title:<20} {finding.value}", width - INDENT, subsequent_indent=" " * 21)
            verdict = Text(f"  {finding.verdict:<{INDENT - 2}}", style=COLOURS[finding.verdict])
            page += [verdict + Text(first), *(Text(" " * INDENT + line) for line in lines)]
            for text in (finding.meaning, finding.scale):
                page += [Text(" " * INDENT + line) for line in wrap(text, width - INDENT)]
            for step in () if finding.to_do == said else finding.to_do:
                page += [Text(" " * INDENT + line) for line in wrap(f"> {step.text}", width - INDENT)]
                if step.command:  # in one piece, so that it can be copied
                    page.append(Text(" " * (INDENT + 4) + step.command, style="bold"))
            said = finding.to_do or said
    page += [Text(), Text("-" * width, style="dim")]
    page += [Text(line, style=style) for text, style in _summary(findings, measured) for line in wrap(text, width)]
    with console.capture() as captured:
        console.print(*page, sep="\n", soft_wrap=True)
    text = "".join(f"{line.rstrip()}\n" for line in captured.get().splitlines())
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "replace").decode(encoding))


def _summary(findings: "Sequence[Finding]", measured: bool) -> list[tuple[str, str]]:
    """Return the paragraphs at the end, with their styles."""
    from hapticnet.runtime.doctor import Verdict, count

    problems, warnings = (
        ", ".join(finding.title for finding in findings if finding.verdict is verdict)
        for verdict in (Verdict.PROBLEM, Verdict.WARNING)
    )
    if problems:
        answer = f"This machine is not ready. First fix: {problems}.", COLOURS["problem"]
    elif warnings:
        answer = "This machine can run hapticnet; the warnings above say what would help.", COLOURS["warning"]
    else:
        answer = "This machine can run hapticnet.", COLOURS["ok"]
    plural = {Verdict.WARNING: "warnings", Verdict.PROBLEM: "problems"}
    counts = ", ".join(
        f"{number} {verdict if number == 1 else plural.get(verdict, verdict)}"
        for verdict, number in count(findings).items()
    )
    return [
        answer,
        *([(f"Warnings: {warnings}.", "")] if warnings else []),
        (f"{counts}{'' if measured else '; nothing was measured (--quick)'}.", ""),
    ]
