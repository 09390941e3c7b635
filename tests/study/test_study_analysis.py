"""The analysis of the ordering task, on rows with a known answer."""

import dataclasses
import math

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.study.analysis import analyse
from hapticnet.study.rows import LimitsRow, OrderRow, header, to_line
from hapticnet.study.store import read_rows
from tests.study.made import CONDITIONS, rows


def result(results, name):
    return next(each for each in results.conditions if each.name == name)


def comparison(results, condition, measure="correct"):
    return next(each for each in results.comparisons if (each.condition, each.measure) == (condition, measure))


def test_an_observer_without_noise_is_right_in_every_trial():
    results = analyse(rows(observer="force-only"))
    assert [each.correct for each in results.conditions] == [80] * 4
    assert [each.name for each in results.conditions] == ["none", "1 JND", "2 JND", "4 JND"]
    assert all(each.probability == 1.0 for each in results.comparisons if each.measure in ("correct", "pairs"))
    assert result(results, "4 JND").interval[1] == 1.0
    assert all(0.5 < low < high == 1.0 for each in results.conditions for low, high in each.pair_intervals)


def test_the_same_answer_always_gives_one_sixth_and_half_of_the_pairs():
    results = analyse(rows(people=20, trials=60, observer="always-same"))
    # The same answer always is right in one of the six orders, which come equally often.
    assert all(each.share == pytest.approx(1 / 6) for each in results.conditions)
    assert all(share == pytest.approx(0.5) for each in results.conditions for share in each.pair_shares)
    assert result(results, "none").figures["kendall"].mean == pytest.approx(1.5)


def test_a_real_fall_is_found_and_an_absent_one_is_not():
    results = analyse(rows(people=16, trials=18))
    assert comparison(results, "4 JND").probability < 0.01
    assert comparison(results, "4 JND").difference < -0.1
    assert comparison(results, "4 JND").within_margin > 0.5
    assert comparison(analyse(rows(people=16, observer="literature")), "4 JND").probability > 0.05
    assert results.curve is not None
    assert 1.0 < results.curve.at < 4.0


def test_bytes_are_per_penetration():
    results = analyse(rows())
    assert result(results, "none").figures["bytes"].mean == pytest.approx(200_000 / 6)
    assert result(results, "2 JND").figures["bytes"].mean == pytest.approx(10_000 / 6)


def test_the_paper_s_figures_stand_beside_its_conditions_only():
    results = analyse(rows(conditions=(*CONDITIONS, ("8 JND", "deadband", 8.0))))
    assert result(results, "2 JND").paper_correct == 0.675
    assert result(results, "8 JND").paper_correct is None


def test_repeated_and_aborted_trials_are_counted_and_left_out():
    made = rows(people=2)
    trial = made[0]
    again = [dataclasses.replace(trial, event="aborted", correct=None), dataclasses.replace(trial, event="repeated")]
    results = analyse([*again, *made])
    assert (results.aborted, results.repeated) == (1, 1)
    assert sum(each.trials for each in results.conditions) == 80


def test_a_trial_that_was_written_twice_counts_once():
    made = rows(people=2)
    assert sum(each.trials for each in analyse([made[0], *made]).conditions) == 80


def test_one_participant_alone_has_shares_but_no_interval_of_differences():
    results = analyse(rows(people=1))
    assert result(results, "none").figures["correct"].error is None
    assert comparison(results, "1 JND").interval == (-math.inf, math.inf)
    assert results.curve is None


def test_an_interval_of_a_difference_of_shares_stays_within_what_is_possible():
    assert comparison(analyse(rows(people=2)), "4 JND").interval == (-1.0, 1.0)


def test_people_and_simulated_observers_are_not_mixed():
    with pytest.raises(SettingsError, match="people and of simulated observers; analyse each in a folder of its own"):
        analyse([*rows(people=1), *rows(people=1, simulated=False)])


def test_nothing_answered_is_an_error():
    with pytest.raises(SettingsError, match="no answered trial"):
        analyse([])


def test_tables_are_found_in_any_folder_and_a_torn_line_is_left_out(tmp_path):
    made = rows(people=1)
    deep = tmp_path / "sub-01" / "ses-1"
    deep.mkdir(parents=True)
    text = header(OrderRow) + "".join(to_line(row) for row in made)
    (deep / "order.tsv").write_text(text + to_line(made[0])[:40])
    (tmp_path / "other.tsv").write_text("a\tb\n1\t2\n")
    assert len(read_rows(tmp_path, OrderRow)) == len(made)
    assert read_rows(tmp_path, LimitsRow) == []


def test_a_table_with_a_wrong_cell_is_named_with_its_line(tmp_path):
    text = header(OrderRow) + to_line(rows(people=1)[0]).replace("deadband", "x").replace("\traw\t", "\traw\tmany ")
    (tmp_path / "order.tsv").write_text(text)
    with pytest.raises(FileError, match=r"order\.tsv: line 2: column multiplier: 'many 0' is not a number"):
        read_rows(tmp_path, OrderRow)
    with pytest.raises(FileError, match="no such folder"):
        read_rows(tmp_path / "absent", OrderRow)
