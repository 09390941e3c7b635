"""Check that dist/ is what the tagged commit gives, then print the commands that publish it, or run them.

`make publish` only checks and prints. `make publish FOR_REAL=1 IMAGE=REGISTRY/NAME` runs the commands; it needs the
owner's accounts of PyPI, npm and the image's registry.
"""

import argparse
import hashlib
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

from release.build import BINDINGS, sdists
from release.source import ROOT, git, read_version


def main() -> None:
    """Check, and print or run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder that make release wrote")
    parser.add_argument("--image", default="", metavar="REGISTRY/NAME", help="where to push the image")
    parser.add_argument("--for-real", action="store_true", help="run the commands")
    options = parser.parse_args()
    wrong = problems(ROOT, options.out)
    for each in wrong:
        print("wrong:", each)
    if options.for_real and not options.image:
        wrong.append("no image")
        print("wrong: IMAGE=REGISTRY/NAME says where the image goes")
    for command in commands(read_version(ROOT), options.out, options.image or "REGISTRY/NAME"):
        print("would run:" if wrong or not options.for_real else "running:", shlex.join(command), flush=True)
        if options.for_real and not wrong:
            try:
                subprocess.run(command, check=True, cwd=ROOT)
            except (OSError, subprocess.CalledProcessError) as error:
                wrong.append(str(error))  # so the others are only printed
                print("wrong:", error)
    sys.exit(bool(wrong))


def problems(root: Path, out: Path) -> list[str]:
    """Return reasons not to publish `out` from a checkout."""
    version = read_version(root)
    head = git("rev-parse", "HEAD", folder=root)
    found = []
    if git("status", "--porcelain", folder=root):
        found.append("files here differ from the newest commit; commit them or remove them")
    if f"v{version}" not in git("tag", "--points-at", "HEAD", folder=root).split():
        found.append(f"the newest commit has no tag v{version}; git tag -s v{version}")
    if not re.search(rf"^## {re.escape(version)} \(\d{{4}}-\d\d-\d\d\)$", (root / "CHANGELOG.md").read_text(), re.M):
        found.append(f"CHANGELOG.md has no date for {version}; write ## {version} (YYYY-MM-DD)")
    for name, check in (("SHA256SUMS", altered), ("origin.json", other_commit)):
        try:
            found += [f"{each}; make release" for each in check(out, head)]
        except FileNotFoundError:
            found.append(f"{out} has no {name}; make release")
        except (OSError, ValueError, LookupError, TypeError):
            found.append(f"{out}/{name} is damaged; make release")
    found += [f"{out} has no {pattern}; make release" for pattern in expected(version) if not any(out.glob(pattern))]
    return found


def altered(out: Path, _: str) -> list[str]:
    """Return what SHA256SUMS lacks, lists with another digest, or lists although it is missing."""
    lines = (out / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    listed = {name: digest for digest, name in (line.split("  ") for line in lines)}
    there = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "a folder"
        for path in out.iterdir()
        if path.name != "SHA256SUMS"
    }
    names = sorted(name for name in listed | there if listed.get(name) != there.get(name))
    return [f"{name} differs from SHA256SUMS" for name in names]


def other_commit(out: Path, head: str) -> list[str]:
    """Return that a release was built from another commit than `head`, if it was."""
    commit = str(json.loads((out / "origin.json").read_text(encoding="utf-8"))["commit"])
    return [] if commit == head else [f"{out} was built from {commit[:8]}, the newest commit is {head[:8]}"]


def expected(version: str) -> list[str]:
    """Return patterns of the files of a complete release."""
    return [
        f"hapticnet-{version}.tar.gz",
        f"hapticnet-{version}-py3-none-any.whl",
        f"hapticnet-{version}-*manylinux*.whl",
        f"hapticnet-{version}.tgz",
        f"hapticnet-{version}.cdx.json",
        *(f"hapticnet-{name}-{version}.tar.gz" for name in ("c", *BINDINGS)),
        f"hapticnet-site-{version}.tar.gz",
    ]


def commands(version: str, out: Path, image: str) -> list[list[str]]:
    """Return the commands that publish a release."""
    python = sorted(map(str, out.glob("*.whl"))) + [str(out / f"{name}.tar.gz") for name in sdists(out)]
    return [
        ["git", "push", "origin", f"v{version}"],
        [sys.executable, "-m", "twine", "upload", *python],
        ["npm", "publish", str(out / f"hapticnet-{version}.tgz")],
        ["docker", "build", "-f", "docker/Dockerfile", "-t", f"{image}:{version}", "."],
        ["docker", "push", f"{image}:{version}"],
    ]


if __name__ == "__main__":
    main()
