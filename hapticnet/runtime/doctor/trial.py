"""A slave and a master on loopback for a few seconds: round trip and ticks as they are on this machine now.

The limits come from measurements on two shared cores (bench/measure/real_time.py). There, a master's ticks at 1 kHz are
50 µs late, 0.2 ms at the 99th percentile and seldom missed; a second busy thread makes that 1.5 ms. A round trip takes
0.1 to 0.2 ms, 0.4 ms at the 99th percentile.
"""

import json
import os
import threading
from pathlib import Path
from typing import Any, Final, NamedTuple

from hapticnet.errors import UnavailableError
from hapticnet.runtime.doctor.finding import Finding, Step, Verdict, duration, grade, scratch_folder
from hapticnet.runtime.overload import LARGEST_MISSED_SHARE
from hapticnet.runtime.processes import Child

TRIAL_S: Final = 3.0

ENDS_WITHIN_S: Final = 20.0
"""Time [s] after which both processes are killed: the trial, and starting two processes on a slow machine."""

RATE_HZ: Final = 1000.0

GOOD_LATE_US: Final = 250.0
ACCEPTABLE_LATE_US: Final = 1000.0
"""Lateness of ticks [µs] at the 99th percentile: a quarter of a tick, and a whole one, after which ticks are missed."""

GOOD_ROUND_TRIP_US: Final = 1000.0
ACCEPTABLE_ROUND_TRIP_US: Final = 5000.0
"""Round trip [µs] at the 99th percentile: the force is there before the next position, and five ticks."""

GOOD_MISSED: Final = LARGEST_MISSED_SHARE
ACCEPTABLE_MISSED: Final = 0.05
"""Share of missed ticks: what a master warns of, and where the operator's motion has gaps all the time."""

WHO_IS_BUSY: Final = Step(
    "See what else is busy, end what is not needed, and look again:", "ps -eo pcpu,pid,user,comm --sort=-pcpu | head"
)
GRANT_FIFO: Final = Step("Permit SCHED_FIFO, as said under scheduling class above: its ticks do not wait for others.")


class Trial(NamedTuple):
    """What the master measured. Durations are in µs; None if there was no answer.

    Attributes
    ----------
    scheduling
        Scheduling class of the master.
    ticks, missed
        Ticks that ran, and ticks that were skipped because the next was due.
    answers
        Forces that answered a position.
    """

    scheduling: str
    round_trip_p50_us: float | None
    round_trip_p99_us: float | None
    late_p50_us: float | None
    late_p99_us: float | None
    ticks: int
    missed: int
    answers: int


def examine_trial() -> list[Finding]:
    """Run the trial and return its findings. Call it in the main thread: the processes end with their parent thread."""
    try:
        return judge_trial(run_trial())
    except (UnavailableError, OSError, ValueError, KeyError, TypeError) as error:
        return [judge_failure(str(error))]


def run_trial(duration_s: float = TRIAL_S, ends_within_s: float = ENDS_WITHIN_S) -> Trial:
    """Run a slave and a master of their own on loopback.

    Raises
    ------
    UnavailableError
        If a process fails or does not end in time, or there is no folder for their reports.
    OSError
        If they cannot be started.
    """
    children: list[Child] = []
    late = threading.Event()

    def kill() -> None:
        late.set()
        for child in children:
            child.kill()

    watchdog = threading.Timer(ends_within_s, kill)
    watchdog.daemon = True
    watchdog.start()
    try:
        with scratch_folder() as folder:
            report, environment = folder / "master.json", _without_settings(folder)
            children.append(Child(["slave", "--listen", "127.0.0.1:0"], environment=environment))
            address = children[0].address()
            arguments = ["master", "--connect", address, "--name", "doctor", "--device", "none", "--codec", "raw"]
            arguments += ["--rate", str(RATE_HZ), "--duration", str(duration_s), "--connect-timeout", "5"]
            children.append(Child([*arguments, "--report", str(report), "--quiet"], environment=environment))
            children[1].finish()
            return read_report(json.loads(report.read_text(encoding="utf-8")))
    except UnavailableError as error:
        if late.is_set():
            raise UnavailableError(f"slave and master did not end within {ends_within_s:g} s") from error
        raise
    finally:
        watchdog.cancel()
        for child in children:
            child.end()


def _without_settings(folder: Path) -> dict[str, str]:
    """Return the environment without keys and other settings of hapticnet: the trial measures the machine."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HAPTICNET_")}
    return {**kept, "XDG_CONFIG_HOME": str(folder)}


def read_report(report: dict[str, Any]) -> Trial:
    """Return the trial that a master's report describes; KeyError or TypeError if it is not such a report."""
    round_trip, lateness = report["round_trip"], report["lateness"]
    return Trial(
        scheduling=report["scheduling"],
        round_trip_p50_us=round_trip["p50_us"],
        round_trip_p99_us=round_trip["p99_us"],
        late_p50_us=lateness["p50_us"],
        late_p99_us=lateness["p99_us"],
        ticks=int(report["ticks"]),
        missed=int(report["missed_ticks"]),
        answers=int(round_trip["count"]),
    )


def judge_trial(trial: Trial) -> list[Finding]:
    """Judge what the master measured."""
    if trial.round_trip_p99_us is None or trial.late_p99_us is None:
        return [judge_failure("the slave answered no position")]
    due = trial.ticks + trial.missed
    missed_share = trial.missed / due if due else 1.0
    steps = (WHO_IS_BUSY,) if trial.scheduling.startswith("SCHED_FIFO") else (GRANT_FIFO, WHO_IS_BUSY)
    findings = [
        Finding(
            "measured.round_trip",
            "Round trip",
            grade(trial.round_trip_p99_us, GOOD_ROUND_TRIP_US, ACCEPTABLE_ROUND_TRIP_US),
            _percentiles(trial.round_trip_p50_us, trial.round_trip_p99_us),
            "Even without a network, the force for a position comes after the next positions.",
            steps,
            f"good: p99 up to {duration(GOOD_ROUND_TRIP_US / 1e6)}, before the next position;"
            f" acceptable: {duration(ACCEPTABLE_ROUND_TRIP_US / 1e6)}",
        ),
        Finding(
            "measured.lateness",
            "Tick lateness",
            grade(trial.late_p99_us, GOOD_LATE_US, ACCEPTABLE_LATE_US),
            f"{_percentiles(trial.late_p50_us, trial.late_p99_us)}, {trial.scheduling.partition(' (')[0]}",
            "Positions are sampled late, and the force loop of the fingertip device runs unevenly.",
            steps,
            f"good: p99 up to {duration(GOOD_LATE_US / 1e6)}, a quarter of a tick;"
            f" acceptable: {duration(ACCEPTABLE_LATE_US / 1e6)}",
        ),
        Finding(
            "measured.missed_ticks",
            "Missed ticks",
            grade(missed_share, GOOD_MISSED, ACCEPTABLE_MISSED),
            f"{trial.missed} of {due} ({missed_share:.2%})",
            "In a missed tick no position is sent, and the platform at the finger does not move.",
            steps,
            f"good: up to {GOOD_MISSED:.0%}; acceptable: {ACCEPTABLE_MISSED:.0%}",
        ),
    ]
    return [each._replace(meaning="", to_do=()) if each.verdict is Verdict.OK else each for each in findings]


def judge_failure(reason: str) -> Finding:
    """Return the finding of a trial that gave no measurement."""
    return Finding(
        "measured.trial",
        "Slave and master",
        Verdict.PROBLEM,
        f"no session over loopback: {reason}",
        "Unless the reason lies in this trial, a session between two hosts fails in the same way.",
        (
            Step("See what the slave says:", "hapticnet slave --listen 127.0.0.1:0 --duration 5"),
            Step("See whether loopback is up:", "ip address show lo"),
        ),
    )


def _percentiles(p50_us: float | None, p99_us: float | None) -> str:
    return ", ".join(
        f"{name} {'unknown' if value is None else duration(value / 1e6)}"
        for name, value in (("p50", p50_us), ("p99", p99_us))
    )
