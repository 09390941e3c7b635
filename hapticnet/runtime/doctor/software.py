"""Python, the packages hapticnet needs, the event loop and the extras."""

import json
import platform
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from hapticnet.compiled import describe_core
from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict
from hapticnet.runtime.doctor.machine import Machine, Ran, scratch_folder
from hapticnet.runtime.interpreter import python_command

SUBJECT: Final = "software"

OLDEST_PYTHON: Final = (3, 11)

PACKAGES: Final = {
    "cryptography": "cryptography",
    "msgpack": "msgpack",
    "numpy": "numpy",
    "pydantic": "pydantic",
    "pyserial": "serial",
    "rich": "rich",
    "tomli-w": "tomli_w",
    "typer": "typer",
}
"""Packages that hapticnet needs, and the modules they give. A test compares them with pyproject.toml."""

LOOP: Final = "uvloop"

EXTRAS: Final = {
    "fast": ("numba", "compiles codecs for long recordings"),
    "plot": ("matplotlib", "draws figures"),
    "mat": ("scipy", "reads MATLAB files"),
    "parquet": ("pyarrow", "reads and writes Parquet files"),
    "record": ("mcap", "records sessions for Foxglove and PlotJuggler"),
    "web": ("aiohttp", "serves the live page"),
    "metrics": ("prometheus-client", "serves metrics for Prometheus"),
}
"""Extras, the package each brings, and what it does."""

IMPORT_WITHIN_S: Final = 20.0

IMPORT: Final = """
import importlib, importlib.util, json, sys
from importlib.metadata import version
for pair in sys.argv[1:]:
    package, module = pair.split("=")
    said = {"package": package, "version": None, "error": None}
    print(json.dumps({"package": package, "started": True}), flush=True)
    try:
        if importlib.util.find_spec(module) is not None:
            importlib.import_module(module)
            said["version"] = version(package)
    except BaseException as error:
        said["error"] = f"{type(error).__name__}: {error}"
    print(json.dumps(said), flush=True)
"""
"""Import packages in a process of their own, which a package built for another processor may bring down."""


class Package(NamedTuple):
    """What importing a package gave: its version, or why it failed; neither if it is not installed."""

    version: str | None
    error: str | None = None


def examine_software(machine: Machine) -> list[Finding]:
    """Return the findings about Python and packages."""
    wanted = {**PACKAGES, LOOP: LOOP, **{package: package.replace("-", "_") for package, _ in EXTRAS.values()}}
    arguments = [f"{package}={module}" for package, module in wanted.items()]
    with scratch_folder() as folder:
        # Importing matplotlib writes settings and a cache into the home folder.
        trial = replace(
            machine, environ={**machine.environ, "MPLCONFIGDIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
        )
        packages = parse_imports(trial.run(python_command("-c", IMPORT, *arguments), IMPORT_WITHIN_S))
    debug = hasattr(sys, "gettotalrefcount")
    return [
        judge_python(sys.version_info[:3], platform.python_implementation(), debug=debug),
        Topic(SUBJECT, "core", "Core of hapticnet", {"core": describe_core()}).ok(describe_core()),
        judge_packages({name: packages.get(name, Package(None)) for name in PACKAGES}),
        judge_loop(packages.get(LOOP, Package(None))),
        *(judge_extra(extra, packages.get(EXTRAS[extra][0], Package(None))) for extra in EXTRAS),
    ]


def parse_imports(ran: Ran) -> dict[str, Package]:
    """Return what the importing process found; a package that brought it down gets an error."""
    packages: dict[str, Package] = {}
    started = None
    for line in ran.out.splitlines():
        try:
            said = json.loads(line)
        except ValueError:  # a package printed something
            continue
        if isinstance(said, dict) and "package" in said:
            started = said["package"]
            if "version" in said:
                packages[started] = Package(said["version"], said["error"])
                started = None
    if started is not None:
        end = f"no end after {IMPORT_WITHIN_S:g} s" if ran.code is None else f"Python ended with code {ran.code}"
        packages[started] = Package(None, end)
    return packages


def judge_python(version: tuple[int, ...], implementation: str, *, debug: bool) -> Finding:
    """Judge the Python interpreter."""
    dotted, oldest = (".".join(map(str, numbers)) for numbers in (version, OLDEST_PYTHON))
    figures = {"version": dotted, "implementation": implementation, "executable": sys.executable}
    topic = Topic(SUBJECT, "python", "Python", figures)
    value = f"{implementation} {dotted}{', debug build' if debug else ''}, {sys.executable}"
    step = Step(f"Make the environment again with CPython {oldest} or newer:", f"python{oldest} -m venv .venv")
    if version < OLDEST_PYTHON:
        return topic.find(Verdict.PROBLEM, value, "hapticnet does not run on it.", step)
    if implementation != "CPython" or debug:
        return topic.find(Verdict.WARNING, value, "hapticnet was measured on normal builds of CPython only.", step)
    return topic.ok(value)


def judge_packages(packages: Mapping[str, Package]) -> Finding:
    """Judge the packages that hapticnet cannot do without."""
    topic = Topic(SUBJECT, "packages", "Packages", {name: package.version for name, package in packages.items()})
    bad = {name: package.error or "missing" for name, package in packages.items() if package.version is None}
    if not bad:
        return topic.ok(f"all {len(packages)} can be imported")
    value = "; ".join(f"{name}: {error}" for name, error in bad.items())
    return topic.find(Verdict.PROBLEM, value, "hapticnet needs all of them.", _install(*bad, again=True))


def judge_loop(package: Package) -> Finding:
    """Judge the event loop."""
    topic = Topic(SUBJECT, "loop", "Event loop", {"uvloop": package.version, "error": package.error})
    if package.version is not None:
        return topic.ok(f"uvloop {package.version}")
    value = f"asyncio's own, because uvloop is {'broken: ' + package.error if package.error else 'missing'}"
    meaning = "Ticks are about a fifth later, and receiving costs more CPU."
    return topic.find(Verdict.WARNING, value, meaning, _install(LOOP, again=package.error is not None))


def judge_extra(extra: str, package: Package) -> Finding:
    """Judge an extra; hapticnet works without it."""
    name, purpose = EXTRAS[extra]
    figures = {"package": name, "version": package.version, "error": package.error}
    topic = Topic(SUBJECT, extra, f"Extra: {extra}", figures)
    if package.version is not None:
        return topic.ok(f"{name} {package.version}")
    if package.error is None:
        return topic.absent(f"{name}, which {purpose}", _install(name))
    value = f"{name} is installed but broken: {package.error}"
    return topic.find(Verdict.WARNING, value, f"It {purpose}; all else works without it.", _install(name, again=True))


def _install(*packages: str, again: bool = False) -> Step:
    command = [sys.executable, "-m", "pip", "install", *(["--force-reinstall"] if again else []), *packages]
    return Step("Install again:" if again else "Install:", shlex.join(command))
