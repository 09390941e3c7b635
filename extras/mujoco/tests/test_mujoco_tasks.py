"""What is felt of the tasks over a network, and a leader that the reflected force pushes."""

import sys
from pathlib import Path

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.samples import PositionSample
from hapticnet_mujoco import Leader, Pose, Task

sys.path.insert(0, str(Path(__file__).parents[1]))
import measure

AHEAD = {"codec": "motion-predictive", "predicted": True}


class Still:
    axes, duration_us = 7, None

    def __init__(self, *position):
        self.position = position

    def sample(self, t_us):
        return PositionSample(t_us, self.position)


@pytest.mark.parametrize("loss", ["", "2%"])
def test_the_grip_of_an_arm_is_felt_within_a_jnd_at_150_ms_and_few_bytes(loss):
    kilobytes, shares = measure.felt_of("armbench", Task("drawer"), loss, **AHEAD)
    every, felt = shares["grip"]
    assert every > 0.95
    assert felt > 0.9
    assert kilobytes < 10.0


def test_without_prediction_the_grip_comes_a_round_trip_late():
    _, shares = measure.felt_of("workbench", Task("screw"), codec="deadband")
    assert shares["grip"][0] < 0.92


def test_a_hand_that_holds_a_leader_gives_way_to_force_torque_and_grip():
    leader = Leader(intended=Still(0.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.02))
    for t_us in range(0, 1_000_000, 1000):
        leader.feel(t_us, (0.0,) * 7)
        at_rest = leader.sample(t_us).position_m
    assert at_rest == pytest.approx((0.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.02), abs=1e-3)
    for t_us in range(1_000_000, 3_000_000, 1000):
        leader.feel(t_us, (1.0, -2.0, 0.5, 0.0, 0.0, 0.15, -3.0))
        pushed = leader.sample(t_us).position_m
    moved = np.subtract(pushed, at_rest)
    # Against its axes: 500 N/m, 3 N·m/rad and 1000 N/m; a closed hand is pushed open
    assert moved[:3] == pytest.approx([-1.0 / 500.0, 2.0 / 500.0, -0.5 / 500.0], rel=0.05)
    assert moved[5] == pytest.approx(-0.15 / 3.0, rel=0.05)
    assert moved[6] == pytest.approx(3.0 / 1000.0, rel=0.05)


def test_a_leader_opens_a_drawer_of_a_follower_and_feels_it():
    scene = Pose("armbench", "palm", point="tip", grip="opening", force="contact")
    link = hn.virtual_link(scene=scene, operator=Leader(intended="drawer"), codec="deadband")
    link.run(seconds=5.5)
    assert scene._now.data.joint("rail").qpos[0] > 0.08  # of 0.1 m: the hand gives way
    held = link.master_samples()["held_grip_n"]
    # The hand's spring and the follower's are in series
    assert held[3500] == pytest.approx(-1000.0 * 0.006 / 2.0, rel=0.1)


def test_a_robot_that_stops_ends_the_session_of_a_leader_in_one_line():
    class Stops(Pose):
        def step(self, sample):
            if sample.t_us > 1_500_000:
                raise RuntimeError("the robot has stopped")
            return super().step(sample)

    scene = Stops("workbench", "palm", point="tip", grip="opening")
    link = hn.virtual_link(scene=scene, operator=Leader(intended="drawer"))
    with pytest.raises(UnavailableError, match=r"the scene failed: .*the robot has stopped") as failed:
        link.run(seconds=3.0)
    assert "\n" not in str(failed.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"intended": "door"}, "task is 'door'"),
        ({"grip": ""}, "the leader has 6 axes, but what it intends has 7"),
        ({"stiffness": 0.0}, "stiffness is 0"),
        ({"model": "none.xml"}, "no such file"),
    ],
)
def test_what_a_leader_cannot_use_is_said_in_one_sentence(given, said):
    with pytest.raises(SettingsError, match=said) as refused:
        Leader(**given)
    assert "\n" not in str(refused.value)
