"""The doctor's check-up ends whatever a probe does; its report has one form; the trial is judged by its figures."""

import json
import threading
import time

import pytest

from hapticnet.errors import UnavailableError
from hapticnet.runtime.doctor import trial
from hapticnet.runtime.doctor.checks import Probe, examine, probes
from hapticnet.runtime.doctor.finding import SCHEMA, Finding, Machine, Step, Verdict, as_json, duration, grade
from hapticnet.runtime.doctor.trial import Trial, judge_trial, read_report, run_trial

FINE = Finding("timing.timer", "Timer", Verdict.OK, "fine")


def raises():
    raise ValueError("no such thing")


def test_a_probe_that_raises_becomes_a_finding_and_the_others_go_on():
    good = Probe("network", lambda: [FINE])
    failed, fine = examine([Probe("serial", raises), good])
    assert (failed.verdict, failed.subject) == (Verdict.WARNING, "serial")
    assert failed.value == "could not be completed: ValueError: no such thing"
    assert fine.verdict is Verdict.OK


def test_a_probe_that_hangs_becomes_a_finding():
    hold = threading.Event()
    try:
        (finding,) = examine([Probe("serial", lambda: [FINE] if hold.wait(60) else [], 0.05)])
        assert (finding.verdict, finding.value) == (
            Verdict.WARNING,
            "could not be completed: no answer within 0.05 s",
        )
    finally:
        hold.set()


def test_subjects_are_announced_in_order():
    announced = []
    found = list(examine([Probe("a", list), Probe("b", list)], announced.append))
    assert (announced, found) == (["a", "b"], [])


def test_every_probe_is_bounded_in_time():
    assert all(0 < probe.within_s <= 30 for probe in probes(Machine()))


def test_the_report_for_programs_keeps_its_form():
    findings = [
        FINE,
        Finding(
            "timing.clock", "Clock", Verdict.WARNING, "so so", "Slow.", (Step("Wait."), Step("Or:", "true")), "good: 1"
        ),
        FINE._replace(verdict=Verdict.ABSENT),
    ]
    report = json.loads(json.dumps(as_json(findings)))
    assert SCHEMA == 2
    assert {key: report[key] for key in ("schema", "ready", "counts")} == {
        "schema": 2,
        "ready": True,
        "counts": {"ok": 1, "warning": 1, "problem": 0, "not present": 1},
    }
    assert report["findings"][1] == {
        "id": "timing.clock",
        "title": "Clock",
        "verdict": "warning",
        "value": "so so",
        "meaning": "Slow.",
        "to_do": [{"text": "Wait.", "command": None}, {"text": "Or:", "command": "true"}],
        "scale": "good: 1",
    }
    assert not as_json([*findings, FINE._replace(verdict=Verdict.PROBLEM)])["ready"]


def test_grades_and_units():
    assert [grade(value, 1.0, 5.0) for value in (1.0, 1.1, 5.0, 5.1)] == [
        Verdict.OK, Verdict.WARNING, Verdict.WARNING, Verdict.PROBLEM,
    ]  # fmt: skip
    assert [duration(seconds) for seconds in (0, 1e-9, 1.5e-6, 0.25, 60)] == [
        "0 ns",
        "1 ns",
        "1.5 µs",
        "250 ms",
        "60 s",
    ]


GOOD = Trial("SCHED_FIFO 10", 180.0, 370.0, 40.0, 120.0, 2999, 1, 2999)


@pytest.mark.parametrize(
    ("changes", "verdicts"),
    [
        ({}, ["ok", "ok", "ok"]),
        ({"round_trip_p99_us": 1500.0}, ["warning", "ok", "ok"]),
        ({"round_trip_p99_us": 9000.0}, ["problem", "ok", "ok"]),
        ({"late_p99_us": 600.0}, ["ok", "warning", "ok"]),
        ({"late_p99_us": 1500.0}, ["ok", "problem", "ok"]),
        ({"ticks": 2900, "missed": 100}, ["ok", "ok", "warning"]),
        ({"ticks": 2000, "missed": 1000}, ["ok", "ok", "problem"]),
    ],
)
def test_a_trial_is_judged_by_round_trip_lateness_and_missed_ticks(changes, verdicts):
    findings = judge_trial(GOOD._replace(**changes))
    assert [finding.verdict.value for finding in findings] == verdicts
    assert all(finding.scale for finding in findings)
    assert all(finding.to_do and finding.meaning for finding in findings if finding.verdict is not Verdict.OK)


def test_bad_ticks_without_real_time_scheduling_ask_for_it_first():
    refused = "SCHED_OTHER (SCHED_FIFO refused: it needs root)"
    _, lateness, _ = judge_trial(GOOD._replace(late_p99_us=2000.0, scheduling=refused))
    assert lateness.to_do[0] == trial.GRANT_FIFO
    assert lateness.value.endswith("SCHED_OTHER")


def test_a_slave_that_never_answers_is_a_problem():
    (finding,) = judge_trial(GOOD._replace(round_trip_p50_us=None, round_trip_p99_us=None, answers=0))
    assert finding.verdict is Verdict.PROBLEM
    assert "the slave answered no position" in finding.value


@pytest.mark.parametrize("error", [OSError("no room"), UnavailableError("the slave ended"), KeyError("round_trip")])
def test_a_trial_that_fails_is_a_finding(monkeypatch, error):
    def fail():
        raise error

    monkeypatch.setattr(trial, "run_trial", fail)
    (finding,) = trial.examine_trial()
    assert finding.verdict is Verdict.PROBLEM
    assert "no session over loopback" in finding.value


def test_another_kind_of_report_is_refused():
    with pytest.raises(KeyError):
        read_report({"ticks": 1})


def test_a_trial_that_does_not_end_is_killed():
    started = time.monotonic()
    with pytest.raises(UnavailableError, match=r"did not end within 0\.3 s"):
        run_trial(60.0, 0.3)
    assert time.monotonic() - started < 30


def test_a_trial_measures_whatever_keys_the_environment_names(monkeypatch):
    for name in ("KEY", "MASTERS", "PEER_KEY"):
        monkeypatch.setenv(f"HAPTICNET_{name}", "/nowhere")
    measured = run_trial(0.2)
    assert measured.ticks + measured.missed > 50
    assert measured.answers > 0
    assert judge_trial(measured)
