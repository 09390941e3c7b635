"""Clean Debian systems, without compiler and network, to install in what is published. Needs root and mmdebstrap."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

from release.source import ROOT

PYTHON_OF: Final = {"bookworm": "3.11", "trixie": "3.13"}
"""The releases of Debian that are tried, and their Python."""

BASES: Final = ROOT / "build" / "bases"
_GLIBC_MINORS: Final = range(17, 37)  # bookworm has 2.36

_ENTER: Final = """
mount -t tmpfs tmpfs "$1"
mkdir "$1/upper" "$1/work" "$1/root"
mount -t overlay overlay -o "lowerdir=$2,upperdir=$1/upper,workdir=$1/work" "$1/root"
mkdir "$1/root/wheels"
mount --bind "$3" "$1/root/wheels"
mount -t proc proc "$1/root/proc"
mount -t tmpfs tmpfs "$1/root/dev/shm"
ip link set lo up
exec env -i PATH=/usr/bin:/usr/sbin HOME=/tmp LC_ALL=C.UTF-8 \\
    chroot --userspec=65534:65534 "$1/root" sh -eu -c "cd /tmp; $4"
"""
"""Within namespaces of mounts, processes and network: nothing that the script writes or leaves running survives it."""


def missing_tools() -> list[str]:
    """Return what is missing to make a clean system."""
    return [name for name in ("mmdebstrap", "unshare", "ip", "apt-get") if shutil.which(name) is None]


def make_base(release: str) -> Path:
    """Return a minimal Debian with Python and venv, from the mirror that apt uses here; it is kept in build/bases."""
    base = BASES / release
    if not base.exists():
        started = BASES / f"{release}.part"
        shutil.rmtree(started, ignore_errors=True)
        BASES.mkdir(parents=True, exist_ok=True)
        fields = "$(CREATED_BY) $(ORIGIN) $(COMPONENT) $(REPO_URI)"
        listed = subprocess.check_output(["apt-get", "indextargets", "--format", fields], text=True).splitlines()
        mirror = next(line.split()[3] for line in listed if line.startswith("Packages Debian main "))
        options = ["--quiet", "--variant=minbase", "--include=python3,python3-venv"]
        subprocess.run(["mmdebstrap", *options, release, started, mirror], check=True)
        started.rename(base)
    return base


def download_wheels(names: list[str], python: str, folder: Path) -> None:
    """Download what packages need on a Python, for a system of this kind that has no compiler."""
    tags = [f"--platform=manylinux_2_{minor}_x86_64" for minor in _GLIBC_MINORS] + ["--platform=manylinux2014_x86_64"]
    abis = [f"--abi={abi}" for abi in ("cp" + python.replace(".", ""), "abi3", "none")]
    command = [sys.executable, "-m", "pip", "download", "-q", "-d", str(folder), "--find-links", str(folder)]
    options = ["--only-binary=:all:", f"--python-version={python}", "--implementation=cp", *abis, *tags]
    subprocess.run([*command, *options, *names], check=True)


def run_inside(release: str, wheels: Path, script: str, scratch: Path) -> str:
    """Return what a shell script prints in a clean system without a network, where the folder `wheels` is /wheels.

    It runs as nobody, on a copy that is gone afterwards. `scratch` is an empty folder.

    Raises
    ------
    RuntimeError
        With the end of what was printed, if a command of the script fails.
    """
    enter = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "sh", "-eu", "-c", _ENTER, "enter"]
    done = subprocess.run(
        [*enter, scratch, make_base(release), wheels, script], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"on {release}: {done.stdout[-4000:]}{done.stderr[-4000:]}")
    return done.stdout
