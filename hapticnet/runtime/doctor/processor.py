"""CPUs: how many, how fast they wake, and how busy they are."""

import os
from collections import Counter
from typing import Final, NamedTuple

from hapticnet.runtime.doctor.finding import Figures, Finding, Step, Topic, Verdict, duration
from hapticnet.runtime.doctor.machine import Machine

SUBJECT: Final = "processor"

ENOUGH_CPUS: Final = 2
"""One for the process, and one for everything else."""

TICK_US: Final = 1000

SLOW_WAKE_US: Final = 200
"""Wake-up time [µs] that shows in the ticks; a tick is about 50 µs late by itself."""

BUSY: Final = 0.75
"""Load per CPU from which ticks wait more often for other programs."""

STOLEN: Final = 0.01
"""Share of the time in which this virtual machine wanted to run, and its host ran something else."""

CPUS: Final = "/sys/devices/system/cpu"


class IdleState(NamedTuple):
    """A sleep state of a CPU: its number, its name, and how long it takes to wake [µs]."""

    number: int
    name: str
    wake_us: int


def examine_processor(machine: Machine) -> list[Finding]:
    """Return the findings about the CPUs."""
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    return [
        judge_count(usable, total),
        judge_governor(machine),
        judge_idle(machine),
        judge_load(machine, usable),
        judge_stolen(machine),
    ]


def judge_count(usable: int, total: int) -> Finding:
    """Judge the number of CPUs this process may use, of those there are."""
    topic = Topic(SUBJECT, "count", "CPUs", {"usable": usable, "total": total})
    value = str(usable) if usable == total else f"{usable} of {total} may be used"
    if usable >= ENOUGH_CPUS:
        return topic.ok(value)
    step = Step("Give the machine or container two.")
    if total > usable:
        step = Step("Give hapticnet more CPUs:", f"taskset -c 0-{total - 1} hapticnet …")
    return topic.find(
        Verdict.WARNING,
        value,
        "Ticks wait for whatever else runs on the only CPU.",
        step,
        scale=f"good: at least {ENOUGH_CPUS}",
    )


def judge_governor(machine: Machine) -> Finding:
    """Judge how the CPUs choose their frequency."""
    names = [machine.text(path) or "unknown" for path in machine.glob(f"{CPUS}/cpu[0-9]*/cpufreq/scaling_governor")]
    figures: Figures = {"governors": ",".join(sorted(set(names))) or None, "cpus": len(names)}
    topic = Topic(SUBJECT, "governor", "Frequency governor", figures)
    if not names:
        return topic.absent("none; firmware or host chooses the frequency")
    value = ", ".join(f"{name} on {number}" for name, number in Counter(names).most_common()) + f" of {len(names)} CPUs"
    if set(names) == {"performance"}:
        return topic.ok(f"performance on all {len(names)} CPUs")
    return topic.find(
        Verdict.WARNING,
        value,
        "Between ticks the CPUs slow down, and each tick starts on a slow CPU.",
        Step(
            "Keep them fast until the next boot:", f"echo performance | sudo tee {CPUS}/cpu*/cpufreq/scaling_governor"
        ),
    )


def judge_idle(machine: Machine) -> Finding:
    """Judge how long a CPU takes to wake from the deepest sleep that it may enter between two ticks."""
    states = idle_states(machine)
    slowest = max(states, key=lambda state: state.wake_us, default=None)
    figures: Figures = {"state": slowest and slowest.name, "wake_us": slowest and slowest.wake_us}
    topic = Topic(SUBJECT, "idle", "Wake-up from sleep", figures)
    if slowest is None:
        return topic.absent("this kernel does not manage it")
    value = f"{duration(slowest.wake_us / 1e6)} at most between ticks ({slowest.name})"
    if slowest.wake_us <= SLOW_WAKE_US:
        return topic.ok(value)
    slow = [f"{CPUS}/cpu*/cpuidle/state{state.number}/disable" for state in states if state.wake_us > SLOW_WAKE_US]
    return topic.find(
        Verdict.WARNING,
        value,
        "A sleeping CPU adds this to the lateness of a tick or an answer.",
        Step("Forbid such states until the next boot:", f"echo 1 | sudo tee {' '.join(slow)}"),
        scale=f"good: up to {SLOW_WAKE_US} µs",
    )


def idle_states(machine: Machine) -> list[IdleState]:
    """Return the sleep states of the first CPU that are worth entering for less than a tick."""
    states = []
    for folder in machine.glob(f"{CPUS}/cpu0/cpuidle/state*"):
        wake_us, worth_us, disabled = (
            machine.number(f"{folder}/{name}") for name in ("latency", "residency", "disable")
        )
        number = folder.rpartition("state")[2]
        if wake_us is not None and number.isdigit() and not disabled and (worth_us or 0) <= TICK_US:
            states.append(IdleState(int(number), machine.text(f"{folder}/name") or f"state {number}", wake_us))
    return states


def judge_load(machine: Machine, cpus: int) -> Finding:
    """Judge how many programs want to run on the CPUs."""
    load = machine.first_number("/proc/loadavg")
    share = None if load is None else load / cpus
    topic = Topic(SUBJECT, "load", "Load", {"load_1min": load, "load_per_cpu": share})
    if load is None or share is None:
        return topic.absent("this system does not tell")
    value = f"{load:.2g} on {cpus} CPUs in the last minute"
    if share <= BUSY:
        return topic.ok(value)
    return topic.find(
        Verdict.WARNING,
        value,
        "Other programs are busy; ticks wait for them, unless SCHED_FIFO is granted.",
        Step("See which, and end those that are not needed:", "ps -eo pcpu,pid,user,comm --sort=-pcpu | head"),
        scale=f"good: up to {BUSY:g} per CPU",
    )


def judge_stolen(machine: Machine) -> Finding:
    """Judge how much time the host of a virtual machine took from it since boot."""
    fields = (machine.text("/proc/stat") or "").partition("\n")[0].split()
    counts = [int(field) for field in fields[1:9] if field.isdigit()]
    share = None
    if len(counts) == 8:
        user, nice, system, _idle, _io_wait, irq, soft_irq, stolen = counts
        share = stolen / max(1, user + nice + system + irq + soft_irq + stolen)
    topic = Topic(SUBJECT, "stolen", "Time taken by host", {"stolen_share": share})
    if share is None:
        return topic.absent("this system does not tell")
    value = f"{share:.2%} of the busy time since boot"
    if share <= STOLEN:
        return topic.ok(value)
    return topic.find(
        Verdict.WARNING,
        value,
        "The host of this virtual machine has too few CPUs; nothing inside the machine prevents the stalls.",
        Step("Ask for dedicated (pinned) CPUs, or use a physical machine."),
        scale=f"good: up to {STOLEN:.0%}",
    )
