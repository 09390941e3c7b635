"""Scheduling class: whether SCHED_FIFO is granted, and what would grant it."""

import os
import shlex
import sys
from typing import Final

from hapticnet.runtime.doctor.finding import Figures, Finding, Step, Topic, Verdict, duration
from hapticnet.runtime.doctor.limits import control_group
from hapticnet.runtime.doctor.machine import Machine
from hapticnet.runtime.realtime import FIFO_PRIORITY

SUBJECT: Final = "timing"

CAP_SYS_NICE: Final = 23
"""Number of the capability in <linux/capability.h>."""

LEAST_SHARE: Final = 0.5
"""Share of a second that real-time processes should have. A master takes 7 % of a CPU."""


def try_fifo() -> str | None:
    """Take SCHED_FIFO for this thread for an instant; return why it was refused, or None."""
    if not sys.platform.startswith("linux"):
        return "this system does not have it"
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)  # 0 is the calling thread
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        return (error.strerror or str(error)).lower()
    os.sched_setscheduler(0, policy, parameters)
    return None


def judge_scheduling(
    machine: Machine, refusal: str | None, priority_limits: tuple[float, float] | None = None
) -> Finding:
    """Judge the scheduling class.

    Parameters
    ----------
    refusal
        Why SCHED_FIFO is refused; None: it is granted.
    priority_limits
        Soft and hard limit of real-time priorities; None: those of this process.
    """
    figures = {"fifo": refusal is None, "priority": FIFO_PRIORITY, "refusal": refusal}
    topic = Topic(SUBJECT, "scheduling", "Scheduling class", figures)
    if refusal is None:
        return topic.ok(f"SCHED_FIFO {FIFO_PRIORITY} is granted")
    return topic.find(
        Verdict.WARNING,
        f"SCHED_FIFO is refused: {refusal}",
        "Slave and master wait for other programs: on a busy machine, ticks are late or missed.",
        *_how_to_grant(machine, *(priority_limits or _priority_limits())),
    )


def _how_to_grant(machine: Machine, soft: float, hard: float) -> list[Step]:
    permitted = _has_capability(machine, CAP_SYS_NICE) or soft >= FIFO_PRIORITY
    if permitted:
        return [_how_to_get_a_budget(machine)]
    if machine.container:
        return [
            Step("Start the container with the capability SYS_NICE:", "docker run --cap-add SYS_NICE …"),
            Step("In compose.yaml:", "cap_add: [SYS_NICE]"),
            Step("If it does not run as root, also:", f"docker run --ulimit rtprio={FIFO_PRIORITY} …"),
        ]
    if hard >= FIFO_PRIORITY:
        return [Step("Raise the limit in the shell that starts hapticnet:", f"ulimit -r {FIFO_PRIORITY}")]
    file = "/etc/security/limits.d/90-hapticnet.conf"
    python = shlex.quote(os.path.realpath(sys.executable))
    return [
        Step(
            "Permit it for your account, then log out and in again:",
            f'echo "$USER - rtprio {FIFO_PRIORITY}" | sudo tee {file}',
        ),
        Step(f"In a systemd service instead: LimitRTPRIO={FIFO_PRIORITY}"),
        Step("Or permit it for this Python, so for every script it runs:", f"sudo setcap cap_sys_nice+ep {python}"),
    ]


def _how_to_get_a_budget(machine: Machine) -> Step:
    """Return what helps where the account may use SCHED_FIFO, and the kernel refuses all the same."""
    files = [f"{folder}/cpu.rt_runtime_us" for folder in control_group(machine, "cpu")]
    file = next((file for file in files if machine.exists(file)), None)
    if file is not None:
        return Step("Give this control group a real-time budget:", f"echo 950000 | sudo tee {file}")
    return Step(
        "This account may use SCHED_FIFO; a sandbox forbids it, or this kernel grants real time to control groups only"
        " (CONFIG_RT_GROUP_SCHED). Start hapticnet outside the sandbox, or boot with rt_group_sched=0."
    )


def _priority_limits() -> tuple[float, float]:
    """Return the soft and the hard limit of real-time priorities."""
    import resource  # not on every system

    if not hasattr(resource, "RLIMIT_RTPRIO"):
        return 0, 0
    soft, hard = (
        float("inf") if limit == resource.RLIM_INFINITY else limit
        for limit in resource.getrlimit(resource.RLIMIT_RTPRIO)
    )
    return soft, hard


def _has_capability(machine: Machine, number: int) -> bool:
    for line in (machine.text("/proc/self/status") or "").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> number & 1)
    return False


def judge_budget(machine: Machine) -> Finding:
    """Judge how much of each period the kernel lets real-time processes run."""
    runtime_us, period_us = (machine.number(f"/proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period"))
    figures: Figures = {"runtime_us": runtime_us, "period_us": period_us}
    topic = Topic(SUBJECT, "budget", "Real-time budget", figures)
    if runtime_us is None or not period_us:
        return topic.absent("this kernel does not tell")
    if runtime_us < 0:
        return topic.ok("unlimited (throttling is off)")
    share = runtime_us / period_us
    value = f"{share:.0%} of every {duration(period_us / 1e6)}"
    if share >= LEAST_SHARE:
        return topic.ok(value)
    return topic.find(
        Verdict.WARNING,
        value,
        "The kernel stops real-time processes for the rest of each period: a busy one misses many ticks in a row.",
        Step("Restore the default until the next boot:", "sudo sysctl -w kernel.sched_rt_runtime_us=950000"),
        scale=f"good: at least {LEAST_SHARE:.0%}; the default is 95%",
    )
