"""What the doctor reports: findings, each with a value, a verdict and what to do."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeAlias

SCHEMA: Final = 1
"""Version of the JSON report. It grows when a key or a verdict changes its meaning or goes away."""

Figures: TypeAlias = Mapping[str, str | int | float | bool | None]


class Verdict(StrEnum):
    """How good a finding is."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"
    ABSENT = "not present"


class Step(NamedTuple):
    """Something to do: a sentence, and the exact command if there is one."""

    text: str
    command: str = ""


class Finding(NamedTuple):
    """One thing about this machine.

    Attributes
    ----------
    topic
        What it is about.
    verdict
        How good it is.
    value
        What was found, for a person.
    meaning
        What follows from it; empty if nothing does.
    scale
        What counts as good and as acceptable; empty if that is obvious.
    to_do
        What to do about it, the best remedy first.
    """

    topic: "Topic"
    verdict: Verdict
    value: str
    meaning: str
    scale: str
    to_do: tuple[Step, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the finding for JSON; the keys are always the same."""
        return {
            "id": f"{self.topic.subject}.{self.topic.name}",
            "subject": self.topic.subject,
            "title": self.topic.title,
            "verdict": self.verdict.value,
            "value": self.value,
            "meaning": self.meaning,
            "scale": self.scale,
            "to_do": [{"text": step.text, "command": step.command or None} for step in self.to_do],
            "figures": dict(self.topic.figures),
        }


class Topic(NamedTuple):
    """What a finding is about.

    Attributes
    ----------
    subject
        Group of findings, such as ``timing``.
    name
        Identifies the finding within its subject.
    title
        The same for a person.
    figures
        What was found, for programs; units are in the names.
    """

    subject: str
    name: str
    title: str
    figures: Figures

    def find(self, verdict: Verdict, value: str, meaning: str = "", *to_do: Step, scale: str = "") -> Finding:
        """Return a finding on this topic."""
        return Finding(self, verdict, value, meaning, scale, to_do)

    def ok(self, value: str, *, scale: str = "") -> Finding:
        """Return a finding that needs no action."""
        return self.find(Verdict.OK, value, scale=scale)

    def absent(self, value: str, *to_do: Step) -> Finding:
        """Return the finding that something is not present, and is missed for one use only."""
        return self.find(Verdict.ABSENT, value, "", *to_do)


def count(findings: Iterable[Finding]) -> dict[Verdict, int]:
    """Return the number of findings of each verdict."""
    verdicts = [finding.verdict for finding in findings]
    return {verdict: verdicts.count(verdict) for verdict in Verdict}


def as_json(findings: Iterable[Finding]) -> dict[str, Any]:
    """Return all findings as a report for JSON."""
    findings = list(findings)
    counts = count(findings)
    return {
        "schema": SCHEMA,
        "ready": not counts[Verdict.PROBLEM],
        "counts": {verdict.value: number for verdict, number in counts.items()},
        "findings": [finding.as_json() for finding in findings],
    }


def grade(value: float, good: float, acceptable: float) -> Verdict:
    """Return the verdict on a value of which less is better."""
    if value <= good:
        return Verdict.OK
    return Verdict.WARNING if value <= acceptable else Verdict.PROBLEM


def duration(seconds: float) -> str:
    """Return a duration [s] with three digits and its best unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if abs(seconds) >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def size(amount: float) -> str:
    """Return an amount of bytes with three digits and its best unit."""
    for unit, factor in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if amount >= factor:
            return f"{amount / factor:.3g} {unit}"
    return f"{amount:g} B"
