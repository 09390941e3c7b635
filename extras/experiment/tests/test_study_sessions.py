"""Sessions of simulated observers from the command line: complete or refused."""

import json

import pytest

from hapticnet_experiment.rows import LimitsRow, OrderRow
from hapticnet_experiment.store import read_table
from hapticnet_experiment.weber import load_participant
from tests.cli.test_cli_errors import assert_only_line
from tests.ready import hapticnet

PLAN = """
name = "short"
[[condition]]
name = "none"
codec = "raw"
[[condition]]
name = "4 JND"
multiplier = 4.0
[order]
breach_forces_n = [1.0, 1.75, 2.5]
trials = 1
practice = 1
practice_pairs = 0
practice_rounds = 1
[limits]
references_n = [1.0]
repetitions = 3
step = 0.05
stimulus_s = 0.3
gap_s = 0.1
catch = 0.3
[link]
rate_hz = 250.0
"""

TABLE = "study/sub-{0}/ses-1/order/sub-{0}_ses-1_task-order_beh.tsv"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path


def experiment(folder, verb, *words):
    return hapticnet("experiment", verb, *words, cwd=folder)


def test_a_study_of_simulated_observers_ends_with_report_and_figures_and_is_not_begun_twice(folder):
    words = ("--participant", "01-02", "--plan", "plan.toml", "--simulate", "literature")
    done = experiment(folder, "order", *words, "--json")
    assert done.returncode == 0, done.stderr
    account = json.loads(done.stdout)
    assert "simulated observer literature" in account["title"]
    assert [each["trials"] for each in account["participant"]] == [2, 2]
    results = folder / "study/results"
    assert "SIMULATED" in (results / "report.md").read_text().splitlines()[0]
    assert (results / "correct-orders.pdf").stat().st_size > 1000
    tables = {number: (folder / TABLE.format(number)).read_bytes() for number in ("01", "02")}
    assert b"simulated" not in tables["01"]
    rows = read_table(folder / TABLE.format("01"), OrderRow)
    assert {row.observer for row in rows} == {"literature"}
    assert {row.condition: row.multiplier for row in rows if row.event == "trial"} == {"none": 0.0, "4 JND": 4.0}
    for row in rows:
        if row.event == "trial":
            shares = [felt / held for felt, held in zip(row.peaks_sensed_n, row.peaks_held_n, strict=True)]
            assert min(shares) > 0.8

    refused = {
        words: "exists; choose another --out-dir",
        (*words, "--resume"): "--resume is for people",
        ("--participant", "03", "--plan", "plan.toml", "--resume"): "does not exist, so there is nothing to continue",
        ("--participant", "03", "--simulate", "literature"): "differs from the given plan",
        ("--participant", "03-04",): "several at once are for --simulate",
        ("--participant", "03", "--plan", "plan.toml", "--device", "none"): "unknown device 'none'",
    }  # fmt: skip
    for wrong, told in refused.items():
        assert_only_line(experiment(folder, "order", *wrong), told, code=2)
    assert tables == {number: (folder / TABLE.format(number)).read_bytes() for number in tables}


def test_the_jnd_is_measured_and_the_ordering_task_uses_it(folder):
    (folder / "plan.toml").write_text(PLAN + "[jnd]\nmeasured = 'required'\n")
    words = ("--participant", "03", "--plan", "plan.toml", "--simulate", "literature")
    done = experiment(folder, "order", *words)
    assert_only_line(done, "measure it first, with 'hapticnet experiment limits --participant 03'", code=2)
    assert not (folder / "study").exists()

    done = experiment(folder, "limits", *words)
    assert done.returncode == 0, done.stderr
    assert "simulated observer literature" in done.stdout
    measured = load_participant(folder / "study/participants/03.toml")
    assert measured.simulated == "literature"
    assert 0.01 < measured.weber_fraction < 0.4
    assert measured.device_error_n is not None

    assert experiment(folder, "order", *words).returncode == 0
    trials = [row for row in read_table(folder / TABLE.format("03"), OrderRow) if row.event == "trial"]
    assert {row.weber_fraction for row in trials} == {float(f"{measured.weber_fraction:.9g}")}


@pytest.mark.parametrize(("criterion", "told"), [(10, "no_jnd"), (0, "catch_pairs")])
def test_observers_without_a_jnd_end_with_an_account_of_it(folder, criterion, told):
    words = ("--participant", "03", "--plan", "plan.toml", "--simulate", f"literature:criterion={criterion}")
    done = experiment(folder, "limits", *words)
    assert done.returncode == 0, done.stderr
    assert told in done.stdout or "no_jnd" in done.stdout
    rows = read_table(folder / "study/sub-03/ses-1/limits/sub-03_ses-1_task-limits_beh.tsv", LimitsRow)
    assert rows[-1].event == "end"
    assert not (folder / "study/participants/03.toml").exists() or told != "no_jnd"


def test_people_and_simulated_observers_are_kept_in_folders_apart(folder):
    words = ("--participant", "01", "--plan", "plan.toml")
    assert experiment(folder, "limits", *words, "--simulate", "literature").returncode == 0
    person = experiment(folder, "limits", "--participant", "02", "--plan", "plan.toml")
    told = "study has answers of the simulated observer 'literature' (participant 01); keep people"
    assert_only_line(person, told, code=2)
    table = next((folder / "study").glob("sub-01/ses-1/limits/*.tsv"))
    table.write_text(table.read_text().replace("literature", "n/a"))
    simulated = experiment(folder, "order", "--participant", "02-03", *words[2:], "--simulate", "literature")
    assert_only_line(simulated, "study has answers of a person (participant 01)", code=2)
    assert sorted(each.name for each in (folder / "study").iterdir()) == ["participants", "plan.toml", "sub-01"]
