"""The analysis of the ordering task: rows with a known answer, and data that do not fit or are not complete."""

import math
from dataclasses import replace as changed

import pytest
from made import CONDITIONS, rows

from hapticnet.errors import FileError, SettingsError
from hapticnet_experiment.analysis import analyse
from hapticnet_experiment.report import markdown
from hapticnet_experiment.rows import LimitsRow, OrderRow, header, to_line
from hapticnet_experiment.store import read_rows
from hapticnet_experiment.weber import ParticipantFile


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
    made = rows(people=20, trials=60)
    made = [changed(row, correct=int(row.order_true == "123"), order_answered="123") for row in made if row.order_true]
    results = analyse(made)
    # The same answer always is right in one of the six orders, which come equally often.
    assert all(each.share == pytest.approx(1 / 6) for each in results.conditions)
    assert all(share == pytest.approx(0.5) for each in results.conditions for share in each.pair_shares)


def test_a_real_fall_is_found_and_an_absent_one_is_not():
    results = analyse(rows(people=16, trials=18))
    assert comparison(results, "4 JND").probability < 0.01
    assert comparison(results, "4 JND").difference < -0.1
    assert comparison(results, "4 JND").within_margin > 0.5
    assert comparison(analyse(rows(people=16, observer="literature")), "4 JND").probability > 0.05


def test_bytes_are_per_penetration():
    results = analyse(rows())
    assert result(results, "none").figures["bytes"].mean == pytest.approx(200_000 / 6)
    assert result(results, "2 JND").figures["bytes"].mean == pytest.approx(10_000 / 6)


def test_the_paper_s_figures_stand_beside_its_conditions_only():
    results = analyse(rows(conditions=(*CONDITIONS, ("8 JND", "deadband", 8.0))))
    assert result(results, "2 JND").paper_correct == 0.675
    assert result(results, "8 JND").paper_correct is None


def test_repeated_and_aborted_trials_are_counted_and_left_out_and_no_trial_counts_twice():
    made = rows(people=2)
    trial = made[0]
    again = [changed(trial, event="aborted", correct=None), changed(trial, event="repeated")]
    results = analyse([*again, made[0], *made])  # written twice, it counts once
    assert (results.aborted, results.repeated) == (1, 1)
    assert sum(each.trials for each in results.conditions) == 80


def test_one_participant_alone_has_shares_but_no_interval_of_differences():
    results = analyse(rows(people=1))
    assert result(results, "none").figures["correct"].error is None
    assert comparison(results, "1 JND").interval == (-math.inf, math.inf)
    # Of two, it stays within what is possible.
    assert comparison(analyse(rows(people=2)), "4 JND").interval == (-1.0, 1.0)


def other_design(**change):
    """Return the rows of two participants; the trials of "1 JND" of the second differ in these columns."""
    made = rows(people=1)
    return made + [changed(row, participant="09", **(change if row.condition == "1 JND" else {})) for row in made]


@pytest.mark.parametrize(
    ("made", "told"),
    [
        ([], "no answered trial"),
        ([*rows(people=1), *rows(people=1, simulated=False)], "people and of simulated observers; analyse each in a"),
        (other_design(breach_force_1_n=1.8), r"mixes two designs: the breach forces are .* \(participant 09\)"),
        (
            [*rows(people=1), *other_design(multiplier=1.5)],
            r"condition .1 JND. is deadband at 1 JND and deadband at 1\.5",
        ),
    ],
)
def test_data_that_are_not_of_one_design_and_one_kind_of_participant_are_refused(made, told):
    with pytest.raises(SettingsError, match=told):
        analyse(made)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"correct": 5}, "key_resp.corr is 5; it must be 0 or 1"),
        ({"order_answered": "12"}, "order_answered is '12'; it must have 1, 2 and 3 once each"),
        ({"order_true": "124"}, "order_true is '124'"),
    ],
)
def test_an_impossible_answer_is_named(change, told):
    made = rows(people=2)
    made[3] = changed(made[3], **change)
    with pytest.raises(SettingsError, match=f"participant 01, session 1, trial 3: {told}"):
        analyse(made)


def test_tables_are_found_in_any_folder_and_what_is_wrong_in_one_is_named(tmp_path):
    made = rows(people=1)
    deep = tmp_path / "sub-01" / "ses-1"
    deep.mkdir(parents=True)
    text = header(OrderRow) + "".join(map(to_line, made))
    (deep / "order.tsv").write_text(text + to_line(made[0])[:40])  # a torn line is left out
    (tmp_path / "other.tsv").write_text("a\tb\n1\t2\n")
    assert len(read_rows(tmp_path, OrderRow)) == len(made)
    assert read_rows(tmp_path, LimitsRow) == []
    (tmp_path / "b.tsv").write_text(text)
    with pytest.raises(FileError, match=r"b\.tsv and .*order\.tsv both have session 1 of participant 01"):
        read_rows(tmp_path, OrderRow)
    (tmp_path / "b.tsv").write_text(text.replace("\traw\t", "\traw\tmany ", 1))
    with pytest.raises(FileError, match=r"b\.tsv: line 2: column multiplier: 'many 0' is not a number"):
        read_rows(tmp_path, OrderRow)
    with pytest.raises(FileError, match="no such folder"):
        read_rows(tmp_path / "absent", OrderRow)


def test_a_trial_without_an_answer_is_left_out_not_taken_for_wrong():
    made = rows(people=2, observer="force-only")
    made[3] = changed(made[3], correct=None, order_answered=None)
    results = analyse(made)
    first = results.conditions[0]
    assert (first.share, first.trials) == (1.0, 19)
    assert results.missing == (
        "Trials without an answer, omitted: 1.",
        "Participant 01 has 9 trials of none; others have 10.",
    )


def test_a_participant_without_a_condition_is_left_out_of_its_comparisons():
    made = [row for row in rows(people=8) if not (row.participant == "05" and row.condition == "4 JND")]
    results = analyse(made)
    assert comparison(results, "4 JND").participants == 7
    assert comparison(results, "2 JND").participants == 8
    assert results.missing == ("Participant 05 has no trial of 4 JND and is omitted from comparisons with it.",)


def test_missing_ratings_are_told_and_none_at_all_are_no_gap():
    made = [row for row in rows(people=3) if not (row.participant == "02" and row.event == "rating")]
    assert analyse(made).missing == ("Ratings are missing of participants 02.",)
    results = analyse([row for row in made if row.event == "trial"])
    assert results.missing == ()


def test_participants_who_did_not_agree_or_gave_no_answer_are_named():
    begun = OrderRow(event="begin", participant="11", session=1, observer="step-masking")
    end = changed(begun, event="end", participant="12", reason="no consent")
    assert analyse([*rows(people=2), begun, end]).missing == (
        "Participants 12 did not agree to take part.",
        "Participants 11 have no answered trial.",
    )


def test_a_single_condition_has_no_comparison():
    results = analyse([row for row in rows(people=6) if row.condition == "none"])
    assert results.comparisons == ()
    text = markdown(results, title="one")
    assert "'none' is the only condition" in text
    assert "worse" not in text


def test_without_an_uncompressed_condition_the_weakest_is_the_reference():
    results = analyse([row for row in rows(people=6) if row.condition != "none"])
    text = markdown(results, title="three")
    assert "## Differences to '1 JND'" in text
    assert "equivalent to '1 JND'" in text


def test_every_title_of_simulated_data_says_so_and_no_test_is_said_to_be_the_paper_s():
    text = markdown(analyse(rows()), title="Results", figures=["correct-orders.png"], stated="stated in the plan")
    assert text.splitlines()[0] == "# Results – SIMULATED (step-masking, fitted to the paper)"
    assert "No person took part" in text
    assert "It made no test" in text
    assert "a margin of ±10 points, stated in the plan" in text
    people = markdown(analyse(rows(simulated=False)), title="Results")
    assert "simulated" not in people.lower()


def test_measured_jnds_stand_in_the_report_beside_what_the_paper_printed():
    people = [
        ParticipantFile(
            participant=f"{number:02}", method="ascending", weber_fraction=fraction, floor_n=0.02, excluded=excluded
        )
        for number, fraction, excluded in ((1, 0.05, []), (2, 0.07, []), (3, 0.01, ["5 of 6 were wrong"]))
    ]
    text = markdown(analyse(rows(people=2)), title="x", people=people)
    assert "Too few participants for a test at 5 %**: the smallest p that 2 can give is 0.5." in text
    assert "Mean Weber fraction 0.0600 ± 0.0100 (s.e.), without 1 excluded." in text
    assert "- Participant 03, excluded: 5 of 6 were wrong." in text
    assert "without its reference forces or a Weber fraction" in text
