"""Which JND the ordering task uses: the participant's own where it can, and it says which and why."""

from dataclasses import replace

import pytest
from killed import settings_of
from made import rows

from hapticnet.errors import SettingsError
from hapticnet.perception import PAPER_WEBER_FRACTION
from hapticnet_experiment.analysis import analyse
from hapticnet_experiment.plan import PRESETS, JndPlan, LimitsPlan
from hapticnet_experiment.report import markdown
from hapticnet_experiment.session import law_of_participant, open_session, participant_path
from hapticnet_experiment.weber import participant_file


def measure(folder, fraction, *, name="03", **further):
    about = {"device": "given", "simulated": None, **further}
    path = participant_path(folder, name)
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        participant_file("03", LimitsPlan(), {1.0: [fraction, fraction]}, device_errors_n={}, **about).to_toml()
    )


def settings(folder, **change):
    return replace(settings_of(folder, 3), **{"resume": False, **change})


def with_use(folder, use):
    return settings(folder, plan=settings(folder).plan.model_copy(update={"jnd": JndPlan(measured=use)}))


@pytest.mark.parametrize("plan", ["paper", "reachable"])
def test_a_measured_jnd_is_used_by_both_plans_that_need_no_file(tmp_path, plan):
    measure(tmp_path, 0.025, device="serial:/dev/ttyACM0")  # today it has another port
    chosen = law_of_participant(settings(tmp_path, plan=PRESETS[plan], device="serial:auto"))
    assert chosen.law.weber_fraction == 0.025
    assert chosen.describe() == "1 JND is 2.5 %, at least 0.025 N, from participants/03.toml, measured"


@pytest.mark.parametrize(
    ("further", "why"),
    [
        ({"device": "sim"}, "participants/03.toml was measured with the device sim, not with given"),
        ({"simulated": "literature"}, "participants/03.toml is of the simulated observer literature"),
        ({"false_alarms": 5, "catch_pairs": 10}, "participants/03.toml is excluded: 5 of 10 pairs of equal forces"),
    ],
)
def test_a_jnd_of_another_device_or_an_observer_is_not_used_and_that_is_said(tmp_path, further, why):
    measure(tmp_path, 0.025, **further)
    chosen = law_of_participant(settings(tmp_path))
    assert chosen.law.weber_fraction == PAPER_WEBER_FRACTION
    assert chosen.source.startswith(f"the plan: {why}")
    with pytest.raises(SettingsError, match=f"requires the participant's own JND, but {why}"):
        law_of_participant(with_use(tmp_path, "required"))
    measure(tmp_path, 0.04, name="03-session-2")
    assert law_of_participant(settings(tmp_path)).source == "participants/03-session-2.toml, measured"


def test_a_plan_may_ignore_or_require_what_was_measured(tmp_path):
    chosen = law_of_participant(settings(tmp_path))
    assert (chosen.law.weber_fraction, chosen.source) == (PAPER_WEBER_FRACTION, "the plan: no JND was measured")
    with pytest.raises(SettingsError, match=r"03\.toml does not exist: measure it first"):
        law_of_participant(with_use(tmp_path, "required"))
    measure(tmp_path, 0.025)
    assert law_of_participant(with_use(tmp_path, "required")).law.weber_fraction == 0.025
    ignored = law_of_participant(with_use(tmp_path, "ignored"))
    assert (ignored.law.weber_fraction, ignored.source) == (
        PAPER_WEBER_FRACTION, "the plan, which ignores measured JNDs"
    )  # fmt: skip


def test_every_row_has_the_law_and_a_session_goes_on_with_that_of_its_begin(tmp_path):
    with open_session(settings(tmp_path), 0) as (flow, store):
        for row in flow.take_rows():
            store.append(row)
    assert {(row.weber_fraction, row.jnd_source) for row in store.rows} == {
        (PAPER_WEBER_FRACTION, "the plan: no JND was measured")
    }
    measure(tmp_path, 0.025)
    with open_session(settings(tmp_path, resume=True), 0) as (flow, _):
        (again,) = flow.take_rows()
    assert (again.weber_fraction, again.jnd_source) == (PAPER_WEBER_FRACTION, "the plan: no JND was measured")


def test_the_report_says_what_1_jnd_was_for_each_participant():
    made = [
        replace(row, weber_fraction=0.025, jnd_source="participants/02.toml, measured")
        if row.participant == "02"
        else replace(row, jnd_source="the plan: no JND was measured")
        for row in rows(people=2)
    ]
    text = markdown(analyse(made), title="x")
    assert "| 01 | 0.05 | 0.025 | the plan: no JND was measured |" in text
    assert "| 02 | 0.025 | 0.025 | participants/02.toml, measured |" in text
    assert "**1 JND differs between participants**: Weber fractions from 0.025 to 0.05" in text
