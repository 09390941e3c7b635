"""Hostile datagrams by the million against slaves and master, open and sealed: no exception, and memory stays flat.

Each node plays its part in a true session in virtual time while hostile datagrams arrive: as if from its peer, from
strangers, from strangers with a proved address, and, in sealed sessions, from a peer that has the keys.
"""

import argparse
import os
import time
import traceback
from pathlib import Path
from typing import Any, Final

import numpy as np
import record
from fuzz_session import TICK_US, Session

BEFORE_A_TICK: Final = 10
"""Hostile datagrams between two ticks of the true session: 10,000 a second."""

KEPT: Final = 5
"""Exceptions that are kept with their datagrams."""

CHECKPOINTS: Final = 20
"""How often the memory is read."""

NODES: Final = ("slave", "master")

PAGE_BYTES: Final = os.sysconf("SC_PAGE_SIZE")


def fuzzed(node: str, *, sealed: bool, datagrams: int, seed: int) -> dict[str, Any]:
    """Attack one node with `datagrams` hostile ones; return the outcome."""
    session = Session(seed, sealed=sealed, attacked=node)
    exceptions: list[dict[str, str]] = []
    raised = 0
    memory_mb = []
    started_s = time.process_time()
    for number in range(datagrams):
        if number % BEFORE_A_TICK == 0:
            session.tick()
        if number % (datagrams // CHECKPOINTS or 1) == 0:
            memory_mb.append(resident_mb())
        data, source = session.hostile()
        try:
            session.strike(data, source)
        except Exception:
            raised += 1
            if len(exceptions) < KEPT:
                exceptions.append({"datagram": data.hex(), "traceback": traceback.format_exc()})
    # Tables with a bound fill first: accounts of ended sessions, cookies, codecs.
    settled = memory_mb[len(memory_mb) // 2 :]
    return {
        "node": node,
        "sealed": sealed,
        "datagrams": datagrams,
        "exceptions": raised,
        "first_exceptions": exceptions,
        "failures": session.failures,
        "sessions_lost": session.lost if sealed else None,
        "insiders": session.insiders,
        "requests": session.requests,
        # Making a hostile datagram takes as long as answering it; so does a tick of the true session, once in ten.
        "cpu_us_per_datagram": 1e6 * (time.process_time() - started_s) / datagrams,
        "virtual_s": session.step * TICK_US / 1e6,
        "memory_growth_mb": max(settled) - settled[0],
        "memory_mb": memory_mb,
        "report": session.report(),
    }


def resident_mb() -> float:
    """Return the memory of this process that is in use [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * PAGE_BYTES / 1e6


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    arguments.repetitions = 1
    kinds = [(node, sealed) for node in NODES for sealed in (False, True)]
    if arguments.only:
        name, _, kind = arguments.only.partition(",")
        kinds = [(name, kind == "sealed")]
    rows = []
    for node, sealed in kinds:
        row = fuzzed(node, sealed=sealed, datagrams=arguments.datagrams, seed=arguments.seed)
        rows.append(row)
        print(
            f"{node} {'sealed' if sealed else 'open'}: {row['exceptions']} exceptions, {row['failures']} failures,"
            f" {row['memory_growth_mb']:.1f} MB more in the second half, {row['cpu_us_per_datagram']:.1f} us each",
            flush=True,
        )
    return {"rows": rows}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument(
        "--datagrams", type=record.within(100, 1e10), default=1_000_000, help="against each node, open and sealed"
    )
    parser.add_argument(
        "--only", choices=[f"{node},{kind}" for node in NODES for kind in ("open", "sealed")], help="one of the six"
    )
    np.seterr(all="raise")  # which turns warnings into exceptions
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
