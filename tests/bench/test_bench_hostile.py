"""No peer presses a finger harder than docs/safety.md says, with the worst sequences that a search has found."""

import json
from pathlib import Path

import pytest

from hapticnet.runtime.simavr import BUILD_VARIABLE

MEASURE = Path(__file__).parents[2] / "bench" / "measure"
WORST = json.loads((MEASURE / "hostile_worst.json").read_text())
MOST_N = 4.8


@pytest.fixture(scope="module")
def hostile():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(MEASURE)
        import hostile_slave

        yield hostile_slave


def name(row):
    return f"{row['what']}-{row['device']}-{row['stiffness_n_m']:.0f}"


def test_every_search_device_and_finger_has_its_worst_sequence(hostile):
    assert len({name(row) for row in WORST}) == len(WORST) == 2 * 2 * len(hostile.FINGERS_N_M)


@pytest.mark.parametrize("row", WORST, ids=name)
def test_the_worst_that_a_peer_is_known_to_cause_stays_within_the_limit(hostile, row, request, monkeypatch):
    if row["device"] == "simavr":
        monkeypatch.setenv(BUILD_VARIABLE, str(request.getfixturevalue("simavr_files")[0].parent))
    largest_n = hostile.evaluated(row["device"], row["stiffness_n_m"], row["what"], hostile.sequence_of(row))
    assert 3.5 < largest_n <= MOST_N  # below that, the sequence no longer tests anything: search again


def test_a_short_search_finds_nothing_worse(measured):
    rows = measured("hostile_slave")["rows"]
    assert len(rows) == 2 * 3
    for row in rows:
        assert row["played"] > 0
        assert 3.5 < row["largest_n"] <= MOST_N
