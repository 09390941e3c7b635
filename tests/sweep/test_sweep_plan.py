"""What runs measure, and that they depend on nothing but the study and their number."""

import pickle

import numpy as np
import pytest

from hapticnet.channel.spec import parse_channel
from hapticnet.codec.registry import make_codec
from hapticnet.experiment.comparison import REPAIR_US
from hapticnet.measure.metrics import error_report
from hapticnet.node.closed_loop import simulate_link
from hapticnet.perception import WeberLaw
from hapticnet.sweep.plan import Runner, plan_of, rows_of
from hapticnet.sweep.runs import Shard
from hapticnet.sweep.study import read_study

SHORT = "scripted:insertions=1,approach_s=0.05,push_s=0.2,pause_s=0,withdraw_s=0.05,rest_s=0"


@pytest.fixture
def planned(tmp_path):
    def make(text):
        path = tmp_path / "study.toml"
        path.write_text(text)
        return plan_of(read_study(path))

    return make


def test_a_felt_run_is_what_feel_says_with_the_random_numbers_of_its_number(plan):
    runner = Runner(plan)
    row = rows_of(plan, runner, Shard(23, 24))[0]  # repeat 1, combination 7
    assert (row["run"], row["repeat"], row["codec"], row["multiplier"]) == (23, 1, "linear-predictive", 1.0)
    assert (row["delay_ms"], row["loss"], row["feedback"]) == (5.0, 0.1, "delay=5ms,jitter=normal:2ms,loss=10%")
    trial = plan.sources[0].recorded
    law = WeberLaw(multiplier=1.0)
    link = parse_channel(row["feedback"])
    felt = simulate_link(
        make_codec("linear-predictive", law),
        trial.t_us,
        trial.stimuli,
        trial.positions,
        forward=link,
        feedback=link,
        repair_us=REPAIR_US + 10_000,
        rng=np.random.default_rng(np.random.SeedSequence(entropy=7, spawn_key=(23,))),
    )
    assert (row["sent"], row["received"]) == (felt.sent, felt.received)
    assert row["felt_rmse_n"] == error_report(law, trial.stimuli, felt.applied).rmse_n
    assert row["felt_rms_jnd"] > row["coded_rmse_n"] > 0.0
    assert set(row) == set(plan.columns)
    other = pickle.loads(pickle.dumps(plan))  # noqa: S301 - of this test
    assert rows_of(other, Runner(other), Shard(23, 24)) == [row], "another worker, which did no run before"


def test_all_combinations_of_a_repeat_meet_the_same_hand_and_every_repeat_another(planned):
    plan = planned(
        f'name = "x"\nrepeats = 2\n[axes]\nhand = "{SHORT}"\nscene = ["paper:1", "paper:2"]\n'
        'multiplier = [1, 2]\nrepair = ["never", "round-trip"]\n'
    )
    rows = rows_of(plan, Runner(plan), Shard(0, plan.runs))
    by_hand = {(row["source"], row["repeat"]): row["coded_rmse_n"] for row in rows if row["multiplier"] == 1.0}
    assert len(set(by_hand.values())) == len(by_hand) == 4
    for row in rows:
        if row["multiplier"] == 1.0:
            assert row["coded_rmse_n"] == by_hand[row["source"], row["repeat"]]


def test_scenes_on_three_axes_are_palpated(planned):
    hand = "palpation:palpations=1,strokes=1,press_s=0.1,stroke_s=0.1,rest_s=0"
    plan = planned(f'name = "x"\n[axes]\nscene = "phantom"\nhand = "{hand}"\nrate_hz = 200\n')
    row = rows_of(plan, Runner(plan), Shard(0, 1))[0]
    assert row["error"] is None
    assert row["sent"] > 0
