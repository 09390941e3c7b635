"""What the doctor says of a machine, on folders that stand for /proc and /sys."""

import socket
import tempfile

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.runtime.doctor.finding import Verdict
from hapticnet.runtime.doctor.limits import examine_limits
from hapticnet.runtime.doctor.machine import MEMORY_FOLDER, Machine, scratch_folder
from hapticnet.runtime.doctor.processor import judge_count, judge_governor, judge_idle, judge_load, judge_stolen
from hapticnet.runtime.doctor.scheduling import judge_budget, judge_scheduling, try_fifo
from hapticnet.runtime.doctor.sockets import examine_sockets, judge_buffer, judge_drops
from hapticnet.runtime.doctor.timing import (
    WallClock,
    judge_clock,
    judge_timer,
    judge_wall_clock,
    read_wall_clock,
    reading_cost_ns,
)
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES, listen, parse_host_port

OK, WARNING, PROBLEM, ABSENT = Verdict.OK, Verdict.WARNING, Verdict.PROBLEM, Verdict.ABSENT
CPU = "sys/devices/system/cpu"


@pytest.fixture
def machine(tmp_path):
    """Return a maker of machines with the given files."""

    def make(files=(), environ=()):
        for path, text in dict(files).items():
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text)
        return Machine(root=tmp_path, environ=dict(environ))

    return make


def commands(finding):
    return [step.command for step in finding.to_do if step.command]


def test_a_machine_without_any_of_these_files_is_no_error(machine):
    nothing = machine()
    findings = [
        judge_budget(nothing), judge_clock(nothing, 50.0), judge_governor(nothing), judge_idle(nothing),
        judge_load(nothing, 2), judge_stolen(nothing), judge_drops(nothing), *examine_limits(nothing),
    ]  # fmt: skip
    assert {finding.verdict for finding in findings} <= {OK, ABSENT}
    assert nothing.container is None


@pytest.mark.parametrize("text", ["", "nonsense", "\xff\x00", "1 2 3 4 5 6 7 8 9 10", "cpu 1 2", "Udp: A\nUdp: x\n"])
def test_files_with_something_else_in_them_are_no_error(machine, text):
    names = (
        "proc/loadavg", "proc/stat", "proc/meminfo", "proc/net/snmp", "proc/self/cgroup", "proc/cpuinfo",
        "proc/sys/kernel/sched_rt_runtime_us", f"{CPU}/cpu0/cpufreq/scaling_governor",
        f"{CPU}/cpu0/cpuidle/state0/latency",
    )  # fmt: skip
    odd = machine(dict.fromkeys(names, text))
    for finding in (
        judge_budget(odd), judge_clock(odd, 50.0), judge_governor(odd), judge_idle(odd), judge_load(odd, 2),
        judge_stolen(odd), judge_drops(odd), *examine_limits(odd),
    ):  # fmt: skip
        assert isinstance(finding.verdict, Verdict)
        assert finding.value


def test_a_scratch_folder_is_found_and_removed_or_missed_in_words(monkeypatch, tmp_path):
    def usual(**keywords):
        if keywords.get("dir") not in writable:
            raise FileNotFoundError("no usable temporary folder")
        return real(prefix="doctor-", dir=tmp_path)

    real = tempfile.TemporaryDirectory
    monkeypatch.setattr(tempfile, "TemporaryDirectory", usual)
    for place in (None, MEMORY_FOLDER):
        writable = [place]
        with scratch_folder() as folder:
            assert folder.parent == tmp_path
        assert not folder.exists()
    writable = []
    with pytest.raises(UnavailableError, match="TMPDIR=FOLDER"), scratch_folder():
        pass


def test_reading_stops_at_a_bound(machine):
    assert len(machine({"proc/big": "x" * 1_000_000}).text("/proc/big")) < 300_000


@pytest.mark.parametrize(
    ("resolution_s", "late_us", "verdict"),
    [(1e-9, 50.0, OK), (100e-6, 90.0, WARNING), (0.004, 2000.0, PROBLEM), (1e-9, None, PROBLEM)],
)
def test_a_timer_must_be_fine(resolution_s, late_us, verdict):
    finding = judge_timer(resolution_s, late_us, "this system has no timerfd")
    assert finding.verdict is verdict
    assert bool(finding.to_do) is (verdict is not OK)


def test_granted_real_time_scheduling_is_fine(machine):
    assert judge_scheduling(machine(), None).verdict is OK


STATUS = "Name:\tpython\nCapEff:\t{:016x}\n"


@pytest.mark.parametrize(
    ("files", "limits", "expected"),
    [
        ({}, (0, 0), "rtprio 10"),
        ({}, (0, 0), "setcap cap_sys_nice+ep"),
        ({}, (0, 99), "ulimit -r 10"),
        ({".dockerenv": ""}, (0, 0), "--cap-add SYS_NICE"),
        ({".dockerenv": ""}, (0, 0), "cap_add: [SYS_NICE]"),
        (
            {
                "proc/self/status": STATUS.format(1 << 23),
                "proc/self/cgroup": "3:cpu,cpuacct:/a/b\n",
                "sys/fs/cgroup/cpu,cpuacct/a/b/cpu.rt_runtime_us": "0",
            },
            (0, 0),
            "echo 950000 | sudo tee /sys/fs/cgroup/cpu,cpuacct/a/b/cpu.rt_runtime_us",
        ),
    ],
)
def test_refused_real_time_scheduling_names_what_grants_it_here(machine, files, limits, expected):
    finding = judge_scheduling(machine(files), "operation not permitted", limits)
    assert finding.verdict is WARNING
    assert "operation not permitted" in finding.value
    assert any(expected in command for command in commands(finding))


def test_where_the_account_may_and_the_kernel_refuses_no_right_is_advised(machine):
    for limits, status in (((99, 99), STATUS.format(0)), ((0, 0), STATUS.format(1 << 23))):
        finding = judge_scheduling(machine({"proc/self/status": status}), "operation not permitted", limits)
        assert not commands(finding)
        assert "CONFIG_RT_GROUP_SCHED" in finding.to_do[0].text


def test_trying_real_time_scheduling_leaves_no_trace():
    import os

    before = os.sched_getscheduler(0), os.sched_getparam(0)
    assert try_fifo() is None or isinstance(try_fifo(), str)
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == before


@pytest.mark.parametrize(
    ("runtime", "verdict"), [("950000", OK), ("-1", OK), ("500000", OK), ("100000", WARNING), ("0", WARNING)]
)
def test_the_real_time_budget_is_a_share(machine, runtime, verdict):
    files = {"proc/sys/kernel/sched_rt_runtime_us": runtime, "proc/sys/kernel/sched_rt_period_us": "1000000"}
    assert judge_budget(machine(files)).verdict is verdict


def test_a_slow_clock_is_named_with_what_replaces_it(machine):
    folder = "sys/devices/system/clocksource/clocksource0"
    slow = machine({f"{folder}/current_clocksource": "hpet\n", f"{folder}/available_clocksource": "tsc hpet acpi_pm\n"})
    finding = judge_clock(slow, 1500.0)
    assert finding.verdict is WARNING
    assert finding.value == "hpet, 1.5 µs per reading"
    assert commands(finding) == [f"echo tsc | sudo tee /{folder}/current_clocksource"]
    only = machine({f"{folder}/available_clocksource": "hpet acpi_pm\n"})
    assert "dmesg" in commands(judge_clock(only, 1500.0))[0]
    assert judge_clock(only, 100.0).verdict is OK


def test_the_time_of_day_is_read_and_judged():
    assert reading_cost_ns() > 0
    clock = read_wall_clock()
    assert clock is None or clock.max_error_us >= 0
    assert judge_wall_clock(WallClock(synchronised=True, max_error_us=1500)).verdict is OK
    assert judge_wall_clock(WallClock(synchronised=False, max_error_us=16_000_000)).verdict is WARNING
    assert judge_wall_clock(None).verdict is ABSENT


def test_one_cpu_is_too_few():
    assert judge_count(2, 8).verdict is OK
    assert commands(judge_count(1, 8)) == ["taskset -c 0-7 hapticnet …"]
    assert judge_count(1, 1).verdict is WARNING


def test_governors_are_counted(machine):
    files = {f"{CPU}/cpu{n}/cpufreq/scaling_governor": "powersave\n" for n in range(3)}
    assert judge_governor(machine(files)).value == "powersave on 3 of 3 CPUs"
    mixed = judge_governor(machine({f"{CPU}/cpu0/cpufreq/scaling_governor": "performance\n"}))
    assert mixed.value == "powersave on 2, performance on 1 of 3 CPUs"
    assert mixed.verdict is WARNING
    assert commands(mixed) == ["echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"]
    fast = machine({f"{CPU}/cpu{n}/cpufreq/scaling_governor": "performance\n" for n in range(3)})
    assert judge_governor(fast).verdict is OK


def state(number, name, latency, residency, disable="0"):
    folder = f"{CPU}/cpu0/cpuidle/state{number}"
    pairs = (("name", name), ("latency", latency), ("residency", residency), ("disable", disable))
    return {f"{folder}/{key}": str(value) for key, value in pairs}


def test_only_sleep_that_is_worth_it_between_two_ticks_counts(machine):
    deep = machine({**state(0, "POLL", 0, 0), **state(1, "C1", 2, 2), **state(4, "C10", 890, 5000)})
    assert judge_idle(deep).verdict is OK
    assert judge_idle(deep).value == "2 µs at most between ticks (C1)"
    slow = machine({**state(2, "C6", 400, 800), **state(3, "C7", 300, 900)})
    assert judge_idle(slow).verdict is WARNING
    folder = "/sys/devices/system/cpu/cpu*/cpuidle"
    assert commands(judge_idle(slow)) == [f"echo 1 | sudo tee {folder}/state2/disable {folder}/state3/disable"]
    forbidden = machine({**state(2, "C6", 400, 800, "1"), **state(3, "C7", 300, 900, "1")})
    assert judge_idle(forbidden).verdict is OK


def test_load_counts_per_cpu(machine):
    busy = machine({"proc/loadavg": "4.00 2.00 1.00 3/100 1234\n"})
    assert judge_load(busy, 8).verdict is OK
    assert judge_load(busy, 2).verdict is WARNING


@pytest.mark.parametrize(("stolen", "verdict"), [(0, OK), (5, OK), (500, WARNING)])
def test_time_taken_by_the_host_is_a_share_of_the_busy_time(machine, stolen, verdict):
    stat = machine({"proc/stat": f"cpu  500 0 500 99999 99999 0 0 {stolen} 0 0\ncpu0 …\n"})
    assert judge_stolen(stat).verdict is verdict


V2 = {"proc/self/cgroup": "0::/user.slice/app\n", "sys/fs/cgroup/cgroup.controllers": "cpu memory\n"}
V1 = {"proc/self/cgroup": "4:memory:/x\n2:cpu,cpuacct:/x\n0::/\n"}


@pytest.mark.parametrize(
    ("files", "cpu", "verdict"),
    [
        ({**V2, "sys/fs/cgroup/user.slice/app/cpu.max": "max 100000\n"}, "none", OK),
        ({**V2, "sys/fs/cgroup/user.slice/app/cpu.max": "200000 100000\n"}, "2 CPUs", OK),
        ({**V2, "sys/fs/cgroup/user.slice/app/cpu.max": "50000 100000\n"}, "0.5 CPUs", WARNING),
        (
            {
                **V2,
                "sys/fs/cgroup/user.slice/app/cpu.max": "max 100000\n",
                "sys/fs/cgroup/user.slice/cpu.max": "10000 100000\n",
                "sys/fs/cgroup/user.slice/cpu.stat": "nr_periods 10\nnr_throttled 7\n",
            },
            "0.1 CPUs; used up 7 times so far",
            PROBLEM,
        ),
        # In a container the path is that on the host: only the root of the mount is there.
        ({**V2, "sys/fs/cgroup/cpu.max": "50000 100000\n"}, "0.5 CPUs", WARNING),
        (
            {
                **V1,
                "sys/fs/cgroup/cpu,cpuacct/x/cpu.cfs_quota_us": "50000",
                "sys/fs/cgroup/cpu,cpuacct/x/cpu.cfs_period_us": "100000",
            },
            "0.5 CPUs",
            WARNING,
        ),
        ({**V1, "sys/fs/cgroup/cpu,cpuacct/x/cpu.cfs_quota_us": "-1"}, "none", OK),
    ],
)
def test_the_tightest_cpu_limit_of_all_control_groups_counts(machine, files, cpu, verdict):
    _, limit, _ = examine_limits(machine(files))
    assert (limit.value, limit.verdict) == (cpu, verdict)


@pytest.mark.parametrize(
    ("limit", "available", "value", "verdict"),
    [
        ("max", 8 << 20, "8 GiB available, no limit", OK),
        (str(512 << 20), 8 << 20, "8 GiB available, limit 512 MiB", OK),
        (str(128 << 20), 8 << 20, "8 GiB available, limit 128 MiB", WARNING),
        (str(64 << 20), 8 << 20, "8 GiB available, limit 64 MiB", PROBLEM),
        ("max", 50 << 10, "50 MiB available, no limit", PROBLEM),
    ],
)
def test_memory_is_bounded_by_limit_and_by_what_is_available(machine, limit, available, value, verdict):
    files = {**V2, "sys/fs/cgroup/user.slice/app/memory.max": limit, "proc/meminfo": f"MemAvailable: {available} kB\n"}
    *_, memory = examine_limits(machine(files))
    assert (memory.value, memory.verdict) == (value, verdict)


def test_a_limit_of_version_1_near_infinity_is_none(machine):
    files = {
        **V1,
        "sys/fs/cgroup/memory/x/memory.limit_in_bytes": str(2**63 - 4096),
        "proc/meminfo": "MemAvailable: 9999999 kB",
    }
    assert examine_limits(machine(files))[2].value.endswith("no limit")


@pytest.mark.parametrize(
    ("files", "environ", "kind"),
    [
        ({".dockerenv": ""}, {}, "docker"),
        ({"run/.containerenv": ""}, {}, "podman"),
        ({}, {"container": "lxc"}, "lxc"),
        ({"proc/self/cgroup": "0::/kubepods.slice/pod1/docker-abc\n"}, {}, "kubernetes"),
        ({"proc/self/cgroup": "0::/user.slice\n"}, {}, None),
    ],
)
def test_containers_are_recognised(machine, files, environ, kind):
    assert machine(files, environ).container == kind


def test_a_virtual_machine_is_recognised(machine):
    assert "virtual machine" in examine_limits(machine({"proc/cpuinfo": "flags\t\t: fpu hypervisor\n"}))[0].value


def test_the_kernel_doubles_what_it_grants():
    assert judge_buffer("receive", 2 * RECEIVE_BUFFER_BYTES, None).verdict is OK
    finding = judge_buffer("receive", 2 * 212_992, None)
    assert finding.verdict is WARNING
    assert finding.value == "208 KiB of the 4 MiB asked for; holds 512 datagrams"
    assert "512 ms" in finding.meaning
    assert commands(finding)[0] == f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}"
    assert "wmem_max" in commands(judge_buffer("send", 2 * 212_992, None))[0]
    assert "on the host" in judge_buffer("send", 2 * 212_992, "docker").to_do[0].text


@pytest.mark.parametrize(("dropped", "verdict"), [(0, OK), (1, OK), (100, WARNING)])
def test_dropped_datagrams_are_a_share(machine, dropped, verdict):
    snmp = f"Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors\nUdp: 10000 0 0 5 {dropped}\n"
    finding = judge_drops(machine({"proc/net/snmp": snmp}))
    assert finding.verdict is verdict
    assert finding.value == f"{dropped} of {10000 + dropped} since boot"


def test_the_receive_buffer_that_is_tested_is_the_one_that_a_slave_asks_for(monkeypatch):
    asked = []
    monkeypatch.setattr(socket.socket, "setsockopt", lambda _, _level, option, value: asked.append((option, value)))
    examine_sockets(Machine())
    listen(parse_host_port("127.0.0.1:0", lowest_port=0)).close()
    sizes = [value for option, value in asked if option == socket.SO_RCVBUF]
    assert sizes == [RECEIVE_BUFFER_BYTES, RECEIVE_BUFFER_BYTES]
