"""Timer and clocks."""

import asyncio
import ctypes
import statistics
import time
from typing import Final, NamedTuple

from hapticnet.errors import UnavailableError
from hapticnet.runtime.clock import now_us
from hapticnet.runtime.doctor.finding import Finding, Step, Topic, Verdict, duration, grade
from hapticnet.runtime.doctor.machine import Machine
from hapticnet.runtime.doctor.scheduling import judge_budget, judge_scheduling, try_fifo
from hapticnet.runtime.realtime import loop_factory
from hapticnet.runtime.timer import Alarm

SUBJECT: Final = "timing"

FINE_RESOLUTION_S: Final = 1e-6
COARSE_RESOLUTION_S: Final = 250e-6
"""A quarter of a tick at 1 kHz."""

RINGS: Final = 20
RING_AFTER_US: Final = 2000

CHEAP_READING_NS: Final = 500.0
"""Time [ns] to read the clock: about 100 where the processor has a counter, thousands from a chip (hpet, acpi_pm)."""

READINGS: Final = 2000

CLOCK_SOURCE: Final = "/sys/devices/system/clocksource/clocksource0"

STA_UNSYNC: Final = 0x40
"""Status bit of adjtimex(2): no program keeps the clock in step with others."""


def examine_timing(machine: Machine) -> list[Finding]:
    """Return the findings about timer, scheduling class and clocks."""
    return [
        _timer(),
        judge_scheduling(machine, try_fifo()),
        judge_budget(machine),
        judge_clock(machine, reading_cost_ns()),
        judge_wall_clock(read_wall_clock()),
    ]


def _timer() -> Finding:
    resolution_s = time.clock_getres(time.CLOCK_MONOTONIC)
    try:
        with asyncio.Runner(loop_factory=loop_factory()) as runner:
            late_us = statistics.median(runner.run(_ring()))
    except UnavailableError as error:
        return judge_timer(resolution_s, None, str(error))
    except TimeoutError:
        return judge_timer(resolution_s, None, "a timer that was set did not ring")
    return judge_timer(resolution_s, late_us)


async def _ring() -> list[int]:
    """Set a timer a few times; return how late it rang each time [µs]."""
    loop = asyncio.get_running_loop()
    late_us: list[int] = []
    for _ in range(RINGS):
        rang = asyncio.Event()
        alarm = Alarm(loop, rang.set)
        due_us = now_us() + RING_AFTER_US
        try:
            alarm.set(due_us)
            await asyncio.wait_for(rang.wait(), 1.0)
            late_us.append(now_us() - due_us)
        finally:
            alarm.stop()
    return late_us


def judge_timer(resolution_s: float, late_us: float | None, failure: str = "") -> Finding:
    """Judge the timer by the clock's resolution [s] and by how late it rings [µs]; None: it does not work."""
    topic = Topic(SUBJECT, "timer", "Timer", {"resolution_ns": resolution_s * 1e9, "late_p50_us": late_us})
    if late_us is None:
        return topic.find(
            Verdict.PROBLEM,
            failure,
            "Slave and master cannot run in real time here; virtual time and recordings still work.",
            Step("Use a machine with Linux."),
        )
    verdict = grade(resolution_s, FINE_RESOLUTION_S, COARSE_RESOLUTION_S)
    value = f"timerfd, resolution {duration(resolution_s)}, rings {duration(late_us / 1e6)} late"
    if verdict is Verdict.OK:
        return topic.ok(value)
    return topic.find(
        verdict,
        value,
        "The kernel has no high-resolution timers, so ticks are late.",
        Step("Remove highres=off and nohz=off from the kernel's command line:", "cat /proc/cmdline"),
        Step("If they are not there, use a kernel with CONFIG_HIGH_RES_TIMERS."),
        scale=f"good: resolution up to {duration(FINE_RESOLUTION_S)}; acceptable: {duration(COARSE_RESOLUTION_S)}",
    )


def reading_cost_ns() -> float:
    """Return how long it takes to read the monotonic clock [ns], at best."""
    best = float("inf")
    for _ in range(5):
        start = time.perf_counter_ns()
        for _ in range(READINGS):
            time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        best = min(best, (time.perf_counter_ns() - start) / READINGS)
    return best


def judge_clock(machine: Machine, cost_ns: float) -> Finding:
    """Judge the source of the monotonic clock by what a reading costs [ns]."""
    source, available = (machine.text(f"{CLOCK_SOURCE}/{name}_clocksource") for name in ("current", "available"))
    figures = {"source": source, "available": available, "reading_ns": cost_ns}
    topic = Topic(SUBJECT, "clock", "Monotonic clock", figures)
    value = f"{source or 'unknown source'}, {duration(cost_ns / 1e9)} per reading"
    if cost_ns <= CHEAP_READING_NS:
        return topic.ok(value)
    step = Step("See why the kernel does not use the processor's counter:", "sudo dmesg | grep -i clocksource")
    if source != "tsc" and "tsc" in (available or "").split():
        command = f"echo tsc | sudo tee {CLOCK_SOURCE}/current_clocksource"
        step = Step("Use the processor's counter until the next boot:", command)
    return topic.find(
        Verdict.WARNING,
        value,
        "Every tick and every datagram reads the clock several times.",
        step,
        scale=f"good: up to {duration(CHEAP_READING_NS / 1e9)} per reading",
    )


class WallClock(NamedTuple):
    """What the kernel knows about the time of day: in step with others or not, and the largest error [µs]."""

    synchronised: bool
    max_error_us: int


class _Timex(ctypes.Structure):
    """The start of struct timex of adjtimex(2); the rest is room for what follows."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


def read_wall_clock() -> WallClock | None:
    """Return the state of the time of day, without changing it; None if the system does not tell."""
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    state = _Timex()  # modes = 0: read only
    if adjtimex(ctypes.byref(state)) < 0:
        return None
    return WallClock(not state.status & STA_UNSYNC, state.maxerror)


def judge_wall_clock(clock: WallClock | None) -> Finding:
    """Judge whether the time of day is in step with other machines."""
    figures = {"synchronised": clock and clock.synchronised, "max_error_us": clock and clock.max_error_us}
    topic = Topic(SUBJECT, "time_of_day", "Time of day", figures)
    if clock is None:
        return topic.absent("this system does not tell whether it is synchronised")
    if clock.synchronised:
        return topic.ok(f"synchronised, error at most {duration(clock.max_error_us / 1e6)}")
    return topic.find(
        Verdict.WARNING,
        "not synchronised with other machines (NTP)",
        "Sessions do not need it, but the dates in the reports of two hosts may disagree.",
        Step("Switch synchronisation on:", "sudo timedatectl set-ntp true"),
    )
