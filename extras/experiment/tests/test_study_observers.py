"""Simulated observers: every parameter has a source, and behaves as its definition says."""

import dataclasses
import inspect
import math
import re

import numpy as np
import pytest
from made import FORCES_N, look
from scipy.stats import multivariate_normal

from hapticnet.errors import SettingsError
from hapticnet_experiment.observers import OBSERVERS, Observer, ObserverSettings, judged, labelled, parse_observer

TRIALS = 4000
EXACT = ObserverSettings(name="exact", force_jnd=0.0, force_floor_n=0.0, stiffness_jnd=0.0, spread=0.0)


def observer(settings=EXACT, seed=1, **changes):
    return Observer(dataclasses.replace(settings, **changes), np.random.default_rng(seed))


def share_right(settings, peaks=FORCES_N, *, step=0.0, updates=(12.0, 15.0, 17.0), contacts=2.0, trials=TRIALS):
    """Return the share of trials in which felt peaks, softest first, are put in order."""
    table = np.ones((trials, 3))
    orders = judged(settings, table * peaks, table * updates, table * step, table * contacts, np.random.default_rng(2))
    return (orders == np.arange(3)).all(axis=1).mean()


def test_every_parameter_names_its_source_or_says_that_it_is_assumed_or_fitted():
    fields = [field.name for field in dataclasses.fields(ObserverSettings)]
    before = ""
    for line in inspect.getsource(ObserverSettings).splitlines():
        name = line.strip().partition(":")[0]
        if name in fields[1:-1]:
            assert re.search(r"\b(19|20)\d\d\b|assumption|fitted", before + line), name
        before = before + line if line.strip().startswith("#") else ""


def test_nothing_fitted_to_the_paper_is_on_unless_asked_for_and_titles_say_so():
    assert not ObserverSettings().fitted
    assert {name for name, each in OBSERVERS.items() if each.fitted} == {
        "fitted", "step-masking", "step-lapses", "rhythm"
    }  # fmt: skip
    assert labelled("literature") == "literature"
    assert labelled("step-masking") == "step-masking, fitted to the paper"
    assert labelled("literature:rhythm=3") == "literature:rhythm=3, fitted to the paper"
    assert labelled("of another version") == "of another version"


def test_an_observer_is_named_by_all_that_was_changed():
    changed = parse_observer("literature:force_jnd=0.1,lapse=0.05")
    assert (changed.name, changed.force_jnd, changed.lapse) == ("literature:force_jnd=0.1,lapse=0.05", 0.1, 0.05)
    assert parse_observer("fitted").name == "fitted"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("literatur", "unknown observer 'literatur' (did you mean 'literature'?)"),
        ("literature:force_jn=1", "has no parameter 'force_jn' (did you mean 'force_jnd'?)"),
        ("literature:force_jnd=much", "force_jnd is 'much'; it must be a number"),
        ("literature:force_jnd=-1", "force_jnd"),
        ("literature:lapse=nan", "lapse"),
        ("literature:lapse", "has no parameter 'lapse'"),
    ],
)
def test_an_observer_that_cannot_be_is_refused_in_one_line(text, told):
    with pytest.raises(SettingsError) as failed:
        parse_observer(text)
    assert told in str(failed.value)
    assert "\n" not in str(failed.value)


@pytest.mark.parametrize("jnd", [0.05, 0.1, 0.2])
def test_a_difference_of_one_jnd_is_told_right_in_three_of_four_forced_choices(jnd):
    one = observer(force_jnd=jnd)
    right = np.mean([one.stronger(2.0, 2.0 * (1.0 + jnd)) == 2 for _ in range(TRIALS)])
    assert right == pytest.approx(0.75, abs=0.025)


def test_small_forces_are_told_apart_worse_in_proportion():
    one = observer(force_jnd=0.05, force_floor_n=0.05)
    weak, strong = (
        np.mean([one.stronger(force_n, 1.1 * force_n) == 2 for _ in range(TRIALS)]) for force_n in (0.3, 3.0)
    )
    assert weak < 0.7 < strong


def test_false_alarms_follow_the_criterion():
    one = observer(force_jnd=0.07, criterion=1.64)
    alarms = np.mean([one.different(1.0, 1.0) for _ in range(TRIALS)])
    assert alarms == pytest.approx(0.10, abs=0.02)  # two sides of 1.64 standard deviations


@pytest.mark.parametrize("jnd", [0.15, 0.25, 0.4])
def test_the_share_of_correct_orders_is_that_of_three_normal_variables(jnd):
    settings = dataclasses.replace(EXACT, stiffness_jnd=jnd)
    sigma = settings.memory_sigma
    gaps = np.diff(np.log(FORCES_N))
    covariance = sigma**2 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    expected = multivariate_normal.cdf(gaps, mean=[0.0, 0.0], cov=covariance)
    assert share_right(settings) == pytest.approx(expected, abs=0.025)


def test_a_deadband_that_lowers_all_peaks_alike_changes_no_order():
    lowered = tuple(0.9 * force_n for force_n in FORCES_N)
    assert share_right(OBSERVERS["literature"], lowered) == share_right(OBSERVERS["literature"])


@pytest.mark.parametrize("name", ["step-masking", "step-lapses", "rhythm"])
def test_a_fitted_mechanism_does_nothing_without_steps_and_lowers_the_score_with_them(name):
    settings = OBSERVERS[name]
    plain = dataclasses.replace(settings, step_masking=0.0, step_lapses=0.0, rhythm=0.0)
    assert share_right(settings) == pytest.approx(share_right(plain), abs=0.03)
    assert share_right(settings, step=0.185) < share_right(plain) - 0.15


def test_who_only_guesses_is_right_in_one_of_six():
    assert share_right(dataclasses.replace(EXACT, lapse=1.0)) == pytest.approx(1 / 6, abs=0.02)


def test_the_rhythm_misleads_only_where_updates_do_not_follow_the_force():
    settings = dataclasses.replace(EXACT, rhythm=100.0)
    assert share_right(settings, step=0.2, updates=(20.0, 35.0, 50.0)) == 1.0
    assert share_right(settings, step=0.2, updates=(50.0, 35.0, 20.0)) == 0.0


def test_more_contacts_help_against_the_noise_of_force_but_not_of_memory():
    force, memory = (dataclasses.replace(EXACT, **{name: 0.4}) for name in ("force_jnd", "stiffness_jnd"))
    assert share_right(force, contacts=8.0) > share_right(force, contacts=1.0) + 0.2
    assert share_right(memory, contacts=8.0) == share_right(memory, contacts=1.0)


def test_contacts_with_one_tissue_are_averaged_and_an_untouched_one_is_the_softest():
    contacts = [look(0, 2.0), look(0, 5.0), look(2, 3.0)]
    assert observer().order(contacts) == (1, 2, 0)
    assert observer().order([]) in {(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)}


def test_ratings_are_whole_numbers_from_1_to_7_and_fall_with_the_step():
    one = observer(OBSERVERS["literature"])
    means = []
    for step in (0.0, 0.2, 3.0):
        ratings = [one.rate([look(0, 2.0, step)]) for _ in range(200)]
        assert {type(rating) for rating in ratings} == {int}
        assert 1 <= min(ratings) <= max(ratings) <= 7
        means.append(np.mean(ratings))
    assert means[0] > means[1] > means[2]


def test_participants_differ_by_the_spread():
    rng = np.random.default_rng(3)
    drawn = [OBSERVERS["literature"].of_participant(rng) for _ in range(2000)]
    spread = np.std(np.log([each.force_jnd for each in drawn]))
    assert spread == pytest.approx(0.35, abs=0.03)
    alike = dataclasses.replace(OBSERVERS["literature"], spread=0.0)
    assert alike.of_participant(rng).stiffness_jnd == pytest.approx(alike.stiffness_jnd)
    assert all(math.isfinite(each.memory_sigma) for each in drawn)
