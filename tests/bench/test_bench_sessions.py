"""What counts as held, and the search for the most sessions, on made runs."""

import importlib
from pathlib import Path

import pytest

MEASURE = Path(__file__).parents[2] / "bench" / "measure"
GOOD = {
    "at_work": 50,
    "masters": 50,
    "positions": 50_000,
    "answers": 50_000,
    "trip_p99_us": 300.0,
    "late_p99_us": 40.0,
    "slave_positions": 60_000,
    "server_cpu_s": 0.5,
    "seconds": 1.0,
    "us_per_position": 10.0,
    "generator_cpu_s": 0.2,
    "trip_p50_us": 40.0,
    "received": 50_000,
}
ZERO = ("unsent", "kernel_drops", "ended", "resets", "lost", "server_drops", "malformed", "slave_superseded")
RUN = GOOD | dict.fromkeys(ZERO, 0)


@pytest.fixture
def sessions(monkeypatch):
    """Return the module bench/measure/sessions.py."""
    monkeypatch.syspath_prepend(MEASURE)
    return importlib.import_module("sessions")


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({}, None),
        ({"unsent": 1}, "the generator was late"),
        ({"at_work": 49}, "not all masters were served"),
        ({"lost": 1}, "answers were lost"),
        ({"server_drops": 1, "lost": 1}, "the server's socket was full"),
        ({"slave_lost": 1}, "positions were lost"),
        ({"slave_superseded": 700}, "positions were passed over"),
        ({"trip_p99_us": 2001.0}, "the round trip was too long"),
        ({"answers": 49_999}, "answers were lost"),  # of an echo that answers each
    ],
)
def test_a_run_is_held_or_says_why(sessions, change, wrong):
    assert sessions.faults(RUN | change, sessions.CASES["raw"]) == ([wrong] if wrong else [])


@pytest.mark.parametrize("most", [1, 7, 137, 400])
@pytest.mark.parametrize("start", [1, 30, 449])
def test_the_search_comes_close_to_what_is_held(sessions, most, start):
    def run(masters):
        counts = {"masters": masters, "at_work": masters, "server_cpu_s": 0.9 * masters / most}
        return RUN | counts | {"trip_p99_us": 100.0 if masters <= most else 9000.0}

    held, wrong = sessions.search(run, sessions.CASES["raw"], start, 20)
    assert most - max(1, 0.07 * most) <= held["masters"] <= most
    assert wrong == ["the round trip was too long"]


def test_the_search_ends_where_no_more_masters_are_tried(sessions):
    held, wrong = sessions.search(
        lambda masters: RUN | {"masters": masters, "at_work": masters}, sessions.CASES["raw"], 200, 20
    )
    assert (held["masters"], wrong) == (450, ["no more masters were tried"])
