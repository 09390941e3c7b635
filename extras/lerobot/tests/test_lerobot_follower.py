import pytest
from plugin_helpers import AT_REST, Clock, follower, play

import hapticnet as hn
from hapticnet.errors import SettingsError, UnavailableError
from lerobot_robot_hapticnet import Follower


@pytest.mark.parametrize(
    ("options", "at_rest"), [({}, AT_REST), ({"reports_force": False, "stiffness": 300.0}, AT_REST)]
)
def test_the_robot_follows_and_its_force_or_tracking_error_is_felt(tmp_path, options, at_rest):
    clock = Clock()
    scene = follower(tmp_path, clock, **options)
    assert play(scene, clock, (0.0,), 0.1) == [0.0]
    assert play(scene, clock, (0.020,), 2.0)[0] == pytest.approx(at_rest, rel=0.01)
    assert play(scene, clock, (0.005,), 2.0)[0] == pytest.approx(0.0, abs=0.01)


def test_three_joints_move_and_the_sign_of_units_turns_one_round(tmp_path):
    clock = Clock()
    scene = follower(tmp_path, clock, joints="x+y+z", reports_force=False)
    assert scene.parts == ("force:3",)
    play(scene, clock, (0.0, 0.0, 0.0), 0.1)
    force_n = play(scene, clock, (0.020, -0.01, 0.003), 2.0)
    assert force_n == pytest.approx([200.0 * 0.02 / 3.0, 0.0, 0.0], abs=0.02)
    seen = scene._robot.get_observation()
    assert seen["y.pos"] == pytest.approx(-10.0, abs=0.1)
    assert seen["z.pos"] == pytest.approx(3.0, abs=0.1)


def test_a_hand_takes_the_robot_where_it_is_and_moves_it_no_faster_than_allowed(tmp_path):
    clock = Clock()
    scene = follower(tmp_path, clock, lag_s=0.0, speed=0.05)
    play(scene, clock, (0.3,), 0.2)
    assert scene._robot.get_observation()["x.pos"] == 0.0
    play(scene, clock, (0.308,), 0.1)
    assert scene._robot.get_observation()["x.pos"] == pytest.approx(5.0, abs=1.0)
    play(scene, clock, (0.308,), 0.3)
    assert scene._robot.get_observation()["x.pos"] == pytest.approx(8.0, abs=0.01)


def test_without_positions_the_robot_stays_where_it_is_and_pushes_less(tmp_path, caplog):
    clock = Clock()
    scene = follower(tmp_path, clock)
    play(scene, clock, (0.0,), 0.1)
    assert play(scene, clock, (0.020,), 1.0)[0] > 1.5
    for _ in range(300):
        clock.now_s += 0.016
        scene.cycle()
    assert scene._robot.get_observation()["x.force"] < 0.35 * AT_REST
    assert [each.message for each in caplog.records] == [
        "LeRobot hapticnet_simulated: no positions for 0.5 s; it stays where it is"
    ]
    assert play(scene, clock, (0.020,), 0.02)[0] < 0.5 * AT_REST  # it returns to the hand at its speed
    assert play(scene, clock, (0.020,), 1.0)[0] == pytest.approx(AT_REST, rel=0.01)


def test_a_robot_that_does_not_answer_is_felt_no_longer(tmp_path):
    clock = Clock()
    scene = follower(tmp_path, clock)
    play(scene, clock, (0.0,), 0.1)
    play(scene, clock, (0.020,), 1.0)
    clock.now_s += 0.15
    half = scene.step(hn.PositionSample(0, (0.020,)))[0]
    assert 0.3 * AT_REST < half < 0.7 * AT_REST
    clock.now_s += 0.1
    assert scene.step(hn.PositionSample(0, (0.020,))) == [0.0]
    clock.now_s += 0.8
    with pytest.raises(UnavailableError, match=r"has not answered for 1 s"):
        scene.step(hn.PositionSample(0, (0.020,)))


def test_a_second_master_is_refused_while_one_moves_the_robot(tmp_path):
    clock = Clock()
    scene = follower(tmp_path, clock)
    scene.welcome("first")
    play(scene, clock, (0.0,), 0.1)
    with pytest.raises(UnavailableError, match="another master moves"):
        scene.welcome("second")
    scene.welcome("first")  # with another codec
    clock.now_s += 1.0
    scene.welcome("second")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"type": "none"}, "LeRobot knows no robot 'none'; it knows: .*hapticnet_simulated"),
        ({"type": "hapticnet_simulated", "port": 1}, "LeRobot cannot make 'hapticnet_simulated': TypeError"),
        ({"type": "hapticnet_simulated", "joints": "q"}, r"has no q\.pos; it has: x\.pos"),
        ({"type": "hapticnet_simulated", "joints": "a+b+c+d"}, "must be one to three names"),
        ({"type": "hapticnet_simulated", "units_per_m": 0.0}, "must be a number other than 0"),
        ({"type": "hapticnet_simulated", "speed": -1.0}, "speed"),
    ],
)
def test_what_cannot_be_followed_is_said_at_once(options, said):
    with pytest.raises(SettingsError, match=said):
        Follower(**options)


def test_it_is_a_scene_of_the_command_line():
    link = hn.virtual_link(
        scene="lerobot_robot_hapticnet:Follower:type=hapticnet_simulated,units_per_m=1000", codec="raw"
    )
    link.run(seconds=0.2)
    assert link.report().scene == "LeRobot hapticnet_simulated"
