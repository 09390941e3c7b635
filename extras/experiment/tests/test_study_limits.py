"""The methods that measure a JND, on observers whose JND is known, and Weber's law from it."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet.perception import PAPER_WEBER_FRACTION
from hapticnet_experiment.observers import OBSERVERS, Observer
from hapticnet_experiment.plan import LimitsPlan, Plan
from hapticnet_experiment.procedure import Procedure, UpDown
from hapticnet_experiment.schedule import LimitsSchedule, Series
from hapticnet_experiment.weber import fit, load_participant, participant_file

PLAN = LimitsPlan()
Z_75 = NormalDist().inv_cdf(0.75)


def ascending(plan, series, says_different):
    """Ask all questions of an observer; return the procedure and the questions."""
    procedure = Procedure(plan, series)
    asked = []
    while (question := procedure.question()) is not None:
        asked.append(question)
        procedure.answer("different" if says_different(question) else "same")
    return procedure, asked


def test_a_series_ascends_by_steps_that_are_shares_of_the_reference_until_different():
    plan = LimitsPlan(references_n=[1.0, 2.0], step=0.02, start=0.0)
    series = [Series(reference_n=1.0, start=0.01), Series(reference_n=2.0, start=0.0)]
    procedure, asked = ascending(plan, series, lambda question: question.difference_n > 0.065 * question.reference_n)
    differences = [question.difference_n / question.reference_n for question in asked]
    assert differences == pytest.approx([0.01, 0.03, 0.05, 0.07, 0.0, 0.02, 0.04, 0.06, 0.08])
    assert procedure.thresholds == pytest.approx([0.07, 0.16])
    assert procedure.by_reference() == {1.0: pytest.approx([0.07]), 2.0: pytest.approx([0.16])}


@pytest.mark.parametrize(
    ("pairs", "says_different", "asked_n", "found", "alarms"),
    [
        ((None,), False, [0.0, 0.1, 0.2, 0.3, 0.4], [None], (0, 0)),  # up to the largest difference
        ((None, 5), True, [0.0, 0.0], [0.0], (1, 1)),
        ((4,), False, [0.0] * 4, [], (0, 4)),  # a catch series is no threshold
    ],
)
def test_answers_that_are_always_the_same_end_each_series_and_catch_series_count_alarms(
    pairs, says_different, asked_n, found, alarms
):
    plan = LimitsPlan(references_n=[1.0], step=0.1, start=0.0, largest=0.4)
    series = [Series(reference_n=1.0, start=0.0, pairs=each) for each in pairs]
    procedure, asked = ascending(plan, series, lambda _: says_different)
    assert [question.difference_n for question in asked] == pytest.approx(asked_n)
    assert [question.catch for question in asked] == [pairs[question.series] is not None for question in asked]
    assert (procedure.false_alarms, procedure.catch_pairs) == alarms
    assert procedure.by_reference() == {1.0: found}
    if found in ([None], []):
        with pytest.raises(SettingsError, match="above the largest difference"):
            fit(procedure.by_reference())


@pytest.mark.parametrize("jnd", [0.03, 0.08])
def test_the_staircase_finds_the_difference_that_is_told_right_in_three_of_four(jnd):
    rng = np.random.default_rng(1)
    found = []
    for _ in range(12):
        stairs = UpDown(0.4, 60)
        asked = 0
        while not stairs.done:
            felt = rng.normal(stairs.share(), jnd / Z_75)
            stairs.answer(bool(felt > 0.0))
            asked += 1
        assert asked <= 60
        found.append(math.log(stairs.jnd()))
    assert math.exp(np.mean(found)) == pytest.approx(jnd, rel=0.35)


def test_who_cannot_tell_the_largest_difference_has_no_jnd():
    plan = LimitsPlan(method="up-down", references_n=[1.0], repetitions=1, pairs=30)
    procedure = Procedure(plan, [Series(reference_n=1.0, start=0.0)], [1, 2] * 15)
    while (question := procedure.question()) is not None:
        assert question.difference_n <= 0.4 + 1e-12
        procedure.answer(str(3 - question.comparison_interval))
    assert procedure.by_reference() == {1.0: [None]}


def test_the_comparison_is_in_the_interval_that_was_drawn():
    plan = LimitsPlan(method="up-down", references_n=[1.0], pairs=5)
    procedure = Procedure(plan, [Series(reference_n=1.0, start=0.0)], [1, 2, 2, 1, 2])
    intervals = []
    while (question := procedure.question()) is not None:
        intervals.append(1 + int(question.forces_n[1] > question.forces_n[0]))
        procedure.answer("1")
    assert intervals == [1, 2, 2, 1, 2]


def test_webers_law_is_found_where_it_holds():
    fitted = fit({force: [0.05 * force] * 5 for force in (0.5, 1.0, 1.5)})
    assert fitted.mean_of_ratios == pytest.approx(0.05)
    assert fitted.residual == pytest.approx(0.0)
    assert fitted.low is fitted.high is None, "series that agree tell no spread"


def test_a_constant_jnd_departs_from_webers_law():
    fitted = fit({force: [0.05] * 5 for force in (0.5, 1.0, 1.5)})
    assert fitted.mean_of_ratios == pytest.approx(0.05 * (2.0 + 1.0 + 2.0 / 3.0) / 3.0)
    assert fitted.residual > 0.3


def test_the_interval_contains_the_fraction_as_often_as_it_says_with_five_series():
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(400):
        fitted = fit({force: (force * rng.gamma(4.0, 0.0125, 5)).tolist() for force in (0.5, 1.0, 1.5)})
        inside += fitted.low <= 0.05 <= fitted.high
    assert 0.92 * 400 <= inside <= 0.985 * 400


def test_a_participants_file_is_read_as_it_was_written(tmp_path):
    found = {0.5: [0.03, 0.04, None], 1.0: [0.05, 0.06], 1.5: [None, None]}
    written = participant_file(
        "03", PLAN, found, device_errors_n={0.5: [0.01, -0.02]}, simulated=None, false_alarms=1, catch_pairs=20
    )
    path = tmp_path / "03.toml"
    path.write_text(written.to_toml())
    read = load_participant(path)
    assert read == written
    assert [each.censored for each in read.reference] == [1, 0, 2]
    assert read.reference[2].jnd_n is None
    assert read.device_error_n == pytest.approx(math.sqrt((0.01**2 + 0.02**2) / 2))
    assert read.law.weber_fraction == pytest.approx((0.035 / 0.5 + 0.055) / 2)


def measured_by(says_different, seed):
    """Return the file of a participant who answers the default plan, and the forces of the device exactly."""
    plan = Plan()
    rng = np.random.default_rng(seed)
    procedure, _ = ascending(
        plan.limits,
        LimitsSchedule.draw(plan, f"{seed + 1}", 1, 1).series,
        lambda question: says_different(question, rng),
    )
    counts = {"false_alarms": procedure.false_alarms, "catch_pairs": procedure.catch_pairs}
    return participant_file("03", plan.limits, procedure.by_reference(), device_errors_n={}, **counts)


def test_honest_observers_are_kept_and_answers_at_random_are_dropped():
    def honest(question, rng):
        return Observer(OBSERVERS["literature"].of_participant(np.random.default_rng(seed)), rng).different(
            *question.forces_n
        )

    kept = dropped = 0
    for seed in range(60):
        kept += not measured_by(honest, seed).excluded
        (why,) = measured_by(lambda _, rng: rng.random() < 0.5, seed).excluded or [""]
        dropped += "pairs of equal forces were called different, more than 25 %" in why
    assert kept >= 50
    assert dropped >= 55


def test_doubtful_jnds_are_told_and_one_with_more_series_without_an_end_than_the_plan_allows_is_excluded():
    found = {0.5: [0.01, 0.01], 1.0: [0.05, 0.06]}
    errors_n = {0.5: [0.03, -0.03], 1.0: [0.03]}
    first, second = participant_file("03", PLAN, found, device_errors_n=errors_n, catch_pairs=0).warnings
    assert first.startswith("the JND at 0.5 N, 0.010 N, is below the error of the device, 0.030 N")
    assert "no catch series" in second
    found = {0.5: [0.03, None, None, None], 1.0: [0.05, None, None, 0.06]}
    (why,) = participant_file("03", PLAN, found, device_errors_n={}, false_alarms=5, catch_pairs=20).excluded
    assert why.startswith("3 of 4 series at 0.5 N ended without a JND, more than 2")


def test_master_takes_the_law_of_a_participants_file(tmp_path):
    from hapticnet.cli.law import law_given

    path = tmp_path / "03.toml"
    path.write_text(participant_file("03", PLAN, {1.0: [0.08]}, device_errors_n={}).to_toml())
    law = law_given(PAPER_WEBER_FRACTION, 0.025, 2.0, path)
    assert (law.weber_fraction, law.floor_n, law.multiplier) == pytest.approx((0.08, 0.08, 2.0))
    with pytest.raises(SettingsError, match="leave out --weber and --floor"):
        law_given(0.1, 0.025, 1.0, path)
    with pytest.raises(FileError, match=r"04\.toml"):
        law_given(PAPER_WEBER_FRACTION, 0.025, 1.0, tmp_path / "04.toml")
    path.write_text('participant = "03"\nmethod = "ascending"\nweber_fractions = 0.1\n')
    with pytest.raises(SettingsError, match="did you mean 'weber_fraction'"):
        load_participant(path)
