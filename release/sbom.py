"""What a release consists of, with licences: a CycloneDX document of the image's lock and of the npm package."""

import json
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

from release.source import Source

PERMITTED: Final = re.compile(
    r"Apache|MIT|BSD|ISC|PSF|Python Software Foundation|MPL-2\.0|Mozilla Public License 2\.0|Zlib|0BSD|CC0|Unlicense"
)
"""Licences that may be installed beside an Apache-2.0 program without duties for its users beyond a notice."""


class UnknownLicenceError(Exception):
    """A component has no licence, or one that is not known to be permitted."""


def describe(source: Source, wheels: list[Path], folder: Path) -> dict[str, Any]:
    """Return the CycloneDX document of what the image installs, from an environment that is made in `folder`.

    Raises
    ------
    UnknownLicenceError
        If a component has no permitted licence.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps"]
    lock = source.folder / "docker" / "locks" / "service.txt"
    subprocess.run([*install, "--require-hashes", "-r", str(lock)], check=True)
    subprocess.run([*install, *map(str, wheels)], check=True)
    written = subprocess.check_output(
        [sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible", "--short-PURLs", str(python)],
        env=source.environment(),
    )
    document: dict[str, Any] = json.loads(written)
    parts = document["components"]
    for part in parts:  # those that were installed from a file have none
        part.setdefault("purl", f"pkg:pypi/{part['name']}@{part['version']}")
    (own,) = [part for part in parts if part["name"] == "hapticnet"]
    parts += bundled(source.folder / "peers" / "js")
    document["metadata"]["component"] = own
    document["components"] = [part for part in parts if part is not own]
    _remove_paths(document)
    audit(document["components"])
    return document


def bundled(package: Path) -> list[dict[str, Any]]:
    """Return the components that the npm package contains, from its lock file."""
    installed = json.loads((package / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    return [
        {
            "bom-ref": f"{path}=={about['version']}",
            "group": path.split("/")[-2],
            "licenses": [{"license": {"id": about["license"]}}],
            "name": path.split("/")[-1],
            "purl": f"pkg:npm/{path.removeprefix('node_modules/').replace('@', '%40')}@{about['version']}",
            "type": "library",
            "version": about["version"],
        }
        for path, about in sorted(installed.items())
        if path.startswith("node_modules/@noble/")
    ]


def licence(part: dict[str, Any]) -> str:
    """Return what a component says of its licence."""
    said = part.get("licenses", [])
    names = {each.get("expression") or each["license"].get("id") or each["license"]["name"] for each in said}
    return " and ".join(sorted(names))


def audit(parts: list[dict[str, Any]]) -> None:
    """Print the components by licence; raise UnknownLicenceError if one has no permitted licence."""
    by_licence = defaultdict(list)
    for part in parts:
        by_licence[licence(part)].append(part["name"])
    for name, components in sorted(by_licence.items()):
        print(f"{name or 'NO LICENCE'}: {', '.join(sorted(components))}")
    unknown = [each for name, components in by_licence.items() if not PERMITTED.search(name) for each in components]
    if unknown:
        names = ", ".join(sorted(unknown))
        raise UnknownLicenceError(f"no permitted licence: {names}; look at them, and add what they have to PERMITTED")


def _remove_paths(document: dict[str, Any]) -> None:
    """Remove paths of the machine that built the files."""
    for part in [document["metadata"]["component"], *document["components"]]:
        part["externalReferences"] = [
            each for each in part.get("externalReferences", []) if not each["url"].startswith("file:")
        ]
