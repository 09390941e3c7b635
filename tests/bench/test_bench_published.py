"""Published figures still hold: quick runs give what they gave when the pages were written."""

import json
from pathlib import Path

import pytest
from fingerprint import changed, fingerprint

PUBLISHED = Path(__file__).parents[2] / "docs" / "benchmarks" / "published.json"
QUICK = json.loads(PUBLISHED.read_text())["quick"]


@pytest.mark.timeout(400)  # the benchmark is run, on a machine that may be busy
@pytest.mark.parametrize("name", QUICK)
def test_a_quick_run_gives_what_it_gave_when_its_figures_were_published(measured, name):
    differ = changed(QUICK[name], fingerprint(measured(name)))
    assert not differ, f"{name}: {', '.join(differ)} changed since the pages were written; run `make bench`"


def test_a_fingerprint_notices_one_figure_and_two_that_changed_places():
    before = fingerprint({"rows": [{"rmse_n": 1.0}, {"rmse_n": 2.0}], "cpu_us": 3.0})
    assert changed(before, fingerprint({"rows": [{"rmse_n": 1.0}, {"rmse_n": 2.0 + 1e-9}], "cpu_us": 4.0})) == []
    for rows in ([1.0, 2.1], [2.0, 1.0], [1.0], [1.0, 2.0, 0.0]):
        assert changed(before, fingerprint({"rows": [{"rmse_n": each} for each in rows]})) == ["rows.rmse_n"]
