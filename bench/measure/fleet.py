"""How long masters are without a slave when hosts fail: a model of 100,000, checked against real runs.

Real masters lose a real slave on loopback, and the model plays the same; then it plays a service. Sessions for each
process come from what a position costs a slave: here in the same run, and with `--sessions` in results of sessions.py.
"""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any, Final

import record
from fleet_costs import datagram_costs, memory_per_session, queue_datagrams
from fleet_masters import outage
from fleet_parts import Costs, FleetSettings
from fleet_scenarios import (
    DETECT_S,
    FAULT_S,
    GAP_S,
    REBOOT_S,
    RESTART_S,
    ROAM_S,
    SESSION_S,
    SITE,
    play_all,
    quantiles,
    small,
)

from hapticnet.node.reception import ALL_REQUESTS_AT_ONCE, ALL_REQUESTS_PER_S, REQUESTS_AT_ONCE, REQUESTS_PER_S
from hapticnet.protocol.settings import SessionSettings

RATE_HZ: Final = 50.0
"""Positions a second of each real master."""

CASES: Final = (
    # masters, addresses, wait before the slave starts again [s], killed or ended in an orderly way
    (60, 60, 0.0, True),
    (100, 100, 0.0, True),
    (100, 100, 3.0, True),
    (30, 1, 0.0, True),
    (60, 60, 0.0, False),
)
QUICK_CASES: Final = ((12, 12, 0.0, True),)

SESSIONS_CASE: Final = "deadband, 100 Hz"
SERVERS: Final = {"slave": "plain", "slave --compiled": "compiled"}
"""Which results of sessions.py say what a position costs, by the names here."""

POSITIONS_PER_S: Final = 100.0
"""Positions a second of a master in the service: sent only when they matter, with room for fast hands."""

SHARE_USED: Final = 0.5
"""Of a process's time in normal operation: the sessions of hosts that fail must find room."""

PROCESSES: Final = 8
DELAY_S: Final = 5e-3
"""Processes of a host, and delay one way."""


def check(cases: tuple[tuple[int, int, float, bool], ...], costs: Costs, seed: int, repetitions: int) -> list[Any]:
    """Return real and modelled times of each case, for the middle one of the real runs by their medians."""
    rows = []
    for masters, addresses, wait_s, kill in cases:
        runs = [outage(masters, addresses, RATE_HZ, wait_s, kill=kill) for _ in range(repetitions)]
        runs.sort(key=lambda run: quantiles(run["back_s"])["p50"])
        run = runs[len(runs) // 2]
        model = small(run | {"addresses": addresses, "costs": costs}, RATE_HZ, kill=kill, seed=seed)
        real = {**quantiles(run["back_s"]), "hellos": run["hellos"], "peak_hellos_per_s": run["peak_hellos_per_s"]}
        rows.append(
            {
                "masters": masters,
                "addresses": addresses,
                "killed": kill,
                "outage_s": run["outage_s"],
                "real": real,
                "model": model,
                "median_over_real": model["p50"] / real["p50"],
                "last_over_real": model["last"] / real["last"],
                "hellos_over_real": model["hellos"] / real["hellos"],
                "cpu_us_per_position": [each["cpu_us_per_position"] for each in runs],
            }
        )
    return rows


def service(name: str, position_us: float, masters: int, seed: int, queue: int) -> dict[str, Any]:
    """Return a service whose processes need `position_us` of CPU for a position, and all that may happen to it."""
    sessions = max(4, math.floor(SHARE_USED * 1e6 / (position_us * POSITIONS_PER_S)))
    costs = datagram_costs(min(sessions, 1000), sealed=True)
    hosts = max(2, math.ceil(masters / (PROCESSES * sessions)))
    settings = FleetSettings(
        masters=masters,
        addresses=masters,
        hosts=hosts,
        processes=PROCESSES,
        delay_s=DELAY_S,
        position_s=1.0 / POSITIONS_PER_S,
        sparse=True,
        detect_s=DETECT_S,
        costs=Costs(**costs, position_us=position_us, queue=queue),
    )
    began_s = time.monotonic()
    scenarios = play_all(settings, seed)
    return {
        "slave": name,
        "cpu_us_per_position": position_us,
        "sessions_a_core": 1e6 / (position_us * POSITIONS_PER_S),
        "sessions_a_process": sessions,
        "hosts": hosts,
        "costs": costs,
        "scenarios": scenarios,
        "took_s": time.monotonic() - began_s,
    }


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    quick = arguments.quick
    kept = 100 if quick else 1000
    costs = {
        way: {str(count): datagram_costs(count, sealed=way == "sealed") for count in (64, kept)}
        for way in ("open", "sealed")
    }
    queue = queue_datagrams()
    cases = QUICK_CASES if quick else CASES
    checks = check(cases, Costs(**costs["open"]["64"], queue=queue), arguments.seed, arguments.repetitions)
    turns_us = sorted(max(checks, key=lambda row: row["masters"])["cpu_us_per_position"])
    masters = 4000 if quick else arguments.masters
    slaves = {"plain": turns_us[len(turns_us) // 2]} | slaves_of(arguments.sessions)
    memory = {way: memory_per_session(kept, sealed=way == "sealed") for way in ("open", "sealed")}
    timers = SessionSettings()
    return {
        "checks": checks,
        "rate_hz": RATE_HZ,
        "masters": masters,
        "processes": PROCESSES,
        "delay_s": DELAY_S,
        "detect_s": DETECT_S,
        "reboot_s": REBOOT_S,
        "restart_s": RESTART_S,
        "fault_s": FAULT_S,
        "gap_s": GAP_S,
        "roam_s": ROAM_S,
        "session_s": SESSION_S,
        "site": SITE,
        "positions_per_s": POSITIONS_PER_S,
        "share_used": SHARE_USED,
        "kept": kept,
        "sessions_case": SESSIONS_CASE if slaves_of(arguments.sessions) else None,
        "queue_datagrams": queue,
        "costs": costs,
        "memory_bytes_per_session": memory,
        "limits": {
            "requests_per_s": REQUESTS_PER_S,
            "requests_at_once": REQUESTS_AT_ONCE,
            "all_requests_per_s": ALL_REQUESTS_PER_S,
            "all_requests_at_once": ALL_REQUESTS_AT_ONCE,
            "keep_s": timers.keep_us / 1e6,
            "asks_after_s": (timers.stale_after_us + timers.ask_again_us) / 1e6,
            "most_sessions": timers.most_sessions,
            "most_per_identity": timers.most_per_identity,
        },
        "services": [service(name, us, masters, arguments.seed, queue) for name, us in slaves.items()],
    }


def slaves_of(file: Path | None) -> dict[str, float]:
    """Return what a position costs each kind of slave [µs], from the record of sessions.py if there is one."""
    if file is None or not file.exists():
        return {}
    rows = json.loads(file.read_text(encoding="utf-8"))["results"]["rows"]
    chosen = [row for row in rows if row["case"] == SESSIONS_CASE and row["server"] in SERVERS]
    # With as many sessions as were held, where that was looked for: a slave that sleeps between datagrams needs more.
    return {SERVERS[row["server"]]: row["held_us_per_position"] or row["us_per_position"] for row in chosen}


def main() -> None:
    """Read the arguments and write the record."""
    parser = record.options(__doc__)
    parser.add_argument("--repetitions", type=record.within(1, 20), default=3, help="real runs of each case")
    parser.add_argument("--masters", type=record.within(1000), default=100_000, help="masters of the service")
    parser.add_argument("--sessions", type=Path, metavar="FILE", help="results of sessions.py; left out if missing")
    parser.add_argument("--quick", action="store_true", help="one small real run, and a small service")
    record.run(parser, measure, unit="s")


if __name__ == "__main__":
    main()
