"""``hapticnet doctor`` as a person sees it."""

import os
import subprocess
import sys

import pytest

from hapticnet.cli.doctor import page
from hapticnet.runtime.doctor import Finding, Step, Verdict
from tests.ready import ROOT, hapticnet

COMMAND = "echo " + 90 * "x"
FINDINGS = [
    Finding("Timer", Verdict.OK, "fine, " + "and a long explanation of why " * 3),
    Finding("Clock", Verdict.WARNING, "slow", "It is slow.", (Step("Change it:", COMMAND),)),
    Finding("Port", Verdict.PROBLEM, "denied", "", (Step("Join " + "the group " * 9),)),
]


@pytest.mark.parametrize("columns", [5, 40, 80, 300])
def test_the_page_keeps_to_the_width_of_the_terminal_but_for_commands(columns):
    lines = list(page(FINDINGS, columns))
    assert all(any(line.startswith(f"  {verdict.value} ") for line in lines) for verdict in Verdict)
    assert [line.strip() for line in lines if "echo" in line] == [COMMAND]
    assert all(len(line) <= min(max(columns, 40), 100) for line in lines if COMMAND not in line)


@pytest.mark.parametrize(
    ("findings", "answer"),
    [
        (FINDINGS, "This machine is not ready. First fix: Port."),
        (FINDINGS[:2], "This machine can run hapticnet; what would help: Clock."),
        (FINDINGS[:1], "This machine can run hapticnet."),
    ],
)
def test_the_page_ends_with_the_answer(findings, answer):
    assert list(page(findings, 80))[-1] == answer


def test_a_real_check_up_measures_and_leaves_nothing_behind(tmp_path):
    done = hapticnet("doctor", cwd=tmp_path)
    assert done.returncode == (1 if "\n  problem " in f"\n{done.stdout}" else 0)
    for words in ("Timer                timerfd, ", "Round trip           p50 ", "Missed ticks ", "This machine "):
        assert words in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_hand_is_judged_with_its_delay():
    done = hapticnet("doctor", "--quick", "--hand", "arm", "--delay", "50ms", "--scene", "paper")
    assert "Stability            arm, round trip 50 ms: it swings above 150 N/m" in done.stdout
    for wrong, words in (
        (["--hand", "arm"], "--hand needs --delay"),
        (["--scene", "paper"], "--scene need --hand"),
        (["--hand", "am", "--delay", "5ms"], "did you mean 'arm'?"),
        (["--hand", "arm", "--delay", "fast"], "is not a time"),
    ):
        done = hapticnet("doctor", "--quick", *wrong)
        assert (done.returncode, words in done.stderr) == (2, True)


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
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []
