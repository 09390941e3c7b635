"""Plans and schedules: what is balanced, what is drawn from the seed, and which plans are refused."""

from collections import Counter
from itertools import pairwise

import pytest

from hapticnet.errors import FileError, SettingsError
from hapticnet_experiment.plan import PRESETS, OrderPlan, Plan, find_plan
from hapticnet_experiment.schedule import LimitsSchedule, OrderSchedule, williams_square

PAPER = PRESETS["paper"]


@pytest.mark.parametrize("conditions", range(2, 9))
def test_each_condition_comes_equally_often_at_each_place_and_after_each_other(conditions):
    square = williams_square(conditions)
    places = Counter((place, each) for row in square for place, each in enumerate(row))
    follows = Counter(pair for row in square for pair in pairwise(row))
    assert len(places) == conditions**2
    assert len(set(places.values())) == 1
    assert len(follows) == conditions * (conditions - 1)
    assert len(set(follows.values())) == 1


def test_four_participants_have_the_four_orders_of_the_conditions():
    orders = set()
    for participant in ("01", "02", "03", "04"):
        trials = OrderSchedule.draw(PAPER, participant, 1, 7).trials
        orders.add(tuple(trials[block * 10].condition for block in range(4)))
    assert orders == set(williams_square(4))


def test_a_blocked_session_has_ten_trials_of_each_condition_one_after_the_other():
    schedule = OrderSchedule.draw(PAPER, "03", 1, 7)
    assert [trial.index for trial in schedule.trials] == list(range(40))
    assert schedule.blocks == 4
    for block in range(4):
        own = [trial for trial in schedule.trials if trial.block == block]
        assert len({trial.condition for trial in own}) == 1
        assert [trial.repetition for trial in own] == list(range(10))


def test_each_condition_runs_through_all_six_orders_before_one_comes_again():
    schedule = OrderSchedule.draw(Plan(order=OrderPlan(trials=12)), "05", 2, 3)
    for condition in range(4):
        orders = [trial.order for trial in schedule.trials if trial.condition == condition]
        assert len(set(orders[:6])) == len(set(orders[6:])) == 6
    for trial in schedule.trials:  # an order names the tissues from softest to hardest
        forces = [trial.breach_forces_n[int(each) - 1] for each in trial.order]
        assert forces == sorted(forces)


def test_the_same_seed_draws_the_same_session_and_another_one_another():
    first = OrderSchedule.draw(PAPER, "03", 1, 7)
    assert OrderSchedule.draw(PAPER, "03", 1, 7) == first
    for other in (
        OrderSchedule.draw(PAPER, "03", 1, 8),
        OrderSchedule.draw(PAPER, "03", 2, 7),
        OrderSchedule.draw(PAPER, "07", 1, 7),
    ):
        assert [trial.seed for trial in other.trials] != [trial.seed for trial in first.trials]
    assert len({trial.seed for trial in (*first.trials, *first.practice)}) == 49


def test_a_schedule_is_stored_and_read_without_change():
    order, limits = OrderSchedule.draw(PAPER, "03", 1, 7), LimitsSchedule.draw(PAPER, "03", 1, 7)
    assert OrderSchedule.from_json(order.to_json(), "a") == order
    assert LimitsSchedule.from_json(limits.to_json(), "a") == limits
    for kind in (OrderSchedule, LimitsSchedule):
        for text in ("", "[]", "{}", '{"trials": 3, "series": 3}'):
            with pytest.raises(FileError, match=r"schedule\.json: not a schedule"):
                kind.from_json(text, "schedule.json")


@pytest.mark.parametrize("participant", ["Anna", "", "3a", "-1", "1234567", "٣"])
def test_a_participant_is_a_number(participant):
    with pytest.raises(SettingsError, match="names are not stored"):
        OrderSchedule.draw(PAPER, participant, 1, 0)


def test_references_come_in_a_latin_square_with_random_starts_and_a_third_more_series_are_for_catching():
    series = LimitsSchedule.draw(PAPER, "02", 1, 1).series
    ascending = [each for each in series if not each.catch]
    assert Counter(each.reference_n for each in ascending) == {0.5: 5, 1.0: 5, 1.5: 5}
    assert sum(each.catch for each in series) == 5
    for start in range(0, 15, 3):
        assert {each.reference_n for each in ascending[start : start + 3]} == {0.5, 1.0, 1.5}
    firsts = {LimitsSchedule.draw(PAPER, f"{number}", 1, 1).series for number in (1, 2, 3)}
    assert len(firsts) == 3
    starts = {each.start for number in range(1, 9) for each in LimitsSchedule.draw(PAPER, f"{number}", 1, 1).series}
    assert len(starts) > 10
    assert 0.0 <= min(starts) <= max(starts) <= PAPER.limits.start


WRONG = {
    "[order]\ntrails = 3": "unknown key 'order.trails' (did you mean 'trials'?)",
    "[order]\nbreach_forces_n = [2.0, 2.0, 5.0]": "order: the three breach forces must differ",
    "[order]\nbreach_forces_n = [2.0, 3.5, 6.0]": "order.breach_forces_n.2 is 6.0",
    "[order]\npractice = 1": "practice_pairs is more",
    '[link]\nforward = "wfi"': '"wfi" is not a preset',
    '[[condition]]\nname = "a"\ncodec = "deadbnd"': "condition 'a': unknown codec 'deadbnd'",
    '[condition]\nname = "a"': "write [[condition]]",
    '[[condition]]\nname = "a"\n[[condition]]\nname = "a"': "two conditions have the same name",
    "[limits]\nreferences_n = [3.4]": "the largest comparison is 4.76 N; the device reaches only 4.6 N",
    "[limits]\nstep = 0.5": "leave no room below largest",
    '[limits]\nmethod = "descending"': "'ascending' or 'up-down'",
    "[order": "not a TOML file",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_plan_is_refused_in_one_line_that_says_what_would_be_right(tmp_path, text):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises((SettingsError, FileError)) as error:
        find_plan(str(path))
    assert WRONG[text] in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_plan_that_does_not_exist_is_told_with_the_presets():
    with pytest.raises(SettingsError, match="choose paper, reachable or the path"):
        find_plan("papre")
    with pytest.raises(FileError, match=r"nowhere\.toml"):
        find_plan("nowhere.toml")


def test_the_reachable_forces_have_the_ratios_of_the_papers():
    paper, reachable = (PRESETS[name].order.breach_forces_n for name in ("paper", "reachable"))
    assert [force / reachable[0] for force in reachable] == pytest.approx([force / paper[0] for force in paper])
    assert max(reachable) < 4.6
