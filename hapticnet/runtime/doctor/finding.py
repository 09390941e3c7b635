"""What the doctor reports, and how it reads a machine: findings, each with a value, a verdict and what to do."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

from hapticnet.errors import UnavailableError

SCHEMA: Final = 2
"""Version of the JSON report. It grows when a key or a verdict changes its meaning or goes away."""

MOST_BYTES: Final = 256 * 1024
"""Largest part of a file that is read [B]; /proc/cpuinfo of a hundred CPUs is smaller."""

SCRATCH: Final = "hapticnet-doctor-"
MEMORY_FOLDER: Final = "/dev/shm"  # noqa: S108 - a folder of our own is made in it
"""Where temporary files can be written on most machines with read-only disks."""

CONTAINER_MARKS: Final = {
    "kubepods": "kubernetes", "docker": "docker", "containerd": "containerd", "libpod": "podman", "lxc": "lxc",
}  # fmt: skip
"""Words in the names of control groups, and the kind of container they tell."""


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
    id
        Subject and name, such as ``timing.timer``.
    title
        The same for a person.
    verdict
        How good it is.
    value
        What was found.
    meaning
        What follows from it; empty if nothing does.
    to_do
        What to do about it, the best remedy first.
    scale
        What counts as good and as acceptable; empty if that is obvious.
    """

    id: str
    title: str
    verdict: Verdict
    value: str
    meaning: str = ""
    to_do: tuple[Step, ...] = ()
    scale: str = ""

    @property
    def subject(self) -> str:
        """The group of findings to which it belongs."""
        return self.id.partition(".")[0]


def count(findings: Iterable[Finding]) -> dict[Verdict, int]:
    """Return the number of findings of each verdict."""
    verdicts = [finding.verdict for finding in findings]
    return {verdict: verdicts.count(verdict) for verdict in Verdict}


def as_json(findings: Iterable[Finding]) -> dict[str, Any]:
    """Return all findings as a report for JSON; the keys of a finding are always the same."""
    findings = list(findings)
    counts = count(findings)
    return {
        "schema": SCHEMA,
        "ready": not counts[Verdict.PROBLEM],
        "counts": {verdict.value: number for verdict, number in counts.items()},
        "findings": [
            {
                **finding._asdict(),
                "verdict": finding.verdict.value,
                "to_do": [{"text": step.text, "command": step.command or None} for step in finding.to_do],
            }
            for finding in findings
        ],
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine, or a folder that stands for one. Nothing on it is changed.

    Attributes
    ----------
    root
        Folder that holds ``proc``, ``sys``, ``dev``, ``etc`` and so on.
    environ
        Environment variables.
    access
        Tells whether this process may read and write a file: `os.access`.
    """

    root: Path = Path("/")
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    access: Callable[[Path, int], bool] = os.access

    def path(self, path: str) -> Path:
        """Return where an absolute path is on this machine."""
        return self.root / path.lstrip("/")

    def text(self, path: str) -> str | None:
        """Return the stripped text of a file; None if it cannot be read."""
        try:
            with self.path(path).open("rb") as file:
                return file.read(MOST_BYTES).decode("utf-8", "replace").strip()
        except (OSError, ValueError):
            return None

    def number(self, path: str) -> int | None:
        """Return the whole number in a file; None if there is none."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def glob(self, pattern: str) -> list[str]:
        """Return the absolute paths on this machine that match a pattern, sorted."""
        with contextlib.suppress(OSError, ValueError):
            return sorted(f"/{path.relative_to(self.root)}" for path in self.root.glob(pattern.lstrip("/")))
        return []

    @property
    def container(self) -> str | None:
        """The kind of container this process runs in; None if there is no sign of one."""
        for path, kind in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
            if self.path(path).exists():
                return kind
        if self.environ.get("container"):
            return self.environ["container"]
        groups = self.text("/proc/self/cgroup") or ""
        return next((kind for mark, kind in CONTAINER_MARKS.items() if mark in groups), None)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a folder that is removed at the end, even where the usual ones cannot be written.

    Raises
    ------
    UnavailableError
        If no folder can be written.
    """
    try:
        folder = tempfile.TemporaryDirectory(prefix=SCRATCH)
    except OSError:
        try:
            folder = tempfile.TemporaryDirectory(prefix=SCRATCH, dir=MEMORY_FOLDER)
        except OSError:
            raise UnavailableError(
                "no temporary folder can be written; name one: TMPDIR=FOLDER hapticnet doctor"
            ) from None
    with folder as path:
        yield Path(path)
