"""``hapticnet doctor`` as a person and as a program see it."""

import json
import os
import subprocess
import sys

import pytest

from hapticnet.cli.doctor import COLOURS, SUBJECTS, print_page
from hapticnet.runtime.doctor import Finding, Step, Verdict, probes
from tests.ready import ROOT, hapticnet

KEYS = {"id", "title", "verdict", "value", "meaning", "to_do", "scale"}
COMMAND = "echo " + 90 * "x"


def finding(name, verdict, value, meaning="", *to_do, scale=""):
    return Finding(name, name.partition(".")[2].capitalize(), verdict, value, meaning, to_do, scale)


FINDINGS = [
    finding("timing.timer", Verdict.OK, "fine, " + "and a long explanation of why " * 3, scale="good: up to 1 µs"),
    finding("timing.clock", Verdict.WARNING, "slow", "It is slow.", Step("Change it:", COMMAND)),
    finding("timing.budget", Verdict.WARNING, "low", "It is low.", Step("Change it:", COMMAND)),
    finding("network.port", Verdict.PROBLEM, "denied", "", Step("Join " + "the group " * 9)),
]


def printed(capsys, monkeypatch, findings=FINDINGS, columns=80):
    monkeypatch.setenv("COLUMNS", str(columns))
    print_page(findings, measured=True)
    return capsys.readouterr().out


def test_every_verdict_is_a_word_every_subject_has_a_heading_and_every_command_is_in_one_piece(capsys, monkeypatch):
    page = printed(capsys, monkeypatch)
    assert all(f"  {verdict.value} " in page for verdict in Verdict)
    assert set(COLOURS) == set(Verdict)
    assert {*(subject for subject, _ in probes()), "measured"} == set(SUBJECTS)
    assert page.count(COMMAND) == 1  # the second finding says the same
    assert "\x1b" not in page


@pytest.mark.parametrize("columns", [5, 40, 80, 300])
def test_the_page_keeps_to_the_width_of_the_terminal_but_for_commands(capsys, monkeypatch, columns):
    lines = printed(capsys, monkeypatch, columns=columns).splitlines()
    assert all(len(line) <= min(max(columns, 40), 100) for line in lines if COMMAND not in line)
    assert all(line == line.rstrip() for line in lines)


@pytest.mark.parametrize(
    ("findings", "answer"),
    [
        (FINDINGS, "This machine is not ready. First fix: Port."),
        (FINDINGS[:3], "This machine can run hapticnet; the warnings above say what would help."),
        (FINDINGS[:1], "This machine can run hapticnet.\n1 ok, 0 warnings, 0 problems."),
    ],
)
def test_the_page_ends_with_the_answer(capsys, monkeypatch, findings, answer):
    assert answer in printed(capsys, monkeypatch, findings)


def test_a_real_check_up_measures_and_reports_in_the_documented_form(tmp_path):
    done = hapticnet("doctor", "--json", cwd=tmp_path)
    report = json.loads(done.stdout)
    assert set(report) == {"schema", "ready", "counts", "findings", "provenance"}
    assert all(set(finding) == KEYS for finding in report["findings"])
    verdicts = [finding["verdict"] for finding in report["findings"]]
    assert {name: verdicts.count(name) for name in report["counts"]} == report["counts"]
    assert done.returncode == (1 if "problem" in verdicts else 0)
    assert report["ready"] is (done.returncode == 0)
    found = {finding["id"]: finding for finding in report["findings"]}
    assert len(found) == len(report["findings"])
    assert not [name for name in found if name.endswith(".probe")], "a probe failed"
    assert found["measured.round_trip"]["value"].startswith("p50 ")
    assert found["timing.timer"]["value"].startswith("timerfd, ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_error(closed):
    for verb, codes in (("doctor --quick", (0, 1)), ("slave --listen 127.0.0.1:0 --duration 0.1 --quiet", (0,))):
        command = f"exec {sys.executable} -m hapticnet {verb} {closed}"
        done = subprocess.run(["sh", "-c", command], cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert done.returncode in codes
        assert done.stderr == ""


def test_a_terminal_without_unicode_and_an_account_without_a_home_get_a_page(tmp_path):
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "HOME": str(tmp_path / "none"), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "hapticnet", "doctor", "--quick"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (0, 1)
    assert done.stdout.isascii()
    assert "This machine" in done.stdout
    assert "nothing was measured (--quick)" in done.stdout
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []
