"""The checks of ``hapticnet doctor``: whether this machine can run a slave and a master, and remedies if not."""

import asyncio
import json
import os
import resource
import shlex
import socket
import sys
import tempfile
import time
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

from hapticnet.errors import UnavailableError
from hapticnet.measure.stability import onset
from hapticnet.operator.yielding import parse_hand
from hapticnet.runtime.overload import LARGEST_MISSED_SHARE
from hapticnet.runtime.processes import Child
from hapticnet.runtime.system import FIFO_PRIORITY, loop_factory, policy
from hapticnet.runtime.timer import Alarm
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES
from hapticnet.scene.sources import find_scene

TRIAL_S: Final = 3.0
# A quarter of a tick, and a whole one, at the 99th percentile. On two shared cores (bench/measure/real_time.py) it is
# 0.2 ms, with a second busy thread 1.5 ms. A round trip takes 0.1 to 0.2 ms, 0.4 ms at the 99th percentile.
LATE_US: Final = 250.0, 1000.0  # good and acceptable lateness of ticks

TICKS_S: Final = 0.0015  # at 1 kHz a force is applied a tick after its position, and held for another
ROUND_TRIP_US: Final = 1000.0, 5000.0  # the same of the round trip: before the next position, and five ticks
MISSED: Final = LARGEST_MISSED_SHARE, 0.05  # a master warns above the first; above the second, motion has constant gaps


class Verdict(StrEnum):
    """How good a finding is."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


class Step(NamedTuple):
    """Something to do: a sentence, and the exact command if there is one."""

    text: str
    command: str = ""


class Finding(NamedTuple):
    """One thing about this machine."""

    title: str
    verdict: Verdict
    value: str  # the value found
    meaning: str = ""  # its consequence; empty if there is none
    to_do: tuple[Step, ...] = ()  # the best remedy first


def grade(value: float, good: float, acceptable: float) -> Verdict:
    """Return the verdict on a value for which less is better."""
    if value <= good:
        return Verdict.OK
    return Verdict.WARNING if value <= acceptable else Verdict.PROBLEM


def examine() -> list[Finding]:
    """Return what there is to say of this machine without a trial."""
    limits = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return [judge_timer(), judge_scheduling(try_fifo(), limits), _cpus(), judge_buffer(granted_bytes())]


def judge_timer() -> Finding:
    """Judge whether timers work."""

    async def create() -> None:
        Alarm(asyncio.get_running_loop(), lambda: None).stop()

    try:
        with asyncio.Runner(loop_factory=loop_factory()) as runner:
            runner.run(create())
    except UnavailableError as error:
        meaning = "Slave and master cannot run in real time here; virtual time and recordings still work."
        return Finding("Timer", Verdict.PROBLEM, str(error), meaning, (Step("Use a machine with Linux."),))
    return Finding("Timer", Verdict.OK, f"timerfd, resolution {1e9 * time.clock_getres(time.CLOCK_MONOTONIC):.3g} ns")


def try_fifo() -> str | None:
    """Switch this thread to SCHED_FIFO briefly; return why it was refused, or None."""
    if not sys.platform.startswith("linux"):
        return "this system does not have it"
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)  # 0 is the calling thread
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        return (error.strerror or str(error)).lower()
    os.sched_setscheduler(0, before, parameters)
    return None


def judge_scheduling(refusal: str | None, limits: tuple[float, float]) -> Finding:
    """Judge the scheduling class by why SCHED_FIFO is refused, and by the soft and hard limit of priorities."""
    title = "Scheduling class"
    if refusal is None:
        return Finding(title, Verdict.OK, f"SCHED_FIFO {FIFO_PRIORITY} is granted")
    value = f"SCHED_FIFO is refused: {refusal}"
    meaning = "Slave and master wait for other programs: on a busy machine, ticks are late or missed."
    return Finding(title, Verdict.WARNING, value, meaning, _how_to_grant(*limits))


def _how_to_grant(soft: float, hard: float) -> tuple[Step, ...]:
    if soft >= FIFO_PRIORITY or soft == resource.RLIM_INFINITY:
        text = (
            "This account may use SCHED_FIFO; a sandbox forbids it, or this kernel grants real time to control groups"
            " only (CONFIG_RT_GROUP_SCHED): raise cpu.rt_runtime_us, or boot with rt_group_sched=0."
        )
        return (Step(text),)
    if hard >= FIFO_PRIORITY or hard == resource.RLIM_INFINITY:
        return (Step("Raise the limit in the shell that starts hapticnet:", f"ulimit -r {FIFO_PRIORITY}"),)
    permit = f'echo "$USER - rtprio {FIFO_PRIORITY}" | sudo tee /etc/security/limits.d/90-hapticnet.conf'
    python = shlex.quote(os.path.realpath(sys.executable))
    return (
        Step("Permit it for your account, then log out and in again:", permit),
        Step(f"In a systemd service instead: LimitRTPRIO={FIFO_PRIORITY}"),
        Step("Or permit it for this Python, so for every script it runs:", f"sudo setcap cap_sys_nice+ep {python}"),
        Step("In a container:", f"docker run --cap-add SYS_NICE --ulimit rtprio={FIFO_PRIORITY} …"),
    )


def _cpus() -> Finding:
    total = os.cpu_count() or 1
    return judge_cpus(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total, total)


def judge_cpus(usable: int, total: int) -> Finding:
    """Judge how many of the CPUs this process may use."""
    value = str(usable) if usable == total else f"{usable} of {total} may be used"
    if usable > 1:
        return Finding("CPUs", Verdict.OK, value)
    step = Step("Give the machine or container two.")
    if total > usable:
        step = Step("Give hapticnet more CPUs:", f"taskset -c 0-{total - 1} hapticnet …")
    return Finding("CPUs", Verdict.WARNING, value, "Ticks wait for everything else that runs on the only CPU.", (step,))


def granted_bytes() -> int:
    """Return the receive buffer that a slave is granted [B]. The kernel reports twice that, for its bookkeeping."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def judge_buffer(granted: int) -> Finding:
    """Judge the receive buffer by what was granted [B]."""
    title, asked = "Receive buffer", RECEIVE_BUFFER_BYTES
    if granted >= asked:
        return Finding(title, Verdict.OK, f"{granted // 1024} KiB, as asked for")
    value, setting = f"{granted // 1024} of the {asked // 1024} KiB asked for", f"net.core.rmem_max={asked}"
    meaning = "A slave with many masters that stands still for a moment loses datagrams."
    steps = (
        Step("Raise the limit, in a container that of its host, until the next boot:", f"sudo sysctl -w {setting}"),
        Step("And for good:", f"echo {setting} | sudo tee /etc/sysctl.d/90-hapticnet.conf"),
    )
    return Finding(title, Verdict.WARNING, value, meaning, steps)


def judge_stability(hand: str, round_trip_s: float, scene: str | None) -> Finding:
    """Judge by the closed form whether a hand without reflexes and coupling would swing against a scene.

    Raise SettingsError or FileError if the hand or the scene cannot be used.
    """
    spec = parse_hand(f"hand:{hand}")
    moved, device = spec.hand, spec.device
    limit, hertz = onset(
        moved.mass_kg + device.mass_kg,
        moved.damping_n_s_per_m + device.damping_n_s_per_m,
        moved.stiffness_n_per_m,
        round_trip_s + TICKS_S,
    )
    value = f"{hand}, round trip {1e3 * round_trip_s:g} ms: it swings above {limit:.0f} N/m, at {hertz:.1f} Hz"
    if scene is None:
        return Finding("Stability", Verdict.OK, value)
    stiffest = find_scene(scene).stiffest_n_per_m
    value += f"; {scene} has up to {stiffest:.0f} N/m"
    if stiffest < limit:
        return Finding("Stability", Verdict.OK, value)
    meaning = "A device that pushes the hand will swing with it. One that only presses on the skin does not."
    steps = (
        Step("See what helps:", f"hapticnet stability --hand {hand} --delays {1e3 * round_trip_s:g}ms"),
        Step("Or bound the energy:", "hapticnet master --coupling energy-bounded --codec motion-predictive …"),
    )
    return Finding("Stability", Verdict.WARNING, value, meaning, steps)


def examine_trial() -> list[Finding]:
    """Run the trial and return its findings. Call it in the main thread: the processes end with their parent thread."""
    try:
        return judge_trial(run_trial())
    except (UnavailableError, OSError, ValueError, KeyError) as error:
        return [judge_failure(str(error))]


def run_trial(duration_s: float = TRIAL_S) -> dict[str, Any]:
    """Return the report of a master at 1 kHz on loopback; UnavailableError if a process fails, OSError for files."""
    children: list[Child] = []
    try:
        with tempfile.TemporaryDirectory(prefix="hapticnet-doctor-") as folder:
            children.append(Child(["slave", "--listen", "127.0.0.1:0"]))
            arguments = ["master", "--connect", children[0].address(), "--name", "doctor", "--device", "none"]
            arguments += ["--codec", "raw", "--duration", str(duration_s), "--connect-timeout", "5", "--quiet"]
            children.append(Child([*arguments, "--report", f"{folder}/master.json"]))
            children[1].finish()
            report: dict[str, Any] = json.loads(Path(folder, "master.json").read_text(encoding="utf-8"))
            return report
    finally:
        for child in children:
            child.end()


def judge_trial(report: Mapping[str, Any]) -> list[Finding]:
    """Judge the master's report: round trip, ticks and missed ticks."""
    round_trip, lateness, scheduling = report["round_trip"], report["lateness"], policy(report["scheduling"])
    if round_trip["p99_us"] is None or lateness["p99_us"] is None:
        return [judge_failure("the slave answered no position")]
    missed = report["missed_ticks"]
    due = report["ticks"] + missed
    busy = Step("See what else is busy, and look again:", "ps -eo pcpu,pid,user,comm --sort=-pcpu | head")
    permit = Step("Permit SCHED_FIFO, see scheduling class above: ticks then do not wait for others.")
    steps = (busy,) if scheduling.startswith("SCHED_FIFO") else (permit, busy)

    def finding(title: str, measured: float, limits: tuple[float, float], value: str, meaning: str) -> Finding:
        found = Finding(title, grade(measured, *limits), value)
        return found if found.verdict is Verdict.OK else found._replace(meaning=meaning, to_do=steps)

    return [
        finding(
            "Round trip", round_trip["p99_us"], ROUND_TRIP_US, _percentiles(round_trip),
            "Even without a network, the force for a position comes after the next positions.",
        ),
        finding(
            "Tick lateness", lateness["p99_us"], LATE_US, f"{_percentiles(lateness)}, {scheduling}",
            "Positions are sampled late, and the force loop of the fingertip device runs unevenly.",
        ),
        finding(
            "Missed ticks", missed / max(due, 1), MISSED,
            f"{missed} of {due} ({missed / max(due, 1):.2%})",
            "In a missed tick no position is sent, and the platform at the finger does not move.",
        ),
    ]  # fmt: skip


def judge_failure(reason: str) -> Finding:
    """Return the finding of a trial that gave no measurement."""
    meaning = "Unless the reason lies in this trial, a session between two hosts fails in the same way."
    step = Step("See the slave's messages:", "hapticnet slave --listen 127.0.0.1:0 --duration 5")
    value = f"no session over loopback: {reason}"
    return Finding("Slave and master", Verdict.PROBLEM, value, meaning, (step,))


def _percentiles(measured: Mapping[str, float]) -> str:
    return f"p50 {measured['p50_us'] / 1000.0:.3g} ms, p99 {measured['p99_us'] / 1000.0:.3g} ms"
