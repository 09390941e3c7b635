"""Run the benchmarks, each once, and write pages from their results: ``make bench``, in three quarters of an hour.

::

    python bench/run.py                     run all, then write docs/benchmarks
    python bench/run.py --quick             run all with few repetitions, and publish nothing: five minutes
    python bench/run.py --only repair felt  run these alone; the pages need all, of one revision

Benchmarks that do not measure time run first, one per CPU. A benchmark of time runs alone, because it is
only worth publishing from a quiet machine. Most of these measure the core compiled ahead of time. Before each, this
program waits until others use less than `BUSY` of a core, for `PATIENCE_S` at most; a record says how much they used
while it ran, and bench/report/pages.py refuses one that was disturbed.
"""

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

REPOSITORY: Final = Path(__file__).parents[1]
sys.path += [str(REPOSITORY / "bench" / each) for each in ("measure", "report")]

from plan import BENCHMARKS, Benchmark  # noqa: E402 - scripts find their neighbours only with this path
from record import cpu_of_others_s  # noqa: E402

RESULTS: Final = REPOSITORY / "results" / "bench"
BUSY: Final = 0.1
"""Cores that other programs may use while time is measured."""

PATIENCE_S: Final = 60.0


def busy_cores(seconds: float = 1.0) -> float:
    """Return how many cores other programs use now."""
    before = cpu_of_others_s()
    time.sleep(seconds)
    return (cpu_of_others_s() - before) / seconds


def main() -> int:
    """Run the requested benchmarks one after the other, and write the pages if these are all."""
    names = [each.name for each in BENCHMARKS]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="few repetitions, to try every benchmark; publish nothing")
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--recordings", nargs="*", default=[], metavar="FILE", help="FILE[:FORCE[:POSITION[:SCALE]]]")
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help="where the records go")
    arguments = parser.parse_args()
    began = time.monotonic()
    chosen = [each for each in BENCHMARKS if each.name in (arguments.only or names)]
    compiled = False
    untimed = [each for each in chosen if not each.timed]
    # The fingerprint of quick runs is published, so that a test can tell when it changes.
    runs = [(each, True) for each in untimed] + [(each, False) for each in untimed if not arguments.quick]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        failed = [name for name in pool.map(lambda run: _run(run[0], arguments, quick=run[1]), runs) if name]
    timed = [each for each in chosen if each.timed]
    for each in sorted(timed, key=lambda each: each.timed == "compiled"):
        if each.as_root and os.geteuid() != 0:
            print(f"{each.name}: left out, it needs root", flush=True)
            continue
        if not arguments.quick:
            if each.timed == "compiled" and not compiled:
                compiled = _build()
            _wait_until_quiet(each.name)
        failed += filter(None, [_run(each, arguments, quick=arguments.quick)])
    if compiled:
        _build("--clean")
    print(f"in all: {(time.monotonic() - began) / 60.0:.1f} minutes", flush=True)
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
        return 1
    if arguments.quick or arguments.only:
        return 0
    command = [sys.executable, REPOSITORY / "bench" / "report" / "pages.py", arguments.results]
    return subprocess.run(command, check=False).returncode


def _build(*options: str) -> bool:
    """Compile the core in place, or remove that again; return whether this succeeded."""
    command = [sys.executable, REPOSITORY / "hatch_build.py", *options]
    return subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 0


def _run(benchmark: Benchmark, arguments: argparse.Namespace, *, quick: bool) -> str:
    """Run a benchmark; return its name if it failed."""
    script = REPOSITORY / "bench" / "measure" / f"{benchmark.name}.py"
    options = (benchmark.quick if quick else benchmark.full).split()
    recordings = arguments.recordings if benchmark.takes_recordings and not quick else []
    folder = arguments.results / "quick" if quick else arguments.results
    file = folder / f"{benchmark.name}.json"
    began = time.monotonic()
    code = subprocess.run([sys.executable, script, *recordings, *options, "--json", file], check=False).returncode
    name = f"{benchmark.name}{' (quick)' if quick else ''}"
    print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)
    return name if code else ""


def _wait_until_quiet(name: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while (busy := busy_cores()) > BUSY:
        if time.monotonic() > deadline:
            print(f"{name}: other programs use {busy:.1f} cores; its record will not be published", flush=True)
            return


if __name__ == "__main__":
    sys.exit(main())
