"""How many sessions a slave holds on one core, and the cost of a position, beside a datagram echo in C.

All masters are one C program (bench/peers/masters.c) that speaks the whole protocol. The server runs on one CPU, the
masters on another. First all servers take turns at the same load, which gives the processor time of a position. Then,
for each, a short search finds how many sessions it holds.
"""

import argparse
import math
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import record
from real_time import fifo_is_granted
from session_load import Bench, Case, play, slave_command

CASES: Final = {
    "deadband": Case("deadband", 1000.0, 1000.0, False, 0.0, 20, 40),
    "raw": Case("raw", 1000.0, 1000.0, False, 0.0, 1, 25),
    "deadband, sealed": Case("deadband", 1000.0, 1000.0, True, 0.0, 20, 30),
    "raw, sealed": Case("raw", 1000.0, 1000.0, True, 0.0, 1, 20),
    "deadband, 100 Hz": Case("deadband", 100.0, 100.0, False, 0.0, 3, 300),
    "coded positions": Case("deadband", 1000.0, 50.0, False, 0.25, 1, 12),
}
SERVERS: Final[dict[str, tuple[str, ...] | None]] = {
    "echo": None,
    "slave": (),
}
QUICK: Final = ("deadband", "raw, sealed", "coded positions")
QUICK_MASTERS: Final = 3

MOST_SENDS_HZ: Final = 450_000.0
"""Highest load that is tried, in datagrams a second of all masters: a dedicated core can just send them."""

MOST_MASTERS: Final = 3_000
LARGEST_P99_US: Final = 2_000.0
LARGEST_SUPERSEDED: Final = 0.01
"""Share of positions that a slave may pass over for a newer one in a run that counts as held: 1 % may also be late."""

LARGEST_LATE_US: Final = 1_000.0
"""99th percentile of the generator's lateness above which a run tells nothing about the server."""

GROWTH: Final = (1.3, 2.5)
"""Smallest and largest step of a search to more masters; between them, the step that would need 1.2 CPUs, because a
position costs less the more there are."""

CLOSE_ENOUGH: Final = 0.06
Row = dict[str, Any]


def faults(run: Row, case: Case) -> list[str]:
    """Return why a run does not count as held; nothing if it does."""
    superseded = run.get("slave_superseded", 0) / max(1, run.get("slave_positions", 1))
    unanswered = run["positions"] - run["answers"] if case.one_in == 1 and "slave_steps" not in run else 0
    checks = {
        "the generator was late": run["unsent"] or run["late_p99_us"] > LARGEST_LATE_US or run["kernel_drops"],
        "not all masters were served": run["at_work"] < run["masters"] or run["ended"] or run["resets"],
        "the server's socket was full": run["server_drops"] or run.get("slave_drops", 0),
        "answers were lost": run["lost"] or unanswered,
        "positions were lost": run.get("slave_lost", 0),
        "malformed datagrams": run["malformed"],
        "positions were passed over": superseded > LARGEST_SUPERSEDED,
        "the round trip was too long": not 0.0 <= run["trip_p99_us"] <= LARGEST_P99_US,
    }
    if checks["the server's socket was full"]:  # dropped datagrams are missing in all counts
        checks["answers were lost"] = checks["positions were lost"] = 0
    return [name for name, bad in checks.items() if bad]


def search(run: Callable[[int], Row], case: Case, start: int, tries: int) -> tuple[Row | None, list[str]]:
    """Return the largest run that was held, and why the smallest above it was not (empty: none was tried)."""
    most = min(MOST_MASTERS, int(MOST_SENDS_HZ / case.sends_hz))
    held, above, wrong = None, None, list[str]()
    masters = max(1, min(start, most))
    for _ in range(tries):
        row = run(masters)
        if found := faults(row, case):  # a second time: the machine may have been busy with something else
            row = run(masters)
            found = faults(row, case)
        if found:
            above, wrong = masters, found
        else:
            held = row
        low = held["masters"] if held is not None else 0
        if above is None and low >= most:
            return held, ["no more masters were tried"]
        if above is not None and above - low <= max(1, CLOSE_ENOUGH * above):
            break
        if above is None:
            cpu = held_figures(row, case)["held_cpu"]
            masters = min(most, math.ceil(low * min(max(1.2 / cpu, GROWTH[0]), GROWTH[1])))
        else:
            masters = (low + above) // 2 if low else max(1, math.floor(0.75 * above))
    return held, wrong


def measured(name: str, bench: Bench, servers: Sequence[str], arguments: argparse.Namespace) -> list[Row]:
    """Measure one case on all servers; return a row for each."""
    case = CASES[name]
    masters = QUICK_MASTERS if arguments.quick else case.masters
    runs: dict[str, list[Row]] = {server: [] for server in servers}

    def one(server: str, masters: int) -> Row:
        row = play(bench, case, SERVERS[server], masters)
        note(name, server, row, faults(row, case))
        return row

    for _ in range(arguments.repetitions):
        for server in servers:
            runs[server].append(one(server, masters))

    def beside_echo(server: str, held: Row | None) -> float | None:
        """Return the echo's time per position, with as many masters, relative to a run that was held."""
        if held is None or "echo" not in servers:
            return None
        if server == "echo":
            return 1.0
        return one("echo", held["masters"])["us_per_position"] / held["us_per_position"]  # type: ignore[no-any-return]

    rows = []
    for server in servers:
        us = statistics.median(run["us_per_position"] for run in runs[server])
        middle = runs[server][len(runs[server]) // 2]
        start = masters if arguments.quick else int(0.75e6 / case.sends_hz / us)
        held, wrong = search(lambda masters, server=server: one(server, masters), case, start, arguments.tries)
        rows.append(
            {
                "case": name,
                "server": server,
                "codec": case.codec,
                "rate_hz": case.rate_hz,
                "share": case.share,
                "sends_hz": case.sends_hz,
                "one_in": case.one_in,
                "masters": masters,
                "us_per_position": us,
                "answers_per_position": middle["answers"] / max(1, middle["positions"]),
                "sessions_a_core": 1e6 / case.sends_hz / us,
                "p50_us": statistics.median(run["trip_p50_us"] for run in runs[server]),
                "p99_us": statistics.median(run["trip_p99_us"] for run in runs[server]),
                **held_figures(held, case),
                "held_us_of_echo": beside_echo(server, held),
                "why_no_more": wrong,
                "runs": runs[server],
            }
        )
    echo = next((row for row in rows if row["server"] == "echo"), None)
    for row in rows:
        row["of_echo"] = row["sessions_a_core"] / echo["sessions_a_core"] if echo else None
        row["held_of_echo"] = row["held"] / echo["held"] if echo and echo["held"] and row["held"] else None
    return rows


def held_figures(held: Row | None, case: Case) -> Row:
    """Return the figures of the largest run that was held; all None if there is none."""
    if held is None:
        names = (
            "us_per_position",
            "sessions_a_core",
            "cpu",
            "generator_cpu",
            "datagrams_per_s",
            "p50_us",
            "p99_us",
            "drops",
        )
        return {"held": None, **{f"held_{name}": None for name in names}}
    return {
        "held": held["masters"],
        "held_us_per_position": held["us_per_position"],
        "held_sessions_a_core": 1e6 / case.sends_hz / held["us_per_position"],
        "held_cpu": held["server_cpu_s"] / held["seconds"],
        "held_generator_cpu": held["generator_cpu_s"] / held["seconds"],
        "held_datagrams_per_s": (held["positions"] + held["received"]) / held["seconds"],
        "held_p50_us": held["trip_p50_us"],
        "held_p99_us": held["trip_p99_us"],
        "held_drops": held["server_drops"] + held["kernel_drops"],
    }


def note(case: str, server: str, row: Row, wrong: Sequence[str]) -> None:
    """Print the result of a run for a person."""
    print(
        f"{case}, {server}: {row['masters']} masters, {row['us_per_position']:.2f} us a position,"
        f" p50 {row['trip_p50_us']:.0f}, p99 {row['trip_p99_us']:.0f} us, {'; '.join(wrong) or 'held'}",
        file=sys.stderr,
        flush=True,
    )


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    fifo = not arguments.no_real_time and fifo_is_granted()
    settle_s = 0.2 if arguments.quick else 1.0
    cases = arguments.cases or (QUICK if arguments.quick else CASES)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), slave_command(arguments.slave_python), fifo, arguments.seconds, settle_s)
        bench.prepare()
        left_out = [name for name in arguments.servers if any(not bench.knows(flag) for flag in flags(name))]
        for name in left_out:
            print(f"left out: {name}; this slave does not have the option", file=sys.stderr)
        servers = [name for name in arguments.servers if name not in left_out]
        rows = [row for name in cases for row in measured(name, bench, servers, arguments)]
    return {
        "scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER",
        "seconds": arguments.seconds,
        "largest_p99_us": LARGEST_P99_US,
        "largest_superseded": LARGEST_SUPERSEDED,
        "left_out": left_out,
        "rows": rows,
    }


def flags(server: str) -> list[str]:
    """Return the options that turn a slave into this variant."""
    return [option for option in SERVERS[server] or () if option.startswith("--")]


def some_of(names: Sequence[str]) -> Callable[[str], list[str]]:
    """Return a parser of names, separated by semicolons."""

    def parse(text: str) -> list[str]:
        chosen = [each.strip() for each in text.split(";")]
        if unknown := [each for each in chosen if each not in names]:
            raise argparse.ArgumentTypeError(f"unknown: {unknown[0]!r}; there are {'; '.join(names)}")
        return chosen

    return parse


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=2.0, help="length of each measurement")
    parser.add_argument("--repetitions", type=record.within(1), default=3, help="turns at the same load")
    parser.add_argument("--tries", type=record.within(0), default=7, help="steps of each search for the largest load")
    parser.add_argument("--cases", type=some_of(list(CASES)), metavar="CASES", help="such as 'deadband; raw, sealed'")
    parser.add_argument("--servers", type=some_of(list(SERVERS)), metavar="SERVERS", default=list(SERVERS))
    parser.add_argument("--slave-python", type=Path, metavar="FILE", help="a hapticnet or its Python: another build")
    parser.add_argument("--quick", action="store_true", help="three cases with a few masters")
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
