"""The session as a state machine: what comes when, what is stored, and what an abort or a crash changes."""

import pytest
from conducted import SMALL, Person, answer, played, presented

from hapticnet_experiment import screens
from hapticnet_experiment.rig import LIFTED, Fault, Meet, Pair
from hapticnet_experiment.schedule import LimitsSchedule, OrderSchedule
from hapticnet_experiment.screens import ScreenKind
from hapticnet_experiment.tasks import LimitsFlow, OrderFlow
from hapticnet_experiment.trial import Stimulus

CONSTANTS = {"participant": "03", "session": 1, "observer": None, "device": "given"}
LAW = {"weber_fraction": 0.07, "floor_n": 0.035}


def ordering(rows=(), plan=SMALL, now_us=0):
    return Person(OrderFlow(plan, OrderSchedule.draw(plan, "03", 1, 7), rows, now_us, CONSTANTS | LAW), now_us)


def limits(rows=(), plan=SMALL, now_us=0):
    return Person(LimitsFlow(plan, LimitsSchedule.draw(plan, "03", 1, 7), rows, now_us, CONSTANTS), now_us)


def varied(part, **values):
    return SMALL.model_copy(update={part: getattr(SMALL, part).model_copy(update=values)})


NO_PRACTICE = varied("order", practice=0, practice_pairs=0)


def test_a_session_runs_from_instructions_to_the_end_in_this_order():
    person = ordering()
    kinds = [screen.kind for screen in person.walk()]
    block = [ScreenKind.TRIAL, ScreenKind.TRIAL, ScreenKind.RATING]
    practice = [ScreenKind.PRACTICE, ScreenKind.MEET, *[ScreenKind.TRIAL, ScreenKind.FEEDBACK] * 2]
    pause = [ScreenKind.BREAK, ScreenKind.MEET]
    start = [ScreenKind.INSTRUCTIONS, ScreenKind.CONSENT]
    assert kinds == [*start, *practice, *block, *pause, *block, *pause, *block]
    events = [row.event for row in person.flow.rows]
    assert events.count("trial") == 6
    assert (events[:3], events[-1]) == (["begin", "consent", "meet"], "end")
    assert person.flow.failure is None


def test_consent_is_stored_with_the_hash_of_the_text_that_was_shown():
    person = ordering()
    person.press(screens.ENTER)
    assert person.flow.screen.text == SMALL.texts.agreement
    person.press(screens.YES)
    assert person.rows("consent")[0].text == screens.hash_of(SMALL.texts.agreement)


def test_an_answer_may_be_changed_until_enter_and_is_scored_in_whole_and_by_pairs():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    true = person.flow.trial.order
    wrong = true[1] + true[0] + true[2]
    person.press(screens.ENTER, true[0], true[0], "4", "x")  # only the second does anything
    assert person.flow.screen.typed == true[0]
    person.press(screens.BACKSPACE, screens.BACKSPACE, *wrong)
    assert not person.flow.answered
    person.press(screens.ENTER)
    assert person.flow.answered
    person.press(screens.BACKSPACE, screens.ESCAPE)  # too late
    person.complete(played(person.flow.activity, delivered=0.81))  # at least 80 % of the held force are enough
    row = person.rows("trial")[0]
    assert (row.order_true, row.order_answered, row.correct) == (true, wrong, 0)
    assert row.pairs_correct == 2
    assert row.key == f"{true[0]}<{wrong}"


def test_response_times_count_from_the_scene_and_from_the_first_contact():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    begun_us = person.now_us
    person.press(*person.flow.trial.order, screens.ENTER, after_s=2.0)
    person.complete(after_s=0.1)
    row = person.rows("trial")[0]
    assert row.response_time_s == pytest.approx(8.0)
    assert row.contact_to_answer_s == pytest.approx(7.0)
    assert (row.onset_s, row.duration_s) == pytest.approx((begun_us / 1e6, 8.1))


def test_the_conditions_reach_the_trial_but_no_screen():
    person = ordering()
    shown, laws = [], set()
    for screen in person.walk():
        shown.append(f"{screen}")
        if isinstance(stimulus := person.flow.activity, Stimulus):
            laws.add((person.flow.condition.name, stimulus.codec, stimulus.law.multiplier, stimulus.law.weber_fraction))
    assert laws == {
        ("practice", "raw", 1.0, 0.07),
        ("none", "raw", 1.0, 0.07),
        ("1 JND", "deadband", 1.0, 0.07),
        ("4 JND", "deadband", 4.0, 0.07),
    }
    for text in shown:
        assert "JND" not in text
        assert "deadband" not in text


def test_practice_comes_again_until_enough_pairs_are_right_or_its_rounds_are_over():
    person = ordering()
    for expected in (0, 1):
        person.go_on_to(ScreenKind.PRACTICE)
        assert ("once more" in person.flow.screen.text) == bool(expected)
        person.press(screens.ENTER)
        for _ in range(2):
            person.go_on_to(ScreenKind.TRIAL)
            answer(person.flow, person.flow.trial.order[::-1], person.now_us)
            person.complete()
            assert person.flow.screen.title == "Not quite"
            assert " ".join(person.flow.trial.order) in person.flow.screen.text
            person.press(screens.ENTER)
    assert person.flow.trial.condition is not None
    assert len(person.rows("practice")) == 4
    assert all(row.block is None and row.condition == "practice" for row in person.rows("practice"))


@pytest.mark.parametrize(
    ("outcome", "event", "reason", "why"),
    [
        (lambda _: Fault("the device was lost: unplugged"), "aborted", "the device was lost: unplugged", "fault"),
        (lambda stimulus: played(stimulus, failure="the link was lost"), "aborted", "the link was lost", "fault"),
        (lambda stimulus: played(stimulus, failure=LIFTED), "aborted", LIFTED, "lifted"),
        (lambda stimulus: played(stimulus, delivered=0.79), "repeated", "the device delivered", "undelivered"),
        (lambda stimulus: played(stimulus, touched=(True, False, True)), "repeated", "tissue 2 was", "untouched"),
    ],
)
def test_a_trial_in_vain_is_stored_and_comes_again_at_the_end_of_its_block_after_meeting_the_finger(
    outcome, event, reason, why
):
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    vain = person.flow.trial
    answer(person.flow, vain.order, person.now_us)
    person.complete(outcome(person.flow.activity))
    row = person.rows(event)[0]
    assert (row.this_n, row.attempt) == (vain.index, 0)
    assert row.reason.startswith(reason)
    assert person.flow.screen.kind is ScreenKind.REPEAT
    assert SMALL.texts.why[why] in person.flow.screen.text
    person.press(screens.ENTER)
    assert isinstance(person.flow.activity, Meet)
    person.go_on_to(ScreenKind.RATING)
    assert [each.this_n for each in person.rows("trial")] == [vain.index + 1, vain.index]
    assert person.rows("trial")[-1].attempt == 1


def test_escape_stops_a_trial_at_once_and_between_trials_the_session():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    person.press("1", screens.ESCAPE)
    assert person.flow.answered
    person.complete(played(person.flow.activity))
    row = person.rows("aborted")[0]
    assert (row.reason, row.order_answered) == ("the participant stopped", None)
    person.press(screens.ESCAPE, after_s=0.9)  # pressed twice by mistake
    assert not person.flow.done
    person.press(screens.ESCAPE, after_s=0.2)
    assert person.flow.done
    assert person.flow.failure == "the participant ended the session"
    assert person.rows("stopped")[0].reason == person.flow.failure
    again = ordering(person.flow.rows, plan=NO_PRACTICE).go_on_to(ScreenKind.DONE)
    assert len(again.rows("trial")) == 6


def test_a_trial_without_an_answer_is_aborted():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    person.press("1", "2")
    person.complete()
    assert person.rows("aborted")[0].reason == "no answer within 180 s"


def test_a_device_that_fails_again_and_again_interrupts_the_session():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    index = person.flow.trial.index
    while not person.flow.done:
        person.go_on_and_answer()
        vain = person.flow.trial.index == index
        person.complete(played(person.flow.activity, delivered=0.5 if vain else 1.0))
        if not person.flow.done and person.flow.screen.kind is ScreenKind.REPEAT:
            person.press(screens.ENTER)
    assert person.flow.failure.startswith(f"trial {index} failed 3 times")
    again = ordering(person.flow.rows, plan=NO_PRACTICE).go_on_to(ScreenKind.DONE)
    assert sorted(row.this_n for row in again.rows("trial")) == list(range(6))


def test_a_platform_that_does_not_meet_the_finger_interrupts_the_session():
    person = ordering()
    for attempt in range(3):
        person.go_on_to(ScreenKind.MEET)
        person.complete(Fault("the platform does not meet a finger"))
        assert person.flow.done == (attempt == 2)
        person.press(screens.ENTER)
    assert person.flow.failure == "the platform does not meet a finger"
    assert person.rows("meet") == []


def test_a_break_cannot_be_cut_short():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.BREAK)
    person.press(screens.ENTER, after_s=4.9)
    assert person.flow.screen.kind is ScreenKind.BREAK
    person.press(screens.ENTER, after_s=0.2)
    assert isinstance(person.flow.activity, Meet)
    assert person.rows("break")[0].duration_s == pytest.approx(5.1)


def test_a_rating_is_stored_with_the_condition_of_its_block():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.RATING)
    person.press("8", "6")
    row = person.rows("rating")[0]
    assert (row.rating, row.block) == (6, 0)
    assert row.condition == person.rows("trial")[0].condition


@pytest.mark.parametrize("make", [ordering, limits])
def test_a_session_goes_on_after_any_row_and_asks_nothing_twice(make):
    whole = make().go_on_to(ScreenKind.DONE)
    rows = whole.flow.rows
    over = make(rows)
    assert (over.flow.done, over.flow.take_rows()) == (True, [])
    expected = [row.this_n for row in rows if row.event in ("trial", "practice")]
    for cut in range(len(rows)):
        again = make(rows[:cut], now_us=5_000_000)
        again.now_us = 5_000_000
        again.go_on_to(ScreenKind.DONE)
        asked = [row.this_n for row in again.flow.rows if row.event in ("trial", "practice")]
        killed = [row for row in again.rows("aborted") if row.reason == "the process ended during the trial"]
        if cut and rows[cut - 1].event == "started":  # it is told, and comes again at the end of its block
            assert [(row.this_n, row.seed) for row in killed] == [(rows[cut - 1].this_n, rows[cut - 1].seed)]
            assert sorted(asked) == sorted(expected)
        else:
            assert killed == []
            assert asked == expected
        for event in ("consent", "rating", "break"):
            assert len(again.rows(event)) == len(whole.rows(event))
        onsets = [row.onset_s for row in again.flow.rows]
        assert onsets == sorted(onsets)


def test_each_pair_of_forces_is_asked_about_and_the_jnd_follows():
    person = limits().go_on_to(ScreenKind.QUESTION)
    assert person.flow.screen.title == "Same or different?"
    while not person.flow.done:
        person.go_on_to(ScreenKind.QUESTION)
        row_before = len(person.rows("trial"))
        different = person.flow.presented.held_n[1] - person.flow.presented.held_n[0] > 0.09
        person.press(screens.DIFFERENT if different else screens.SAME)
        assert len(person.rows("trial")) == row_before + 1
    assert person.flow.procedure.by_reference() == {1.0: pytest.approx([0.1, 0.1]), 2.0: pytest.approx([0.1, 0.1])}
    assert person.flow.done


def test_an_answer_is_taken_only_when_the_needle_was_pushed_into_each_tissue():
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    surface_m = person.flow.activity.surfaces_m[2]
    for deepest_m, untouched in ((0.0, 1), (surface_m - 0.001, 3), (surface_m + 0.001, 3)):
        person.flow.deepest_m = deepest_m
        person.press(*("123" if not person.flow.screen.typed else ""), screens.ENTER)
        assert not person.flow.answered
        assert f"tissue {untouched} " in person.flow.screen.remark
    person.flow.deepest_m = surface_m + 0.006
    person.press(screens.ENTER)
    assert person.flow.answered


@pytest.mark.parametrize(("keys", "words"), [(("1", "2", "3", screens.ENTER), "taken"), ((screens.ESCAPE,), "is off")])
def test_a_participant_sees_at_once_that_an_answer_or_a_stop_was_taken(keys, words):
    person = ordering(plan=NO_PRACTICE).go_on_to(ScreenKind.TRIAL)
    person.press(*keys)
    assert person.flow.screen.kind is ScreenKind.MOMENT
    assert words in person.flow.screen.text
    assert isinstance(person.flow.activity, Stimulus)


def test_feedback_stays_when_enter_is_pressed_twice():
    person = ordering().go_on_to(ScreenKind.FEEDBACK)
    person.press(screens.ENTER, after_s=0.5)
    assert person.flow.screen.kind is ScreenKind.FEEDBACK
    person.press(screens.ENTER, after_s=0.6)
    assert person.flow.screen.kind is ScreenKind.TRIAL


def test_a_study_without_consent_on_the_screen_stores_why():
    plan = SMALL.model_copy(update={"consent": "none, because each participant signs a form"})
    person = ordering(plan=plan)
    person.press(screens.ENTER)
    assert person.rows("consent")[0].text == plan.consent
    assert person.flow.screen.kind is ScreenKind.PRACTICE


@pytest.mark.parametrize(
    ("method", "words"),
    [("ascending", "If you are not sure that they differ, say same."), ("up-down", "If you are not sure, guess.")],
)
def test_who_is_not_sure_is_told_what_to_say_wherever_that_decides(method, words):
    person = limits(plan=varied("limits", method=method))
    assert words in person.flow.screen.text
    assert words in person.go_on_to(ScreenKind.QUESTION).flow.screen.text


def test_a_pair_that_the_device_missed_is_presented_again_and_not_asked_about():
    person = limits().go_on_to(ScreenKind.STIMULI)
    assert isinstance(person.flow.activity, Pair)
    question = person.flow.procedure.question()
    person.complete(presented(person.flow.activity, error_n=0.4))
    row = person.rows("repeated")[0]
    assert "was felt as" in row.reason
    assert row.sensed_1_n == pytest.approx(row.held_1_n + 0.4)
    person.press(screens.ENTER)
    assert isinstance(person.flow.activity, Meet)
    person.complete()
    person.complete()
    assert person.flow.screen.kind is ScreenKind.QUESTION
    assert person.flow.procedure.question() == question


def test_a_device_that_misses_every_pair_interrupts_the_measurement():
    person = limits()
    while not person.flow.done:
        person.go_on_to(ScreenKind.STIMULI)
        person.complete(presented(person.flow.activity, error_n=0.4))
        if not person.flow.done:
            person.press(screens.ENTER)
    assert person.flow.failure.startswith("pair 0 failed 5 times")


def test_the_forced_choice_asks_for_the_stronger_of_two():
    person = limits(plan=varied("limits", method="up-down")).go_on_to(ScreenKind.QUESTION)
    assert person.flow.screen.title == "Which was stronger?"
    first_n, second_n = person.flow.presented.held_n
    person.press("1" if first_n > second_n else "2")
    assert person.rows("trial")[0].correct == 1
    person.go_on_to(ScreenKind.DONE)
    assert len(person.flow.procedure.thresholds) == 4
