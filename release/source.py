"""A commit as files, so that a release contains nothing uncommitted, and reproducible archives."""

import gzip
import io
import os
import re
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
_VERSION: Final = re.compile(r'^__version__ = "(.+)"$', re.MULTILINE)


def git(*arguments: str, folder: Path = ROOT) -> str:
    """Return what a git command prints in a checkout.

    Raises
    ------
    subprocess.CalledProcessError
        If git fails.
    """
    return subprocess.check_output(["git", "-C", str(folder), *arguments], text=True).strip()


@dataclass(frozen=True)
class Source:
    """The files of a commit in a folder."""

    folder: Path
    commit: str
    epoch_s: int
    """Time of the commit, which every artefact bears."""

    @property
    def version(self) -> str:
        """The version, from its one source."""
        return read_version(self.folder)

    def environment(self, **more: str) -> dict[str, str]:
        """Return an environment that leaves no trace of machine, folder, time zone and user in what is built."""
        fixed = {"SOURCE_DATE_EPOCH": str(self.epoch_s), "TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "0"}
        return os.environ | fixed | more


def read_version(folder: Path) -> str:
    """Return `__version__` of the checkout in a folder."""
    found = _VERSION.search((folder / "hapticnet" / "__init__.py").read_text(encoding="utf-8"))
    assert found is not None
    return found[1]


def export(folder: Path, commit: str = "HEAD") -> Source:
    """Write the files of a commit into a new folder."""
    os.umask(0o022)
    folder.mkdir(parents=True)
    archive = subprocess.check_output(["git", "-C", str(ROOT), "archive", commit])
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    return Source(folder, git("rev-parse", commit), int(git("log", "-1", "--format=%ct", commit)))


def write_tarball(path: Path, prefix: str, files: dict[str, Path], epoch_s: int) -> None:
    """Write files, by their names below `prefix`, as a .tar.gz whose bytes depend only on these."""
    with (
        path.open("wb") as raw,
        gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=epoch_s) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as tar,
    ):
        for name, file in sorted(files.items()):
            entry = tarfile.TarInfo(f"{prefix}/{name}")
            content = file.read_bytes()
            entry.size, entry.mtime = len(content), epoch_s
            entry.mode = 0o755 if file.stat().st_mode & 0o100 else 0o644
            tar.addfile(entry, io.BytesIO(content))


def files_below(folder: Path) -> dict[str, Path]:
    """Return all files in a folder, by their relative names."""
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
