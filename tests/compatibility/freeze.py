"""What version 0.2 promises, as small files in frozen/ that later versions are held to (docs/refer/compatibility.md).

    python -m tests.compatibility.freeze wire | names | recordings

writes them. `wire`: for another version of the wire, or when vectors were appended. `names`: when names, parameters or
options were added, or for 0.3. `recordings`: once for each minor version; those of earlier ones stay.
"""

import hashlib
import inspect
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import typer.main

import hapticnet as hn
from hapticnet.cli import app
from hapticnet.device.messages import PROTOCOL_MAJOR
from hapticnet.protocol.wire import OPEN, SEALED
from hapticnet.recordings.session.export import export
from hapticnet.recordings.session.reading import read_session

FROZEN: Final = Path(__file__).with_name("frozen")
VECTORS: Final = Path(__file__).parents[1] / "vectors"
VERSIONS: Final = {"open": OPEN, "sealed": SEALED, "device": PROTOCOL_MAJOR}
FOR_PEOPLE: Final = ("note", "why")
PLAIN: Final = (bool, int, float, str, type(None))


def digest(value: Any) -> str:
    """Return a digest of what a file of vectors says to programs."""
    if isinstance(value, dict):
        value = {key: each for key, each in value.items() if key not in FOR_PEOPLE}
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def wire(folder: Path = VECTORS) -> dict[str, list[str]]:
    """Return the digests of all vectors, by file and list."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        for name, value in json.loads(path.read_text()).items():
            if name not in FOR_PEOPLE:
                found[f"{path.stem} {name}"] = [
                    digest(each) for each in (value if isinstance(value, list) else [value])
                ]
    return found


def broken_vectors(frozen: dict[str, Any], now: dict[str, list[str]]) -> list[str]:
    """Return the vectors of a frozen list that have changed or are gone; more may have been appended."""
    return [
        f"{name}, number {i + 1}"
        for name, digests in frozen["vectors"].items()
        for i, each in enumerate(digests)
        if now.get(name, [])[i : i + 1] != [each]
    ]


def _signature(call: Any) -> str:
    """Return names and defaults of parameters; of a default that is no plain value, only that there is one."""
    shown = []
    for each in inspect.signature(call).parameters.values():
        is_plain = type(each.default) in PLAIN or each.default in ((), inspect.Parameter.empty)
        shown.append(each.replace(annotation=inspect.Parameter.empty, default=each.default if is_plain else ...))
    return str(inspect.Signature(shown)).replace("Ellipsis", "…")


def api() -> list[str]:
    """Return a line for each public name, parameter list and member of `import hapticnet`."""
    return sorted(line for name in hn.__all__ if name != "__version__" for line in _lines(name, getattr(hn, name)))


def _lines(name: str, value: Any) -> Iterator[str]:
    if not inspect.isclass(value):
        yield f"{name}{_signature(value)}" if callable(value) else f"{name}: {type(value).__name__}"
        return
    bases = [base.__name__ for base in value.__mro__[1:] if base.__name__ in hn.__all__]
    builtin = {member for base in value.__mro__ if base.__module__ == "builtins" for member in dir(base)}
    made = "" if issubclass(value, BaseException) else _signature(value)
    yield f"class {name}{made}{''.join(f' is a {base}' for base in bases)}"
    annotated = {key for base in value.__mro__ for key in inspect.get_annotations(base)}
    for member in sorted({*dir(value), *annotated}):
        if member.startswith("_") or member in builtin:
            continue
        found = inspect.getattr_static(value, member, None)
        yield f"{name}.{member}{_signature(found) if inspect.isfunction(found) else ''}"


def command_line() -> list[str]:
    """Return a line for each verb, argument and option of the command line."""
    return sorted(_options("hapticnet", typer.main.get_command(app)))


def _options(name: str, command: Any) -> Iterator[str]:
    for parameter in command.params:
        kind = "" if parameter.param_type_name == "option" else "argument "
        yield f"{name} {kind}{' '.join(sorted([*parameter.opts, *parameter.secondary_opts]))}"
    for verb, each in getattr(command, "commands", {}).items():
        yield f"{name} {verb}"
        yield from _options(f"{name} {verb}", each)


class Inward:
    """A hand that goes 35 mm into the tissue within a tenth of a second."""

    axes, duration_us = 1, 100_000

    def sample(self, t_us: int) -> float:
        return 3.5e-7 * t_us


MAIN_FILES: Final = [f"{side}.{suffix}" for side in ("master", "slave") for suffix in ("mcap", "npz", "csv")]


def record(folder: Path) -> None:
    """Record a session of a tenth of a second at both ends over UDP, in all formats, into a folder."""
    command = [sys.executable, "-m", "hapticnet"]
    with tempfile.TemporaryDirectory() as name:
        listen = [
            "slave",
            "--scene",
            "paper:1",
            "--listen",
            "127.0.0.1:47999",
            "--record-dir",
            name,
            "--record-format",
            "mcap",
        ]
        with subprocess.Popen([*command, *listen], stderr=subprocess.PIPE, text=True) as slave:
            next(line for line in slave.stderr or () if "listening" in line)
            hand = [
                "--operator",
                "tests/compatibility/freeze.py:Inward",
                "--record",
                f"{name}/master.mcap",
                "--name",
                "recorder",
            ]
            subprocess.run([*command, "master", "--connect", "127.0.0.1:47999", *hand], check=True)
            slave.terminate()
        folder.mkdir(parents=True)
        for side, path in (("master", Path(name, "master.mcap")), ("slave", next(Path(name).glob("recorder*.mcap")))):
            session = read_session(path)
            about = {**session.about, "provenance": {"version": hn.__version__}}  # not on which machine
            for suffix in ("mcap", "npz", "csv"):
                export(replace(session, about=about), folder / f"{side}.{suffix}")
    (folder / "expected.json").write_text(json.dumps({name: summary(folder / name) for name in MAIN_FILES}, indent=1))


def summary(path: Path) -> dict[str, Any]:
    """Return what a recording must read as: its side, and digests of its tables, events and report."""
    session = read_session(path)
    tables = {
        name: digest({column: np.asarray(values, float).tobytes().hex() for column, values in table.items()})
        for name, table in session.tables.items()
    }
    forces = hn.load_recording(path).force
    return {
        "side": session.side,
        "complete": session.complete,
        "rows": len(forces),
        "largest_n": float(np.abs(forces).max()),
        "tables": tables,
        "events": digest([list(event) for event in session.events]),
        "about": digest(session.about),
    }


def main(what: str) -> None:
    """Write one kind of frozen files."""
    if what == "recordings":
        record(FROZEN / ".".join(hn.__version__.split(".")[:2]))
    elif what == "names":
        (FROZEN / "python.txt").write_text("\n".join(api()) + "\n")
        (FROZEN / "command_line.txt").write_text("\n".join(command_line()) + "\n")
    else:
        (FROZEN / "wire.json").write_text(
            json.dumps({"versions": VERSIONS, "vectors": wire()}).replace('], "', '],\n"')
        )


if __name__ == "__main__":
    main(sys.argv[1])
