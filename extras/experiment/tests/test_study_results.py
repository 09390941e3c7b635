"""``hapticnet experiment analyse`` on made data."""

import json

import pytest
from made import rows

from hapticnet.cli.console import Console
from hapticnet.experiment.style import picture
from hapticnet_experiment.cli.conducting import conduct_all
from hapticnet_experiment.figures import mark_level
from hapticnet_experiment.plan import LimitsPlan
from hapticnet_experiment.rows import OrderRow, header, to_line
from hapticnet_experiment.weber import participant_file
from tests.cli.test_cli_errors import assert_only_line

FIGURES = ("bytes-per-penetration", "correct-orders")
TABLES = ("report.md", "results.json")


def write(folder, made, name="order.tsv"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(header(OrderRow) + "".join(map(to_line, made)))
    return folder


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_rehearsal_tells_how_many_trials_are_answered(monkeypatch, capfd, jobs):
    monkeypatch.setattr("hapticnet.cli.console.PROGRESS_S", 0.0)

    def conduct_one(number, session, on_trial):
        for _ in range(number):
            on_trial()
        return {"participant": session}

    accounts = conduct_all(conduct_one, 3, ["01", "02"], jobs, Console("order"), "of 6 trials")
    assert accounts == [{"participant": "01"}, {"participant": "02"}]
    told = [line.partition(": ")[2] for line in capfd.readouterr().err.splitlines()]
    assert "6 of 6 trials" in {line.partition(",")[0] for line in told}
    assert any(line.endswith("2 of 2 participants") for line in told)


@pytest.fixture
def study(tmp_path):
    return write(tmp_path / "study", rows())


def test_analyse_writes_report_tables_and_pictures(run, study):
    done = run("experiment", "analyse", study)
    assert done.returncode == 0
    assert done.stdout.startswith("# Results of study – SIMULATED (step-masking, fitted to the paper)\n")
    results = study / "results"
    assert {file.name for file in results.iterdir()} == {
        *TABLES, *(f"{name}.{form}" for name in FIGURES for form in ("png", "pdf"))
    }  # fmt: skip
    for name in FIGURES:
        assert (results / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (results / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    assert (results / "report.md").read_text() == done.stdout
    assert all(f"({name}.png)" in done.stdout for name in FIGURES)
    assert "the default, because there is no plan" in done.stdout


def test_nothing_in_a_table_speaks_to_the_terminal_or_stays_in_the_report(run, tmp_path):
    evil, formula = "\x1b]0;title\x07", "$\\frac{$"  # which matplotlib would refuse to draw
    study = write(tmp_path / f"study{evil}", rows())
    table = study / "order.tsv"
    name = next(row.condition for row in rows() if row.condition is not None)
    table.write_text(table.read_text().replace(f"\t{name}\t", f"\t{name}{evil}{formula}\t"))
    done = run("experiment", "analyse", study)
    assert done.returncode == 0, done.stderr
    assert f"{name}?]0;title?{formula}" in done.stdout
    assert all(line.isprintable() for line in (done.stdout + done.stderr).splitlines())
    assert evil not in "".join((study / "results" / name).read_text() for name in TABLES)


def test_tables_have_every_participant_and_say_that_they_are_simulated(run, study):
    done = run("experiment", "analyse", study, "--no-plots", "--json")
    account = json.loads(done.stdout, parse_constant=lambda name: pytest.fail(name))
    assert account["results"]["simulated"] == ["step-masking, fitted to the paper"]
    assert len(account["results"]["conditions"]) == 4
    assert account["results"]["participants"] == [f"{person:02}" for person in range(1, 9)]
    assert len(account["results"]["conditions"][3]["figures"]["correct"]["each"]) == 8


def test_measured_jnds_alone_give_a_report(run, tmp_path):
    folder = tmp_path / "study" / "participants"
    folder.mkdir(parents=True)
    found = {1.0: [0.05, 0.06]}
    text = participant_file("03", LimitsPlan(), found, device_errors_n={}, catch_pairs=20, false_alarms=9).to_toml()
    (folder / "03.toml").write_text(text)
    done = run("experiment", "analyse", tmp_path / "study")
    assert done.returncode == 0, done.stderr
    assert "No trial of the ordering task was answered yet" in done.stdout
    assert "| 03 | ascending | 0.055 |" in done.stdout
    assert "Participant 03, excluded: 9 of 20 pairs" in done.stdout
    assert {file.name for file in (tmp_path / "study" / "results").iterdir()} == {"report.md", "results.json"}


def test_results_are_not_overwritten_unless_forced(run, study):
    assert run("experiment", "analyse", study, "--no-plots").returncode == 0
    assert_only_line(run("experiment", "analyse", study, "--no-plots"), "report.md")
    assert run("experiment", "analyse", study, "--no-plots", "--overwrite").returncode == 0


def test_the_margin_is_the_plan_s(run, study):
    (study / "plan.toml").write_text("[order]\nequivalence_margin = 0.2\n")
    assert "a margin of ±20 points, stated in the plan" in run("experiment", "analyse", study, "--no-plots").stdout


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no answered trial of the ordering task was found"),
        ("event\torder_true\ntrial\t123\n", "no column event, participant or session"),
        (
            header(OrderRow).replace("order_answered", "order_given"),
            'the column "order_given", which no session writes',
        ),
        (header(OrderRow).replace("order_answered", "version"), "a column twice, which no session writes"),
    ],
)
def test_a_malformed_table_is_one_line(run, tmp_path, text, told):
    (tmp_path / "order.tsv").write_text(text)
    assert_only_line(run("experiment", "analyse", tmp_path), told)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("made", [rows(people=1), [row for row in rows(people=3) if row.condition == "none"]])
def test_little_data_give_an_honest_report_with_its_pictures(run, tmp_path, made):
    done = run("experiment", "analyse", write(tmp_path / "study", made))
    assert done.returncode == 0
    assert " nan" not in done.stdout
    assert (tmp_path / "study" / "results" / "correct-orders.png").exists()


def test_the_name_of_a_level_stands_beside_the_axes(tmp_path):
    with picture(tmp_path / "chance.png", 2.0) as figure:
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 100.0])
        mark_level(axes, 50.0, "chance")
        figure.canvas.draw()
        assert axes.texts[0].get_window_extent().x0 >= axes.get_window_extent().x1
