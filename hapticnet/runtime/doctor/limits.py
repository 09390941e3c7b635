"""Container, and the limits that control groups set."""

from typing import Final, NamedTuple

from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict, size
from hapticnet.runtime.doctor.machine import Machine

SUBJECT: Final = "limits"

ENOUGH_CPUS: Final = 1.0
FEWEST_CPUS: Final = 0.25
"""CPUs that a control group must grant. A master takes 0.07 on average and three times that while it starts."""

ENOUGH_MEMORY_BYTES: Final = 256 * 2**20
LEAST_MEMORY_BYTES: Final = 96 * 2**20
"""Memory that should be free. A slave takes 60 MiB, and recordings grow."""

NO_LIMIT_BYTES: Final = 2**60
"""Version 1 of control groups writes "no limit" as a number near 2⁶³."""

CONTROL_GROUPS: Final = "/sys/fs/cgroup"


class CpuLimit(NamedTuple):
    """CPU time that a control group grants: CPUs on average, and how often it was used up."""

    cpus: float
    throttled_periods: int | None


def examine_limits(machine: Machine) -> list[Finding]:
    """Return the findings about container, CPU and memory limits."""
    return [
        judge_host(machine),
        judge_cpu_limit(cpu_limit(machine), machine.container),
        judge_memory(memory_limit(machine), available_memory(machine)),
    ]


def control_group(machine: Machine, controller: str) -> list[str]:
    """Return the folders of this process's control group, from its own to the root, as far as they exist."""
    for line in (machine.text("/proc/self/cgroup") or "").splitlines():
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controller in controllers.split(","):
            bases = [f"{CONTROL_GROUPS}/{controllers}", f"{CONTROL_GROUPS}/{controller}"]
            base = next((base for base in bases if machine.exists(base)), "")
        elif not controllers and machine.exists(f"{CONTROL_GROUPS}/cgroup.controllers"):
            base = CONTROL_GROUPS
        else:
            continue
        if base:
            parts = [part for part in path.split("/") if part not in ("", "..")]
            folders = ["/".join([base, *parts[:depth]]) for depth in range(len(parts), -1, -1)]
            # In a container, the path may be that on the host; then only the root is there.
            return [folder for folder in folders if machine.exists(folder)]
    return []


def cpu_limit(machine: Machine) -> CpuLimit | None:
    """Return the tightest CPU limit of this process; None if there is none."""
    tightest: CpuLimit | None = None
    for folder in control_group(machine, "cpu"):
        quota_us, period_us = _quota(machine, folder)
        if quota_us > 0 and period_us > 0 and (tightest is None or quota_us / period_us < tightest.cpus):
            tightest = CpuLimit(quota_us / period_us, _throttled(machine, folder))
    return tightest


def _quota(machine: Machine, folder: str) -> tuple[int, int]:
    fields = (machine.text(f"{folder}/cpu.max") or "").split()
    if len(fields) == 2 and all(field.isdigit() for field in fields):
        return int(fields[0]), int(fields[1])
    quota_us, period_us = (machine.number(f"{folder}/cpu.cfs_{name}_us") for name in ("quota", "period"))
    return quota_us or -1, period_us or -1


def _throttled(machine: Machine, folder: str) -> int | None:
    for line in (machine.text(f"{folder}/cpu.stat") or "").splitlines():
        name, _, number = line.partition(" ")
        if name == "nr_throttled" and number.isdigit():
            return int(number)
    return None


def memory_limit(machine: Machine) -> int | None:
    """Return the tightest memory limit of this process [B]; None if there is none."""
    limits = [
        limit
        for folder in control_group(machine, "memory")
        for name in ("memory.max", "memory.limit_in_bytes")
        if (limit := machine.number(f"{folder}/{name}")) is not None and limit < NO_LIMIT_BYTES
    ]
    return min(limits, default=None)


def available_memory(machine: Machine) -> int | None:
    """Return the memory that programs can still take [B]; None if the system does not tell."""
    for line in (machine.text("/proc/meminfo") or "").splitlines():
        name, _, rest = line.partition(":")
        if name == "MemAvailable" and rest.split() and rest.split()[0].isdigit():
            return int(rest.split()[0]) * 1024
    return None


def judge_host(machine: Machine) -> Finding:
    """Say whether this is a container or a virtual machine."""
    virtual = "hypervisor" in (machine.text("/proc/cpuinfo") or "").split()  # a flag of x86 processors
    kinds = [f"container ({machine.container})"] if machine.container else []
    kinds += ["virtual machine"] if virtual else []
    topic = Topic(SUBJECT, "host", "Kind of host", {"container": machine.container, "virtual_machine": virtual})
    return topic.ok(", ".join(kinds) or "no container, no virtual machine")


def judge_cpu_limit(limit: CpuLimit | None, container: str | None) -> Finding:
    """Judge the CPU limit of the control group."""
    figures = {"cpus": limit and limit.cpus, "throttled_periods": limit and limit.throttled_periods}
    topic = Topic(SUBJECT, "cpu", "CPU limit", figures)
    if limit is None:
        return topic.ok("none")
    value = f"{limit.cpus:.3g} CPUs"
    if limit.throttled_periods:
        value += f"; used up {limit.throttled_periods} times so far"
    if limit.cpus >= ENOUGH_CPUS:
        return topic.ok(value)
    step = Step("Raise CPUQuota= of its systemd service, or cpu.max of its control group.")
    if container:
        step = Step("Start the container with more, or without a limit:", "docker run --cpus 2 …")
    return topic.find(
        Verdict.WARNING if limit.cpus >= FEWEST_CPUS else Verdict.PROBLEM,
        value,
        "A process that has used up its share stands still for the rest of each period, up to 100 ms.",
        step,
        scale=f"good: at least {ENOUGH_CPUS:g} CPU; acceptable: {FEWEST_CPUS:g}",
    )


def judge_memory(limit: int | None, available: int | None) -> Finding:
    """Judge the memory limit and what is available [B]."""
    topic = Topic(SUBJECT, "memory", "Memory", {"limit_bytes": limit, "available_bytes": available})
    bounds = [bound for bound in (limit, available) if bound is not None]
    if not bounds:
        return topic.absent("this system does not tell")
    parts = [f"{size(available)} available"] if available is not None else []
    parts += [f"limit {size(limit)}" if limit is not None else "no limit"]
    value, least = ", ".join(parts), min(bounds)
    if least >= ENOUGH_MEMORY_BYTES:
        return topic.ok(value)
    step = Step("Raise the limit of the container or control group, such as with", "docker run --memory 512m …")
    if available == least:
        step = Step("End programs that are not needed; these take the most:", "ps -eo rss,pid,comm --sort=-rss | head")
    return topic.find(
        Verdict.WARNING if least >= LEAST_MEMORY_BYTES else Verdict.PROBLEM,
        value,
        "The kernel ends a process that runs out of memory, even in the middle of a session.",
        step,
        scale=f"good: at least {size(ENOUGH_MEMORY_BYTES)}; acceptable: {size(LEAST_MEMORY_BYTES)}",
    )
