"""Read a machine without changing it: small files under a root, and programs that end in time."""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from hapticnet.errors import UnavailableError

MOST_BYTES: Final = 256 * 1024
"""Largest part of a file that is read [B]; /proc/cpuinfo of a hundred CPUs is smaller."""

SCRATCH: Final = "hapticnet-doctor-"
MEMORY_FOLDER: Final = "/dev/shm"  # noqa: S108 - a folder of our own is made in it
"""Where temporary files can be written on most machines with read-only disks."""

CONTAINER_MARKS: Final = {
    "kubepods": "kubernetes",
    "docker": "docker",
    "containerd": "containerd",
    "libpod": "podman",
    "lxc": "lxc",
}
"""Words in the names of control groups, and the kind of container they tell."""


class Ran(NamedTuple):
    """What a program printed, and its exit code; negative if a signal ended it, None if it did not end in time."""

    code: int | None
    out: str
    err: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine, or a folder that stands for one.

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

    def first_number(self, path: str) -> float | None:
        """Return the first number in a file; None if there is none."""
        try:
            return float((self.text(path) or "").split()[0])
        except (ValueError, IndexError):
            return None

    def glob(self, pattern: str) -> list[str]:
        """Return the absolute paths on this machine that match a pattern, sorted."""
        with contextlib.suppress(OSError, ValueError):
            return sorted(f"/{path.relative_to(self.root)}" for path in self.root.glob(pattern.lstrip("/")))
        return []

    def exists(self, path: str) -> bool:
        """Tell whether there is such a file or folder."""
        with contextlib.suppress(OSError, ValueError):
            return self.path(path).exists()
        return False

    def program(self, name: str) -> str | None:
        """Return the path of a program on the search path; None if it is not installed."""
        return shutil.which(name, path=self.environ.get("PATH"))

    def run(self, command: Sequence[str], within_s: float) -> Ran:
        """Run a program that changes nothing; end it and whatever it started after `within_s` [s].

        Raises
        ------
        OSError
            If it cannot be started.
        """
        process = subprocess.Popen(  # noqa: S603 - fixed commands, not through a shell
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            env={**self.environ, "LC_ALL": "C"},
            encoding="utf-8",
            errors="replace",
        )
        try:
            out, err = process.communicate(timeout=within_s)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)
            out, err = "", ""
            with contextlib.suppress(subprocess.TimeoutExpired):  # a grandchild may still hold the pipes
                out, err = process.communicate(timeout=1.0)
            return Ran(None, out, err)
        return Ran(process.returncode, out.strip(), err.strip())

    @property
    def container(self) -> str | None:
        """The kind of container this process runs in; None if there is no sign of one."""
        for path, kind in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
            if self.exists(path):
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
