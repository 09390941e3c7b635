"""No peer presses a finger harder than docs/understand/safety.md says: the worst sequences that a search has found."""

import itertools
import json
from pathlib import Path

import pytest

from hapticnet.runtime.nano import BUILD_VARIABLE

REPOSITORY = Path(__file__).parents[2]
MEASURE = REPOSITORY / "bench" / "measure"
SAFETY = (REPOSITORY / "docs" / "understand" / "safety.md").read_text(encoding="utf-8")
WORST = json.loads((MEASURE / "hostile_worst.json").read_text())
MOST_N = 4.8


@pytest.fixture(scope="module")
def hostile():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(MEASURE)
        import hostile_slave

        yield hostile_slave


def name(row):
    low_n_m, high_n_m = row["range_n_m"]
    return f"{row['what']}-{row['device']}-{low_n_m:.0f}-{high_n_m:.0f}"


def test_every_search_device_and_range_of_fingers_has_its_worst_sequence(hostile):
    assert len({name(row) for row in WORST}) == len(WORST) == 2 * 2 * len(hostile.RANGES_N_M)
    for row in WORST:
        low_n_m, high_n_m = row["range_n_m"]
        assert low_n_m <= row["stiffness_n_m"] <= high_n_m


def test_the_safety_page_tells_the_worst_of_each_search(hostile):
    for what, (device, called) in itertools.product(
        hostile.SEARCHES, (("sim", "simulated device"), ("simavr", "compiled firmware"))
    ):
        rows = sorted(
            (row for row in WORST if (row["what"], row["device"]) == (what, device)), key=lambda row: row["range_n_m"]
        )
        told = " | ".join(f"{row['largest_n']:.2f} N" for row in rows)
        assert f"| {what}, {called} | {told} |" in SAFETY
    assert f"**{max(row['largest_n'] for row in WORST):.2f} N**: see" in SAFETY


@pytest.mark.parametrize("row", WORST, ids=name)
def test_the_worst_that_a_peer_is_known_to_cause_stays_within_the_limit(hostile, row, request, monkeypatch):
    if row["device"] == "simavr":
        monkeypatch.setenv(BUILD_VARIABLE, str(request.getfixturevalue("simavr_files")[0].parent))
    largest_n = hostile.evaluated(row["device"], row["what"], hostile.sequence_of(row))
    assert 3.5 < largest_n <= MOST_N  # below that, the sequence no longer tests anything: search again


def test_a_short_search_finds_nothing_worse(measured):
    rows = measured("hostile_slave")["rows"]
    assert len(rows) == 2 * 2
    for row in rows:
        assert row["played"] > 0
        assert 3.5 < row["largest_n"] <= MOST_N
