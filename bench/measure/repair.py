"""What loss does to the applied force with no repair, with replacement after a round trip, and with all of repair.

Losses follow a Gilbert-Elliott chain, the same in both directions. In the emulator the chain takes one step for
each datagram, so that on sparse feedback a burst of five takes five updates, however far apart; the rows whose clock is
"ms" let it step once a millisecond instead, as bursts of a network do.
"""

import argparse
import itertools
import multiprocessing
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import record
from repair_link import WAYS, Case, Signal, run

SCENE: Final = "paper's scene"
COMPARED: Final = ("no repair", "replace", "all")
LOSSES: Final = (0.05, 0.1, 0.3)
BURSTS: Final = (1.0, 5.0)
DELAYS_US: Final = (20_000, 100_000)
RELEASE_S: Final = 600.0
WORKERS: Final = 2

Row = dict[str, Any]


def cases(seeds: Sequence[int], seconds: float, *, quick: bool) -> list[Case]:
    """Return every case of the grids; every lossy one has a lossless one of the same signal, codec and delay."""
    scene = Case(signal=SCENE, repair="all", seconds=seconds)
    losses, bursts, delays = (LOSSES[1:2], (5.0,), (0, 100_000)) if quick else (LOSSES, BURSTS, DELAYS_US)
    chosen: list[Case] = []

    def add(base: Case, ways: Sequence[str] = COMPARED, **lists: Sequence[Any]) -> None:
        for values in itertools.product(*lists.values()):
            chosen.extend(replace(base, repair=way, **dict(zip(lists, values, strict=True))) for way in ways)

    add(scene, ("no repair",), delay_us=delays)
    add(scene, loss=losses, burst=bursts, delay_us=delays)
    add(replace(scene, clock="ms", burst=5.0), loss=losses, delay_us=delays)
    return [replace(case, seed=seed) for case in dict.fromkeys(chosen) for seed in seeds]


def release_cases(seed: int, seconds: float, *, quick: bool) -> list[Case]:
    """Return the cases that count how often losses make the master release the force."""
    scene = Case(signal=SCENE, repair="all", loss=0.3, seconds=seconds, seed=seed)
    links = [(5.0, delay_us, 0) for delay_us in DELAYS_US] + [(2.0, 100_000, 0), (1.0, 100_000, 0), (5.0, 50_000, 5000)]
    return [
        replace(scene, burst=burst, delay_us=delay_us, jitter_us=jitter_us)
        for burst, delay_us, jitter_us in (links[-1:] if quick else links)
    ]


def measured(case: Case) -> Row:
    """Run a case in a worker."""
    return run(Signal(case.signal), case)


KEY: Final = ("signal", "codec", "repair", "loss", "burst", "clock", "delay_us", "jitter_us")


def averaged(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each case, averaged over the seeds."""
    blocks: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        blocks.setdefault(tuple(row[key] for key in KEY), []).append(row)
    made = []
    for key, block in blocks.items():
        means: Row = dict(zip(KEY, key, strict=True)) | {"seconds": sum(row["seconds"] for row in block)}
        for figure in block[0].keys() - means.keys() - {"seed"}:
            values = [row[figure] for row in block if row[figure] is not None]
            summed = figure in ("releases", "stale", "lost_updates")
            means[figure] = (sum(values) if summed else sum(values) / len(values)) if values else None
        made.append(means)
    return made


def compared(rows: Sequence[Row]) -> list[Row]:
    """Add to each row its exceedance and bytes relative to the same link without loss."""
    without = {
        (row["signal"], row["codec"], row["delay_us"]): row for row in rows if not row["loss"] and not row["jitter_us"]
    }
    done = []
    for row in rows:
        base = without[row["signal"], row["codec"], row["delay_us"]]
        ratios = {"exceed_over_delay": row["exceed"] / base["exceed"] if base["exceed"] else None}
        feedback = row["feedback_bytes_per_s"] - base["feedback_bytes_per_s"]
        both = feedback + row["forward_bytes_per_s"] - base["forward_bytes_per_s"]
        ratios["more_feedback_bytes"] = feedback / base["feedback_bytes_per_s"]
        ratios["more_bytes"] = both / (base["feedback_bytes_per_s"] + base["forward_bytes_per_s"])
        done.append(row | ratios)
    return done


def show(rows: Sequence[Row]) -> None:
    """Print the rows as a table."""
    print(
        f"{'signal':13} {'codec':11} {'repair':15} loss burst           delay jitter  exceed  /delay by loss"
        "    bytes feedback  recovery p50/p99"
    )
    for row in rows:
        over = "-" if row["exceed_over_delay"] is None else f"{row['exceed_over_delay']:.2f}"
        recovery = "-"
        if row["recovery_p99_ms"] is not None:
            recovery = f"{row['recovery_median_ms']:.0f}/{row['recovery_p99_ms']:.0f} ms"
        print(
            f"{row['signal'][:13]:13} {row['codec'][:11]:11} {row['repair']:15} {row['loss']:4.0%} {row['burst']:3.0f}"
            f" {row['clock']:9} {row['delay_us'] // 1000:4d} ms {row['jitter_us'] // 1000:3d} ms {row['exceed']:7.1%}"
            f"  {over:>6} {row['exceed_by_loss']:7.2%} {row['more_bytes']:+8.1%} {row['more_feedback_bytes']:+8.0%}"
            f"  {recovery:>16}"
        )


def measure(arguments: argparse.Namespace) -> Row:
    """Run all cases and return the averages over the seeds."""
    seconds = 2.0 if arguments.quick else arguments.seconds
    release_s = 2.0 if arguments.quick else RELEASE_S
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    grid = cases(seeds, seconds, quick=arguments.quick)
    releases = release_cases(arguments.seed, release_s, quick=arguments.quick)
    with multiprocessing.Pool(WORKERS) as pool:  # the longest first
        rows = pool.map(measured, releases + grid, chunksize=1)
    results = {
        "ways": list(WAYS),
        "seconds": seconds,
        "rows": compared(averaged(rows[len(releases) :])),
        "releases": averaged(rows[: len(releases)]),
    }
    if arguments.json:
        show(results["rows"])
        for row in results["releases"]:
            print(
                f"loss {row['loss']:.0%}, burst {row['burst']:.0f}, {row['delay_us'] // 1000} ms, jitter"
                f" {row['jitter_us'] // 1000} ms: {row['releases']} releases in {row['seconds']:.0f} s"
            )
    return results


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(1.0), default=20.0, help="duration of each run")
    parser.add_argument("--seeds", type=record.within(1), default=1, help="number of seeds")
    parser.add_argument("--quick", action="store_true", help="a few short runs, to try the benchmark")
    record.run(parser, measure, unit="as in each name; shares of samples and of bytes")


if __name__ == "__main__":
    main()
