"""Data that do not fit together, or are not complete: one clear line, or an honest report."""

import dataclasses

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.study.analysis import analyse
from hapticnet.study.report import markdown
from hapticnet.study.rows import OrderRow, header, to_line
from hapticnet.study.store import read_rows
from hapticnet.study.weber import ParticipantFile
from tests.study.made import rows


def comparison(results, condition):
    return next(each for each in results.comparisons if (each.condition, each.measure) == (condition, "correct"))


def test_tissues_of_two_designs_are_not_mixed():
    other = [dataclasses.replace(row, participant="09", breach_force_1_n=1.8) for row in rows(people=1)]
    with pytest.raises(SettingsError, match=r"mixes two designs: the breach forces are .* \(participant 09\)"):
        analyse([*rows(people=1), *other])


def test_conditions_of_two_designs_are_not_mixed():
    other = [
        dataclasses.replace(row, participant="09", multiplier=1.5) if row.condition == "1 JND" else row
        for row in rows(people=1)
    ]
    with pytest.raises(SettingsError, match=r"condition .1 JND. is deadband at 1 JND and deadband at 1\.5 JND"):
        analyse([*rows(people=1), *other])


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
    made[3] = dataclasses.replace(made[3], **change)
    with pytest.raises(SettingsError, match="participant 01, session 1, trial 3: ") as failed:
        analyse(made)
    assert told in str(failed.value)


def test_a_trial_without_an_answer_is_left_out_not_taken_for_wrong():
    made = rows(people=2, observer="force-only")
    made[3] = dataclasses.replace(made[3], correct=None, order_answered=None)
    results = analyse(made)
    first = results.conditions[0]
    assert (first.share, first.trials) == (1.0, 19)
    assert results.missing == (
        "Trials without an answer, left out: 1.",
        "Participant 01 has 9 trials of none; others have 10.",
    )


def test_a_participant_without_a_condition_is_left_out_of_its_comparisons():
    made = [row for row in rows(people=8) if not (row.participant == "05" and row.condition == "4 JND")]
    results = analyse(made)
    assert comparison(results, "4 JND").participants == 7
    assert comparison(results, "2 JND").participants == 8
    assert results.missing == ("Participant 05 has no trial of 4 JND and is left out of comparisons with it.",)


def test_missing_ratings_are_told_and_none_at_all_are_no_gap():
    made = [row for row in rows(people=3) if not (row.participant == "02" and row.event == "rating")]
    assert analyse(made).missing == ("Ratings are missing of participants 02.",)
    results = analyse([row for row in made if row.event == "trial"])
    assert results.missing == ()


def test_a_rating_of_a_block_with_several_conditions_is_of_none_of_them():
    made = [dataclasses.replace(row, block=0) for row in rows(people=3)]
    results = analyse(made)
    assert results.missing == ("12 ratings of blocks with several conditions are left out.",)
    assert all(each.figures["rating"].mean is None for each in results.conditions)


def test_jnds_of_their_own_are_told():
    made = [dataclasses.replace(row, weber_fraction=0.03 + 0.01 * int(row.participant)) for row in rows(people=3)]
    assert "**1 JND is not the same for all**: Weber fractions from 0.04 to 0.06" in markdown(analyse(made), title="x")


def test_participants_who_did_not_agree_or_gave_no_answer_are_named():
    begun = OrderRow(event="begin", participant="11", session=1, observer="step-masking")
    end = dataclasses.replace(begun, event="end", participant="12", reason="no consent")
    assert analyse([*rows(people=2), begun, end]).missing == (
        "Participants 12 did not agree to take part.",
        "Participants 11 have no answered trial.",
    )


def test_a_single_condition_has_no_comparison():
    results = analyse([row for row in rows(people=6) if row.condition == "none"])
    assert results.comparisons == ()
    assert results.curve is None
    text = markdown(results, title="one")
    assert "'none' is the only condition" in text
    assert "worse" not in text


def test_without_an_uncompressed_condition_the_weakest_is_the_reference():
    results = analyse([row for row in rows(people=6) if row.condition != "none"])
    text = markdown(results, title="three")
    assert "## Differences to '1 JND'" in text
    assert "equivalent to '1 JND'" in text
    assert results.curve is None


def test_the_report_of_two_participants_says_that_they_are_too_few():
    text = markdown(analyse(rows(people=2)), title="two")
    assert "Too few participants for a test at 5 %**: the smallest p that 2 can give is 0.5." in text


def test_every_title_of_simulated_data_says_so_and_no_test_is_said_to_be_the_paper_s():
    text = markdown(analyse(rows()), title="Results", figures=["curve.png"], stated="stated in the plan")
    assert text.splitlines()[0] == "# Results – SIMULATED (step-masking, fitted to the paper)"
    assert "No person took part" in text
    assert "It made no test" in text
    assert "a margin of ±10 points, stated in the plan" in text
    people = markdown(analyse(rows(simulated=False)), title="Results")
    assert "simulated" not in people.lower()


def test_one_session_in_two_tables_is_an_error(tmp_path):
    text = header(OrderRow) + "".join(to_line(row) for row in rows(people=1))
    for name in ("a.tsv", "b.tsv"):
        (tmp_path / name).write_text(text)
    with pytest.raises(FileError, match=r"a\.tsv and .*b\.tsv both have session 1 of participant 01"):
        read_rows(tmp_path, OrderRow)


def test_measured_jnds_stand_in_the_report_beside_what_the_paper_printed():
    people = [
        ParticipantFile(
            participant=f"{number:02}", method="ascending", weber_fraction=fraction, floor_n=0.02, excluded=excluded
        )
        for number, fraction, excluded in ((1, 0.05, []), (2, 0.07, []), (3, 0.01, ["5 of 6 were wrong"]))
    ]
    text = markdown(analyse(rows(people=2)), title="x", people=people)
    assert "Mean Weber fraction 0.0600 ± 0.0100 (s.e.), without 1 excluded." in text
    assert "- Participant 03, excluded: 5 of 6 were wrong." in text
    assert "without its reference forces or a Weber fraction" in text
