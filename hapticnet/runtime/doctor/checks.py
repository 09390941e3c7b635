"""What the doctor looks at besides serial ports and a trial: timer, scheduling, CPUs, packages, buffers, simulator.

What the programs say by themselves when they start, with the command that helps, is left to them: keys, and Docker.
"""

import asyncio
import importlib.util
import os
import platform
import resource
import shlex
import socket
import statistics
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

from hapticnet.compiled import describe_core
from hapticnet.errors import HapticnetError, UnavailableError
from hapticnet.runtime.doctor.finding import Finding, Machine, Step, Verdict, duration, grade
from hapticnet.runtime.doctor.serial_ports import examine_serial
from hapticnet.runtime.nano import simavr_build
from hapticnet.runtime.serial_port import SerialSpec
from hapticnet.runtime.system import FIFO_PRIORITY, loop_factory, now_us
from hapticnet.runtime.timer import Alarm
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES

WITHIN_S: Final = 5.0
"""Time a probe has [s]."""

FINE_RESOLUTION_S: Final = 1e-6
COARSE_RESOLUTION_S: Final = 250e-6
"""A quarter of a tick at 1 kHz."""

RINGS: Final = 20
RING_AFTER_US: Final = 2000

CHEAP_READING_NS: Final = 500.0
"""Time [ns] to read the clock: about 100 where the processor has a counter, thousands from a chip (hpet, acpi_pm)."""

READINGS: Final = 2000
CLOCK_SOURCE: Final = "/sys/devices/system/clocksource/clocksource0"
GOVERNORS: Final = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"

ENOUGH_CPUS: Final = 1.0
FEWEST_CPUS: Final = 0.25
"""CPUs that a control group must grant. A master takes 0.07 on average and three times that while it starts."""

STOLEN: Final = 0.01
"""Share of the time in which this virtual machine wanted to run, and its host ran something else."""

MOST_DROPPED: Final = 0.001
"""Share of received datagrams that may have been dropped since boot."""

EXTRAS: Final = {
    "fast": "numba", "plot": "matplotlib", "mat": "scipy", "parquet": "pyarrow", "record": "mcap", "web": "aiohttp",
    "metrics": "prometheus_client",
}  # fmt: skip
"""Extras, and the module each brings."""


class Probe(NamedTuple):
    """Part of a check-up: its subject, what examines it, and how long that may take [s]."""

    subject: str
    examine: Callable[[], Sequence[Finding]]
    within_s: float = WITHIN_S


def probes(machine: Machine, *, serial: SerialSpec | None = None, simavr: bool = False) -> list[Probe]:
    """Return the probes in the order of the report.

    Parameters
    ----------
    serial
        The serial device that will be used; None: it is not known.
    simavr
        Whether the simulated device will be used.
    """
    return [
        Probe("timing", lambda: [_timer(), judge_scheduling(machine, try_fifo()), judge_clock(machine, reading_ns())]),
        Probe("processor", lambda: _processor(machine)),
        Probe("software", lambda: [judge_core(), judge_loop(), judge_extras()]),
        Probe("network", lambda: [judge_buffer(granted_bytes(), machine.container), judge_drops(machine)]),
        Probe("serial", lambda: examine_serial(machine, serial)),
        Probe("simulator", lambda: [judge_simulator(wanted=simavr)]),
    ]


def examine(probes: Sequence[Probe], on_start: Callable[[str], None] = lambda _: None) -> Iterator[Finding]:
    """Run the probes and yield their findings; tell each subject to `on_start` before it is examined."""
    for probe in probes:
        on_start(probe.subject)
        yield from _bounded(probe)


def _bounded(probe: Probe) -> list[Finding]:
    """Run a probe in a thread, which is left behind if it takes too long: a read of a driver cannot be cancelled."""
    findings: list[Finding] = []
    failures: list[str] = []

    def look() -> None:
        try:
            findings.extend(probe.examine())
        except HapticnetError as error:
            failures.append(str(error))
        except Exception as error:
            failures.append(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)

    thread = threading.Thread(target=look, name=f"doctor-{probe.subject}", daemon=True)
    thread.start()
    thread.join(probe.within_s)
    if thread.is_alive():
        findings, failures = [], [f"no answer within {probe.within_s:g} s"]
    return [
        *findings,
        *(
            Finding(
                f"{probe.subject}.probe",
                "Check-up",
                Verdict.WARNING,
                f"could not be completed: {failure}",
                "The rest of this subject is unknown.",
            )
            for failure in failures
        ),
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
    """Return how late timers ring [µs]."""
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
    if late_us is None:
        meaning = "Slave and master cannot run in real time here; virtual time and recordings still work."
        step = Step("Use a machine with Linux.")
        return Finding("timing.timer", "Timer", Verdict.PROBLEM, failure, meaning, (step,))
    verdict = grade(resolution_s, FINE_RESOLUTION_S, COARSE_RESOLUTION_S)
    value = f"timerfd, resolution {duration(resolution_s)}, rings {duration(late_us / 1e6)} late"
    if verdict is Verdict.OK:
        return Finding("timing.timer", "Timer", verdict, value)
    steps = (
        Step("Remove highres=off and nohz=off from the kernel's command line:", "cat /proc/cmdline"),
        Step("If they are not there, use a kernel with CONFIG_HIGH_RES_TIMERS."),
    )
    meaning = "The kernel has no high-resolution timers, so ticks are late."
    scale = f"good: resolution up to {duration(FINE_RESOLUTION_S)}; acceptable: {duration(COARSE_RESOLUTION_S)}"
    return Finding("timing.timer", "Timer", verdict, value, meaning, steps, scale)


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
    named = "timing.scheduling", "Scheduling class"
    if refusal is None:
        return Finding(*named, Verdict.OK, f"SCHED_FIFO {FIFO_PRIORITY} is granted")
    value = f"SCHED_FIFO is refused: {refusal}"
    meaning = "Slave and master wait for other programs: on a busy machine, ticks are late or missed."
    steps = _how_to_grant(machine, *(priority_limits or resource.getrlimit(resource.RLIMIT_RTPRIO)))
    return Finding(*named, Verdict.WARNING, value, meaning, steps)


def _how_to_grant(machine: Machine, soft: float, hard: float) -> tuple[Step, ...]:
    if soft >= FIFO_PRIORITY or soft == resource.RLIM_INFINITY:
        return (
            Step(
                "This account may use SCHED_FIFO; a sandbox forbids it, or this kernel grants real time to control"
                " groups only (CONFIG_RT_GROUP_SCHED): raise cpu.rt_runtime_us, or boot with rt_group_sched=0."
            ),
        )
    if machine.container:
        return (
            Step("Start the container with the capability SYS_NICE:", "docker run --cap-add SYS_NICE …"),
            Step("In compose.yaml:", "cap_add: [SYS_NICE]"),
            Step("If it does not run as root, also:", f"docker run --ulimit rtprio={FIFO_PRIORITY} …"),
        )
    if hard >= FIFO_PRIORITY or hard == resource.RLIM_INFINITY:
        return (Step("Raise the limit in the shell that starts hapticnet:", f"ulimit -r {FIFO_PRIORITY}"),)
    file = "/etc/security/limits.d/90-hapticnet.conf"
    python = shlex.quote(os.path.realpath(sys.executable))
    return (
        Step(
            "Permit it for your account, then log out and in again:",
            f'echo "$USER - rtprio {FIFO_PRIORITY}" | sudo tee {file}',
        ),
        Step(f"In a systemd service instead: LimitRTPRIO={FIFO_PRIORITY}"),
        Step("Or permit it for this Python, so for every script it runs:", f"sudo setcap cap_sys_nice+ep {python}"),
    )


def reading_ns() -> float:
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
    named, value = (
        ("timing.clock", "Monotonic clock"),
        f"{source or 'unknown source'}, {duration(cost_ns / 1e9)} per reading",
    )
    if cost_ns <= CHEAP_READING_NS:
        return Finding(*named, Verdict.OK, value)
    step = Step("See why the kernel does not use the processor's counter:", "sudo dmesg | grep -i clocksource")
    if source != "tsc" and "tsc" in (available or "").split():
        command = f"echo tsc | sudo tee {CLOCK_SOURCE}/current_clocksource"
        step = Step("Use the processor's counter until the next boot:", command)
    meaning = "Every tick and every datagram reads the clock several times."
    scale = f"good: up to {duration(CHEAP_READING_NS / 1e9)} per reading"
    return Finding(*named, Verdict.WARNING, value, meaning, (step,), scale)


def _processor(machine: Machine) -> list[Finding]:
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    return [judge_cpus(usable, total), judge_limit(machine), judge_governor(machine), judge_stolen(machine)]


def judge_cpus(usable: int, total: int) -> Finding:
    """Judge the number of CPUs this process may use, of those there are."""
    named, value = ("processor.count", "CPUs"), str(usable) if usable == total else f"{usable} of {total} may be used"
    if usable > 1:
        return Finding(*named, Verdict.OK, value)
    step = Step("Give the machine or container two.")
    if total > usable:
        step = Step("Give hapticnet more CPUs:", f"taskset -c 0-{total - 1} hapticnet …")
    return Finding(*named, Verdict.WARNING, value, "Ticks wait for whatever else runs on the only CPU.", (step,))


def judge_limit(machine: Machine) -> Finding:
    """Judge the CPU limit of this process's control group, or of the container's root."""
    named = "processor.limit", "CPU limit"
    groups = (machine.text("/proc/self/cgroup") or "").splitlines()
    own = next((line.removeprefix("0::").rstrip("/") for line in groups if line.startswith("0::")), "")
    limits = (machine.text(f"/sys/fs/cgroup{folder}/cpu.max") for folder in (own, ""))
    fields = next((text.split() for text in limits if text), [])
    if len(fields) != 2 or not all(each.isdigit() and int(each) for each in fields):
        return Finding(*named, Verdict.OK, "none")
    cpus = int(fields[0]) / int(fields[1])
    if cpus >= ENOUGH_CPUS:
        return Finding(*named, Verdict.OK, f"{cpus:.3g} CPUs")
    verdict = Verdict.WARNING if cpus >= FEWEST_CPUS else Verdict.PROBLEM
    meaning = "A process that has used up its share stands still for the rest of each period, up to 100 ms."
    step = Step("Give it more: CPUQuota= of a systemd service, or", "docker run --cpus 2 …")
    scale = f"good: at least {ENOUGH_CPUS:g} CPU; acceptable: {FEWEST_CPUS:g}"
    return Finding(*named, verdict, f"{cpus:.3g} CPUs", meaning, (step,), scale)


def judge_governor(machine: Machine) -> Finding:
    """Judge how the CPUs choose their frequency."""
    names = Counter(machine.text(path) or "unknown" for path in machine.glob(GOVERNORS.replace("cpu*", "cpu[0-9]*")))
    named, value = (
        ("processor.governor", "Frequency governor"),
        ", ".join(f"{n} on {k}" for n, k in names.most_common()),
    )
    if not names:
        return Finding(*named, Verdict.ABSENT, "none; firmware or host chooses the frequency")
    if set(names) == {"performance"}:
        return Finding(*named, Verdict.OK, value)
    meaning = "Between ticks the CPUs slow down, and each tick starts on a slow CPU."
    step = Step("Keep them fast until the next boot:", f"echo performance | sudo tee {GOVERNORS}")
    return Finding(*named, Verdict.WARNING, value, meaning, (step,))


def judge_stolen(machine: Machine) -> Finding:
    """Judge how much time the host of a virtual machine took from it since boot."""
    named = "processor.stolen", "Time taken by host"
    fields = (machine.text("/proc/stat") or "").partition("\n")[0].split()
    counts = [int(field) for field in fields[1:9] if field.isdigit()]
    if len(counts) != 8:
        return Finding(*named, Verdict.ABSENT, "this system does not tell")
    user, nice, system, _idle, _io_wait, irq, soft_irq, stolen = counts
    share = stolen / max(1, user + nice + system + irq + soft_irq + stolen)
    value, scale = f"{share:.2%} of the busy time since boot", f"good: up to {STOLEN:.0%}"
    if share <= STOLEN:
        return Finding(*named, Verdict.OK, value)
    meaning = "The host of this virtual machine has too few CPUs; nothing inside the machine prevents the stalls."
    step = Step("Ask for dedicated (pinned) CPUs, or use a physical machine.")
    return Finding(*named, Verdict.WARNING, value, meaning, (step,), scale)


def judge_core() -> Finding:
    """Say which Python and which core of hapticnet run."""
    value = f"{platform.python_implementation()} {platform.python_version()}, {sys.executable}; {describe_core()}"
    return Finding("software.python", "Python", Verdict.OK, value)


def judge_loop() -> Finding:
    """Judge the event loop."""
    if importlib.util.find_spec("uvloop") is not None:
        return Finding("software.loop", "Event loop", Verdict.OK, "uvloop")
    meaning = "Ticks are about a fifth later, and receiving costs more CPU."
    value = "asyncio's own, because uvloop is missing"
    return Finding("software.loop", "Event loop", Verdict.WARNING, value, meaning, (_install("uvloop"),))


def judge_extras() -> Finding:
    """List the extras that are installed, and those that are not."""
    there = [extra for extra, module in EXTRAS.items() if importlib.util.find_spec(module) is not None]
    missing = [extra for extra in EXTRAS if extra not in there]
    named, value = ("software.extras", "Extras"), f"installed: {', '.join(there) or 'none'}"
    if not missing:
        return Finding(*named, Verdict.OK, value)
    packages = [EXTRAS[extra].replace("_", "-") for extra in missing]
    return Finding(*named, Verdict.ABSENT, f"{value}; missing: {', '.join(missing)}", "", (_install(*packages),))


def _install(*packages: str) -> Step:
    return Step("Install:", shlex.join([sys.executable, "-m", "pip", "install", *packages]))


def granted_bytes() -> int:
    """Return the receive buffer that a slave is granted [B]. The kernel says twice that, for its bookkeeping."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def judge_buffer(granted: int, container: str | None) -> Finding:
    """Judge the receive buffer by what was granted [B]."""
    named, asked = ("network.receive_buffer", "Receive buffer"), RECEIVE_BUFFER_BYTES
    if granted >= asked:
        return Finding(*named, Verdict.OK, f"{granted // 1024} KiB, as asked for")
    setting = f"net.core.rmem_max={asked}"
    return Finding(
        *named,
        Verdict.WARNING,
        f"{granted // 1024} of the {asked // 1024} KiB asked for",
        "A slave with many masters that stands still for a moment loses datagrams.",
        (
            Step(
                f"Raise the limit{' on the host' if container else ''} until the next boot:",
                f"sudo sysctl -w {setting}",
            ),
            Step("And for good:", f"echo {setting} | sudo tee /etc/sysctl.d/90-hapticnet.conf"),
        ),
    )


def judge_drops(machine: Machine) -> Finding:
    """Judge the datagrams that the kernel dropped since boot because a program read them too late."""
    named = "network.drops", "Dropped datagrams"
    rows = [line.split()[1:] for line in (machine.text("/proc/net/snmp") or "").splitlines() if line.startswith("Udp:")]
    counters = dict(zip(*rows, strict=False)) if len(rows) == 2 else {}
    received, dropped = (counters.get(name, "") for name in ("InDatagrams", "RcvbufErrors"))
    if not received.isdigit() or not dropped.isdigit():
        return Finding(*named, Verdict.ABSENT, "this system does not tell")
    total = int(received) + int(dropped)
    value, scale = f"{dropped} of {total} since boot", f"good: up to {MOST_DROPPED:.1%}"
    if int(dropped) <= MOST_DROPPED * total:
        return Finding(*named, Verdict.OK, value)
    meaning = "Some program, not necessarily hapticnet, read its datagrams too late, and its buffer was full."
    step = Step("List the sockets; after skmem, the number after d counts drops:", "ss -uamp")
    return Finding(*named, Verdict.WARNING, value, meaning, (step,), scale)


def judge_simulator(*, wanted: bool) -> Finding:
    """Tell whether the firmware and its simulator are built; `wanted`: --device simavr will be used."""
    named = "simulator.simulator", "Simulated device"
    try:
        simavr_build()
    except UnavailableError as error:
        verdict = Verdict.PROBLEM if wanted else Verdict.ABSENT
        value = str(error) if wanted else "not built; needed for --device simavr only"
        return Finding(*named, verdict, value, "", (Step("In a checkout, build it:", "make simulator"),))
    return Finding(*named, Verdict.OK, "built")
