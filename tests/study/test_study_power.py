"""Power by simulation: cases whose answer is known, and results that do not depend on the number of processes."""

import dataclasses

import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.study.power import ShareAnswers, lines, power

NAMES = "none", "1 JND", "2 JND", "4 JND"
PAPER = ShareAnswers(NAMES, (0.775, 0.8, 0.675, 0.5375))


def test_people_are_right_in_the_shares_that_were_assumed():
    scores = PAPER.scores(400, 10, 20, np.random.default_rng(1))
    assert scores.shape == (400, 10, 4)
    assert scores.mean(axis=(0, 1)) == pytest.approx(PAPER.shares, abs=0.01)


def test_people_without_a_spread_have_the_binomial_s_standard_deviation():
    even = dataclasses.replace(PAPER, shares=(0.5, 0.5, 0.5, 0.5), spread=0.0)
    scores = even.scores(400, 10, 25, np.random.default_rng(1))
    assert scores.std() == pytest.approx(0.1, abs=0.005)


def test_a_test_at_5_percent_finds_a_difference_that_is_not_there_in_no_more_than_5_percent():
    none = ShareAnswers(("none", "1 JND"), (0.775, 0.775))
    (_, found) = power(none, [(10, 10)], experiments=600)
    assert found.power < 0.07
    assert found.difference == pytest.approx(0.0, abs=0.01)


def test_the_paper_s_design_finds_4_jnd_but_not_2():
    found = {each.condition: each for each in power(PAPER, [(8, 10)], experiments=300)}
    assert 0.6 < found["4 JND"].power < 0.9
    assert found["2 JND"].power < 0.35
    assert found["1 JND"].equivalent < 0.15
    assert 0.10 < found["2 JND"].half_width < 0.20
    found = power(PAPER, [(5, 10)], experiments=100)  # five can find nothing
    assert all(each.power == 0.0 for each in found)
    assert all(each.half_width > 0.15 for each in found[1:])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"designs": [(1, 10)]}, "participants"),
        ({"designs": [(8, 0)]}, "trials"),
        ({"experiments": 5}, "experiments"),
        ({"margin": 0.0}, "margin"),
    ],
)
def test_a_design_that_cannot_be_is_refused(change, told):
    options = {"designs": [(8, 10)], **change}
    with pytest.raises(SettingsError, match=told):
        power(PAPER, options.pop("designs"), **options)


def test_every_condition_needs_a_share_within_0_and_1():
    with pytest.raises(SettingsError, match="3 shares are given for 4 conditions"):
        ShareAnswers(NAMES, (0.7, 0.7, 0.7))
    with pytest.raises(SettingsError, match="share of correct orders"):
        ShareAnswers(NAMES, (0.7, 0.7, 0.7, 1.5))


def test_tables_say_that_they_are_simulated():
    found = power(PAPER, [(6, 5), (8, 5)], experiments=100)
    told = lines(found, "assumed shares 0.775")
    assert told[0].startswith("SIMULATED, assumed shares 0.775")
    assert "6 participants, 5 trials of each condition" in told
