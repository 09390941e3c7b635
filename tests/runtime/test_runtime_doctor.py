"""What the doctor says of a machine by what was found, and of a trial by its report."""

import os
import socket

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.experiment.stability import Setup
from hapticnet.operator.yielding import HANDS
from hapticnet.runtime import doctor
from hapticnet.runtime.doctor import (
    Verdict,
    grade,
    granted_bytes,
    judge_buffer,
    judge_cpus,
    judge_scheduling,
    judge_stability,
    judge_trial,
    run_trial,
    try_fifo,
)
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES, listen, parse_host_port

OK, WARNING, PROBLEM = Verdict.OK, Verdict.WARNING, Verdict.PROBLEM


def commands(finding):
    return [step.command for step in finding.to_do if step.command]


def test_grades():
    assert [grade(value, 1.0, 5.0) for value in (1.0, 1.1, 5.0, 5.1)] == [OK, WARNING, WARNING, PROBLEM]


@pytest.mark.parametrize("expected", ["rtprio 10", "setcap cap_sys_nice+ep", "--cap-add SYS_NICE"])
def test_refused_real_time_scheduling_names_what_grants_it(expected):
    finding = judge_scheduling("operation not permitted", (0, 0))
    assert finding.verdict is WARNING
    assert "operation not permitted" in finding.value
    assert any(expected in command for command in commands(finding))
    assert commands(judge_scheduling("operation not permitted", (0, 99))) == ["ulimit -r 10"]


def test_where_the_account_may_and_the_kernel_refuses_no_right_is_advised():
    finding = judge_scheduling("operation not permitted", (99, 99))
    assert not commands(finding)
    assert "CONFIG_RT_GROUP_SCHED" in finding.to_do[0].text


def test_trying_real_time_scheduling_leaves_no_trace():
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    assert judge_scheduling(try_fifo(), (0, 0)).verdict in (OK, WARNING)
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == before


def test_one_cpu_is_too_few():
    assert judge_cpus(2, 8).verdict is OK
    assert commands(judge_cpus(1, 8)) == ["taskset -c 0-7 hapticnet …"]
    assert judge_cpus(1, 1).verdict is WARNING


def test_a_small_receive_buffer_is_named_with_the_command_that_raises_it():
    assert judge_buffer(RECEIVE_BUFFER_BYTES).verdict is OK
    finding = judge_buffer(212_992)
    assert (finding.verdict, finding.value) == (WARNING, "208 of the 4096 KiB asked for")
    assert commands(finding)[0] == f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}"


def test_the_receive_buffer_that_is_tested_is_the_one_that_a_slave_asks_for(monkeypatch):
    asked = []
    monkeypatch.setattr(socket.socket, "setsockopt", lambda _, _level, option, value: asked.append((option, value)))
    granted_bytes()
    listen(parse_host_port("127.0.0.1:0", lowest_port=0)).close()
    sizes = [value for option, value in asked if option == socket.SO_RCVBUF]
    assert sizes == [RECEIVE_BUFFER_BYTES, RECEIVE_BUFFER_BYTES]


def report(round_trip_us=370.0, late_us=120.0, missed=1, scheduling="SCHED_FIFO 10"):
    return {
        "round_trip": {"p50_us": 180.0, "p99_us": round_trip_us},
        "lateness": {"p50_us": 40.0, "p99_us": late_us},
        "ticks": 3000 - missed,
        "missed_ticks": missed,
        "scheduling": scheduling,
    }


@pytest.mark.parametrize(
    ("changes", "verdicts"),
    [
        ({}, ["ok", "ok", "ok"]),
        ({"round_trip_us": 1500.0}, ["warning", "ok", "ok"]),
        ({"round_trip_us": 9000.0}, ["problem", "ok", "ok"]),
        ({"late_us": 600.0}, ["ok", "warning", "ok"]),
        ({"late_us": 1500.0}, ["ok", "problem", "ok"]),
        ({"missed": 100}, ["ok", "ok", "warning"]),
        ({"missed": 1000}, ["ok", "ok", "problem"]),
    ],
)
def test_a_trial_is_judged_by_round_trip_lateness_and_missed_ticks(changes, verdicts):
    findings = judge_trial(report(**changes))
    assert [finding.verdict.value for finding in findings] == verdicts
    assert all(bool(finding.to_do and finding.meaning) is (finding.verdict is not OK) for finding in findings)


def test_bad_ticks_without_real_time_scheduling_ask_for_it_first():
    _, lateness, _ = judge_trial(report(late_us=2000.0, scheduling="SCHED_OTHER (SCHED_FIFO refused: it needs root)"))
    assert lateness.to_do[0].text.startswith("Permit SCHED_FIFO")
    assert lateness.value.endswith("SCHED_OTHER")


def test_a_slave_that_never_answers_is_a_problem():
    (finding,) = judge_trial(report(round_trip_us=None))
    assert finding.verdict is PROBLEM
    assert "the slave answered no position" in finding.value


@pytest.mark.parametrize("error", [OSError("no room"), UnavailableError("the slave ended"), KeyError("round_trip")])
def test_a_trial_that_fails_is_a_finding(monkeypatch, error):
    def fail():
        raise error

    monkeypatch.setattr(doctor, "run_trial", fail)
    (finding,) = doctor.examine_trial()
    assert finding.verdict is PROBLEM
    assert "no session over loopback" in finding.value


def test_a_trial_measures_whatever_keys_and_options_the_environment_names(monkeypatch):
    for name in ("KEY", "MASTERS", "PEER_KEY", "CONFIG"):
        monkeypatch.setenv(f"HAPTICNET_{name}", "/nowhere")
    measured = run_trial(0.2)
    assert measured["ticks"] + measured["missed_ticks"] > 50
    assert len(judge_trial(measured)) == 3


@pytest.mark.parametrize(
    ("hand", "round_trip_s", "scene", "verdict", "value"),
    [
        ("arm", 0.05, "paper", Verdict.WARNING, "above 150 N/m, at 3.1 Hz; paper has up to 500 N/m"),
        ("arm", 0.05, None, Verdict.OK, "above 150 N/m"),
        ("stiff-arm", 0.01, "paper", Verdict.OK, "paper has up to 500 N/m"),
        ("stiff-arm,damping=2", 0.01, "paper", Verdict.WARNING, "stiff-arm,damping=2, round trip 10 ms"),
        ("finger", 0.02, "phantom", Verdict.WARNING, "phantom has up to 400 N/m"),
        ("arm", 0.005, "example-viscous", Verdict.OK, "example-viscous has up to 640 N/m"),  # stiffer where it breaks
    ],
)
def test_a_hand_that_would_swing_against_the_scene_is_a_warning_with_what_helps(
    hand, round_trip_s, scene, verdict, value
):
    found = judge_stability(hand, round_trip_s, scene)
    assert found.verdict is verdict
    assert value in found.value
    commands = [step.command for step in found.to_do]
    assert any(f"--hand {hand} --delays {1e3 * round_trip_s:g}ms" in each for each in commands) is (
        verdict is Verdict.WARNING
    )


@pytest.mark.parametrize("hand", HANDS)
def test_the_closed_form_of_a_hand_holds_for_the_sampled_loop(hand):
    for round_trip_s in (0.0, 0.01, 0.05):
        exact = Setup(hand=HANDS[hand]).expected(round_trip_s)
        said = judge_stability(hand, round_trip_s, None).value
        assert float(said.partition("above ")[2].split()[0]) == pytest.approx(exact.stiffness_n_per_m, rel=0.05)
