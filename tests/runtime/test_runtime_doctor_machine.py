"""What the doctor says of a machine, on folders that stand for /proc and /sys."""

import re
import socket
import tempfile
import tomllib

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.runtime.doctor.checks import (
    EXTRAS,
    granted_bytes,
    judge_buffer,
    judge_clock,
    judge_cpus,
    judge_drops,
    judge_extras,
    judge_governor,
    judge_limit,
    judge_loop,
    judge_scheduling,
    judge_simulator,
    judge_stolen,
    judge_timer,
    reading_ns,
    try_fifo,
)
from hapticnet.runtime.doctor.finding import MEMORY_FOLDER, Machine, Verdict, scratch_folder
from hapticnet.runtime.nano import BUILD_VARIABLE
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES, listen, parse_host_port
from tests.ready import ROOT

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
    findings = [judge(nothing) for judge in (judge_limit, judge_governor, judge_stolen, judge_drops)]
    findings.append(judge_clock(nothing, 50.0))
    assert {finding.verdict for finding in findings} <= {OK, ABSENT}
    assert nothing.container is None


@pytest.mark.parametrize("text", ["", "nonsense", "\xff\x00", "1 2 3 4 5 6 7 8 9 10", "cpu 1 2", "Udp: A\nUdp: x\n"])
def test_files_with_something_else_in_them_are_no_error(machine, text):
    names = ("proc/stat", "proc/net/snmp", "proc/self/cgroup", "sys/fs/cgroup/cpu.max")
    odd = machine(dict.fromkeys((*names, f"{CPU}/cpu0/cpufreq/scaling_governor"), text))
    for finding in (
        judge_clock(odd, 50.0),
        *(judge(odd) for judge in (judge_limit, judge_governor, judge_stolen, judge_drops)),
    ):
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


@pytest.mark.parametrize(
    ("files", "limits", "expected"),
    [
        ({}, (0, 0), "rtprio 10"),
        ({}, (0, 0), "setcap cap_sys_nice+ep"),
        ({}, (0, 99), "ulimit -r 10"),
        ({".dockerenv": ""}, (0, 0), "--cap-add SYS_NICE"),
        ({".dockerenv": ""}, (0, 0), "cap_add: [SYS_NICE]"),
    ],
)
def test_refused_real_time_scheduling_names_what_grants_it_here(machine, files, limits, expected):
    finding = judge_scheduling(machine(files), "operation not permitted", limits)
    assert finding.verdict is WARNING
    assert "operation not permitted" in finding.value
    assert any(expected in command for command in commands(finding))


def test_where_the_account_may_and_the_kernel_refuses_no_right_is_advised(machine):
    finding = judge_scheduling(machine(), "operation not permitted", (99, 99))
    assert not commands(finding)
    assert "CONFIG_RT_GROUP_SCHED" in finding.to_do[0].text


def test_trying_real_time_scheduling_leaves_no_trace():
    import os

    before = os.sched_getscheduler(0), os.sched_getparam(0)
    assert try_fifo() is None or isinstance(try_fifo(), str)
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == before


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
    assert reading_ns() > 0


def test_one_cpu_is_too_few():
    assert judge_cpus(2, 8).verdict is OK
    assert commands(judge_cpus(1, 8)) == ["taskset -c 0-7 hapticnet …"]
    assert judge_cpus(1, 1).verdict is WARNING


def test_governors_are_counted(machine):
    files = {f"{CPU}/cpu{n}/cpufreq/scaling_governor": "powersave\n" for n in range(3)}
    assert judge_governor(machine(files)).value == "powersave on 3"
    mixed = judge_governor(machine({f"{CPU}/cpu0/cpufreq/scaling_governor": "performance\n"}))
    assert mixed.value == "powersave on 2, performance on 1"
    assert mixed.verdict is WARNING
    assert commands(mixed) == ["echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"]
    fast = machine({f"{CPU}/cpu{n}/cpufreq/scaling_governor": "performance\n" for n in range(3)})
    assert judge_governor(fast).verdict is OK


@pytest.mark.parametrize(("stolen", "verdict"), [(0, OK), (5, OK), (500, WARNING)])
def test_time_taken_by_the_host_is_a_share_of_the_busy_time(machine, stolen, verdict):
    stat = machine({"proc/stat": f"cpu  500 0 500 99999 99999 0 0 {stolen} 0 0\ncpu0 …\n"})
    assert judge_stolen(stat).verdict is verdict


@pytest.mark.parametrize(
    ("files", "cpu", "verdict"),
    [
        ({"sys/fs/cgroup/user.slice/app/cpu.max": "max 100000\n"}, "none", OK),
        ({"sys/fs/cgroup/user.slice/app/cpu.max": "200000 100000\n"}, "2 CPUs", OK),
        ({"sys/fs/cgroup/user.slice/app/cpu.max": "50000 100000\n"}, "0.5 CPUs", WARNING),
        # In a container the path is that on the host: only the root of the mount is there.
        ({"sys/fs/cgroup/cpu.max": "10000 100000\n"}, "0.1 CPUs", PROBLEM),
    ],
)
def test_the_cpu_limit_of_the_control_group_counts(machine, files, cpu, verdict):
    limit = judge_limit(machine({"proc/self/cgroup": "0::/user.slice/app\n", **files}))
    assert (limit.value, limit.verdict) == (cpu, verdict)


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


def test_a_small_receive_buffer_is_named_with_the_command_that_raises_it():
    assert judge_buffer(RECEIVE_BUFFER_BYTES, None).verdict is OK
    finding = judge_buffer(212_992, None)
    assert (finding.verdict, finding.value) == (WARNING, "208 of the 4096 KiB asked for")
    assert commands(finding)[0] == f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}"
    assert "on the host" in judge_buffer(212_992, "docker").to_do[0].text


@pytest.mark.parametrize(("dropped", "verdict"), [(0, OK), (1, OK), (100, WARNING)])
def test_dropped_datagrams_are_a_share(machine, dropped, verdict):
    snmp = f"Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors\nUdp: 10000 0 0 5 {dropped}\n"
    finding = judge_drops(machine({"proc/net/snmp": snmp}))
    assert finding.verdict is verdict
    assert finding.value == f"{dropped} of {10000 + dropped} since boot"


def test_the_receive_buffer_that_is_tested_is_the_one_that_a_slave_asks_for(monkeypatch):
    asked = []
    monkeypatch.setattr(socket.socket, "setsockopt", lambda _, _level, option, value: asked.append((option, value)))
    granted_bytes()
    listen(parse_host_port("127.0.0.1:0", lowest_port=0)).close()
    sizes = [value for option, value in asked if option == socket.SO_RCVBUF]
    assert sizes == [RECEIVE_BUFFER_BYTES, RECEIVE_BUFFER_BYTES]


def test_missing_packages_come_with_the_command_that_installs_them(monkeypatch):
    found = {"uvloop": None, "numba": None}
    monkeypatch.setattr("importlib.util.find_spec", lambda name: found.get(name, object()))
    assert judge_loop().verdict is WARNING
    assert judge_loop().to_do[0].command.endswith("-m pip install uvloop")
    extras = judge_extras()
    assert (extras.verdict, commands(extras)[0].endswith("-m pip install numba")) == (ABSENT, True)
    assert "missing: fast" in extras.value
    found.clear()
    assert (judge_loop().verdict, judge_extras().verdict) == (OK, OK)


def test_every_extra_of_one_package_is_looked_for():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    single = {name: re.split("[<>=]", packages[0])[0] for name, packages in extras.items() if len(packages) == 1}
    modules = {name: package.replace("-", "_") for name, package in single.items()}
    assert {name: modules[name] for name in EXTRAS} == EXTRAS


def test_a_simulator_is_missed_only_by_who_uses_it(monkeypatch, tmp_path):
    monkeypatch.setenv(BUILD_VARIABLE, str(tmp_path))
    assert judge_simulator(wanted=False).verdict is ABSENT
    assert judge_simulator(wanted=True).verdict is PROBLEM
    assert commands(judge_simulator(wanted=True)) == ["make simulator"]
