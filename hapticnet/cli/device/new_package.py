"""``hapticnet device new``: a package for a device of one's own."""

import keyword
import re
import sys
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Annotated, Final

import typer

NAME: Final = re.compile(r"[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*")
FILES: Final = {
    "pyproject.toml": "pyproject.toml",
    "README.md": "README.md",
    "device.py": "{package}/__init__.py",
    "test_device.py": "tests/test_{package}.py",
}
"""Where each template goes in the package."""

TAKEN: Final = {*keyword.kwlist, *sys.stdlib_module_names, "conftest", "hapticnet", "numpy", "pytest", "tests"}
"""Names that cannot be imported as a package, or would hide a module that the package or its tests need."""


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its name: lower-case letters, digits and dashes.")],
    folder: Annotated[Path, typer.Option("--out-dir", metavar="DIR", help="Where to make its folder.")] = Path(),
) -> None:
    """Write a small package for a device of yours: a class, tests that pass, and a safety checklist.

    Once it is installed, 'hapticnet master --device NAME' drives it. Existing files are never overwritten.
    """
    from hapticnet.cli.console import show
    from hapticnet.errors import FileError, SettingsError
    from hapticnet.runtime.devices import BUILT_IN

    if not NAME.fullmatch(name) or name in BUILT_IN:
        raise SettingsError(
            f"name {name!r}: use lower-case letters, digits and dashes, as in my-motor, and none of"
            f" {', '.join(BUILT_IN)}"
        )
    package = name.replace("-", "_")
    if package in TAKEN:
        raise SettingsError(f"name {name!r} is taken by Python or a package in use; choose another, as in my-{name}")
    values = {"name": name, "package": package, "cls": "".join(map(str.capitalize, package.split("_")))}
    root = folder / name
    try:
        root.mkdir(parents=True)
        for template, place in FILES.items():
            text = (files("hapticnet.cli.device") / "template" / f"{template}.in").read_text(encoding="utf-8")
            path = root / place.format(package=package)
            path.parent.mkdir(exist_ok=True)
            path.write_text(Template(text).substitute(values), encoding="utf-8")
            show(f"wrote {path}")
    except OSError as error:
        raise FileError(f"{error.filename or root}: {error.strerror}; nothing is overwritten") from error
    steps = f"pip install pytest -e {root}; python -m pytest {root}; hapticnet master --device {name}"
    show(f"next: {steps}; then read {root}/README.md")
