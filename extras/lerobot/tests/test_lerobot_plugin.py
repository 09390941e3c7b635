import threading
import time
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from lerobot_interface import REAL, DeviceNotConnectedError

import hapticnet as hn
from hapticnet.errors import SettingsError, UnavailableError
from lerobot_robot_hapticnet import (
    Follower,
    HapticnetRobot,
    HapticnetRobotConfig,
    HapticnetSimulated,
    HapticnetSimulatedConfig,
    HapticnetTeleoperator,
    HapticnetTeleoperatorConfig,
)
from lerobot_robot_hapticnet.link import Tool

AT_REST = 2.0  # N at a goal 20 mm: servo 300 N/m and wall 600 N/m in series, 10 mm deep


class Clock:
    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


class Still:
    """A hand that is held at a place."""

    def __init__(self, to=0.0):
        self.to, self.force_n, self.forces = to, 0.0, []

    def feel(self, _t_us, force_n):
        (self.force_n,) = force_n
        self.forces.append(self.force_n)

    def sample(self, t_us):
        return self.to * min(t_us / 200_000, 1.0)


HANDS = []


def made_hand(to=0.0):
    HANDS.append(Still(to))
    return HANDS[-1]


@pytest.fixture(autouse=True)
def _own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    HANDS.clear()


def simulated(tmp_path, clock=None, **config):
    robot = HapticnetSimulated(HapticnetSimulatedConfig(id="it", calibration_dir=tmp_path, **config))
    if clock is not None:
        robot.clock = clock
    return robot


def follower(tmp_path, clock, **options):
    own = {key: options.pop(key) for key in ("reports_force", "lag_s", "joints") if key in options}
    given = {"joints": own["joints"]} if "joints" in own else {}
    return Follower(simulated(tmp_path, clock, **own), units_per_m=1000.0, clock=clock, **given, **options)


def play(scene, clock, position_m, seconds, hz=1000):
    """Hold a position, and return the force at the end."""
    force_n = None
    for tick in range(round(seconds * hz)):
        clock.now_s += 1.0 / hz
        if tick % 16 == 0:
            scene.cycle()
        force_n = scene.step(hn.PositionSample(round(1e6 * clock.now_s), position_m))
    return force_n


def remote(tmp_path, address, **more):
    return HapticnetRobot(
        HapticnetRobotConfig(id="far", calibration_dir=tmp_path, address=address, units_per_m=1000.0, **more)
    )


def teleoperator(tmp_path, address="", **more):
    more = {"hand": f"{__name__}:made_hand:to=0.02", "units_per_m": 1000.0, **more}
    return HapticnetTeleoperator(
        HapticnetTeleoperatorConfig(id="hand", calibration_dir=tmp_path, address=address, **more)
    )


def until(true, seconds=10.0):
    end_s = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end_s, "it took too long"
        time.sleep(0.01)


@pytest.fixture
def beside(tmp_path):
    """A slave beside a simulated robot."""
    robot = simulated(tmp_path)
    scene = Follower(robot, units_per_m=1000.0)
    with hn.ThreadedSlave(scene, listen="127.0.0.1:0") as slave:
        yield slave, robot, scene
    scene.close()


# The scene beside the robot


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
    assert scene.axes == 3
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


# Both ends


def test_an_action_moves_the_robot_and_its_force_is_observed(tmp_path, beside):
    slave, robot, _ = beside
    far = remote(tmp_path, slave.address, stiffness_n_per_m=300.0)
    assert far.action_features == {"x.pos": float}
    assert far.observation_features == {"x.pos": float, "x.force": float}
    far.connect()
    assert far.send_action({"x.pos": 20.0}) == {"x.pos": 20.0}

    def is_there():
        far.send_action({"x.pos": 20.0})
        seen, at_rest_mm = far.get_observation(), 20.0 - 1e3 * AT_REST / 300.0
        return seen == pytest.approx({"x.force": AT_REST, "x.pos": at_rest_mm}, rel=0.05)

    until(is_there)
    assert robot.get_observation()["x.pos"] == pytest.approx(20.0 - 1e3 * AT_REST / 300.0, abs=0.5)
    far.disconnect()
    assert not far.is_connected
    with pytest.raises(DeviceNotConnectedError, match="call connect"):
        far.get_observation()


def test_steps_of_an_action_are_made_small(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("lerobot_robot_hapticnet.link.time", SimpleNamespace(monotonic=clock))
    tool = Tool(1, None)
    for tick in range(700):
        if tick % 33 == 0:
            tool.move((0.3e-3 * (tick // 33),))
        clock.now_s += 0.001
        tool.sample(1000 * tick)
    past = np.array([at for _, (at,) in tool.past])
    assert past[-1] > 5e-3
    assert np.abs(np.diff(past)).max() < 2e-5


def test_a_policy_that_sends_nothing_lets_go(tmp_path, beside, caplog):
    slave, _, _ = beside
    far = remote(tmp_path, slave.address)
    far.connect()
    until(lambda: far.send_action({"x.pos": 20.0}) and far.get_observation()["x.force"] > 1.0)
    until(lambda: far.get_observation()["x.force"] < 0.2, 20.0)
    assert [each.message for each in caplog.records if "action" in each.message] == [
        "no action for 0.5 s: the tool lets go until there is one"
    ]
    far.disconnect()


@pytest.mark.parametrize("action", [{"x.pos": float("nan")}, {"y.pos": 1.0}, {"x.pos": None}])
def test_an_action_that_is_no_position_is_refused_and_moves_nothing(tmp_path, beside, action):
    slave, robot, _ = beside
    far = remote(tmp_path, slave.address)
    far.connect()
    with pytest.raises(ValueError, match=r"not finite|must have a number as x\.pos"):
        far.send_action(action)
    assert robot.get_observation()["x.pos"] == 0.0
    far.disconnect()


@pytest.mark.parametrize("robot_first", [True, False])
def test_the_hand_moves_the_robot_of_its_address_at_every_tick_and_feels_it(tmp_path, beside, robot_first):
    slave, _, _ = beside
    far, hand = remote(tmp_path, slave.address), teleoperator(tmp_path, slave.address)
    for each in (far, hand) if robot_first else (hand, far):  # lerobot-record, and lerobot-teleoperate
        each.connect()
    assert hand.feedback_features == {}
    (still,) = HANDS
    until(lambda: hand.get_action() == {"x.pos": 20.0} and still.force_n == pytest.approx(AT_REST, rel=0.05))
    assert far.send_action({"x.pos": 0.0}) == {"x.pos": 20.0}  # it is the hand that moves it
    assert far.get_observation()["x.force"] == pytest.approx(still.force_n, abs=0.2)
    hand.send_feedback({"x.force": 3.0})  # comes by the session
    far.disconnect()
    assert hand.is_connected
    hand.disconnect()
    assert len(still.forces) > 100


def test_robot_and_hand_of_one_session_must_agree(tmp_path):
    far = remote(tmp_path, "127.0.0.1:1")
    with pytest.raises(
        SettingsError, match=r"share the session.*codec is 'raw' at one and 'motion-predictive' at the other"
    ):
        teleoperator(tmp_path, "127.0.0.1:1", codec="raw")
    assert not far.is_connected


class Broken(HapticnetSimulated):
    how = ""

    def get_observation(self):
        if self.how == "unplugged":
            raise OSError(5, "Input/output error")
        return {**super().get_observation(), **({self.how: float("nan")} if self.how else {})}


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("unplugged", "stopped: OSError: .*Input/output error"),
        ("x.force", "stopped: ValueError: it reports a force that is not finite"),
        ("x.pos", "not finite"),
    ],
)
def test_a_robot_that_breaks_ends_the_session_with_zero_force_and_one_line(tmp_path, how, said):
    robot = Broken(HapticnetSimulatedConfig(id="it", calibration_dir=tmp_path))
    scene = Follower(robot, units_per_m=1000.0)
    with hn.ThreadedSlave(scene, listen="127.0.0.1:0") as slave:
        hand = teleoperator(tmp_path, slave.address)
        hand.connect()
        (still,) = HANDS
        until(lambda: still.force_n > 1.0)
        robot.how = how
        with pytest.raises(DeviceNotConnectedError, match=said) as error:
            until(lambda: not hand.get_action())
        assert "\n" not in str(error.value)
        until(lambda: still.force_n == 0.0)
        hand.disconnect()
    scene.close()


def test_a_slave_that_disappears_lets_the_force_decay(tmp_path, caplog):
    scene = Follower(simulated(tmp_path), units_per_m=1000.0)
    slave = hn.TickedSlave(scene, listen="127.0.0.1:0")
    hand = teleoperator(tmp_path, slave.address)
    going = threading.Event()

    def run():
        while not going.wait(0.0005):
            slave.tick()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    hand.connect()
    (still,) = HANDS
    until(lambda: still.force_n > 1.0)
    going.set()  # it says nothing more
    thread.join()
    until(lambda: still.force_n == 0.0)
    until(lambda: hand.get_action() and any("nothing arrives" in each.message for each in caplog.records))
    hand.disconnect()
    slave.close()
    scene.close()


def test_without_a_slave_connecting_fails_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot_robot_hapticnet.link._Master.connect_timeout_s", 0.3)
    far = remote(tmp_path, "127.0.0.1:9")
    with pytest.raises(DeviceNotConnectedError, match=r"no session with 127\.0\.0\.1:9 within") as error:
        far.connect()
    assert "\n" not in str(error.value)
    assert not far.is_connected


def test_an_inverse3_feels_the_robot_and_a_breakdown_takes_the_force_away(tmp_path):
    inverse3 = pytest.importorskip("tests.runtime.inverse3", reason="needs the tests of hapticnet")
    robot = Broken(HapticnetSimulatedConfig(id="it", calibration_dir=tmp_path))
    scene = Follower(robot, units_per_m=1000.0)
    spring, series = inverse3.HAND.stiffness_n_per_m, 200.0  # N/m; the spring pushes 30 mm down
    pressed_n = spring * series / (spring + series) * 0.020
    with hn.ThreadedSlave(scene, listen="127.0.0.1:0") as slave, inverse3.StandIn() as device:
        hand = teleoperator(tmp_path, slave.address, hand=f"haply:{device.address},max-force=4")
        hand.connect()
        until(lambda: device.force == pytest.approx(pressed_n, rel=0.1), 10.0)
        assert hand.get_action()["x.pos"] == pytest.approx(30.0 - 1e3 * pressed_n / spring, abs=2.0)
        robot.how = "unplugged"
        until(lambda: device.force == 0.0)
        hand.disconnect()
    scene.close()


# A hand beside a robot of the user's own loop


def test_feedback_reaches_the_hand_and_is_felt_while_it_is_fresh(tmp_path, caplog):
    hand = teleoperator(tmp_path, coupling="direct")
    assert hand.feedback_features == {"x.force": float}
    hand.connect()
    (still,) = HANDS
    until(
        lambda: (
            hand.send_feedback({"x.force": 1.5, "x.pos": 3.0}) is None and still.force_n == pytest.approx(1.5, abs=0.01)
        )
    )
    until(lambda: still.force_n == 0.0)
    until(lambda: any(each.message == "no feedback for 0.2 s: the force is zero" for each in caplog.records))
    hand.send_feedback({"x.force": float("nan")})
    with pytest.raises(ValueError, match=r"x\.force"):
        hand.send_feedback({"y.force": 1.0})
    until(lambda: hand.get_action() == {"x.pos": 20.0})
    hand.disconnect()


def test_the_coupling_keeps_a_yielding_hand_from_being_pushed_by_more_than_it_put_in(tmp_path):
    hand = teleoperator(tmp_path, hand="hand:arm")
    hand.connect()
    for _ in range(15):
        hand.send_feedback({"x.force": 1.0})
        time.sleep(1 / 30)
    assert hand.report()["coupling"]["name"] == "energy-bounded"
    hand.disconnect()


def test_a_hand_of_other_axes_is_refused(tmp_path):
    hand = teleoperator(tmp_path, joints="x+y")
    with pytest.raises(DeviceNotConnectedError, match="has 1 axes, but there are 2 joints"):
        hand.connect()


# LeRobot's own loops, where it is installed


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_lerobots_own_loop_records_what_the_hand_feels(tmp_path, beside, monkeypatch):
    import sys

    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.scripts import lerobot_record

    slave, _, _ = beside
    arguments = [
        "lerobot-record", "--robot.type=hapticnet", f"--robot.address={slave.address}", "--robot.units_per_m=1000",
        "--teleop.type=hapticnet", f"--teleop.address={slave.address}", "--teleop.units_per_m=1000",
        f"--teleop.hand={__name__}:made_hand:to=0.02", "--dataset.repo_id=me/felt", f"--dataset.root={tmp_path}/set",
        "--dataset.single_task=press", "--dataset.num_episodes=1", "--dataset.episode_time_s=2",
        "--dataset.push_to_hub=false", "--dataset.video=false", "--play_sounds=false",
    ]  # fmt: skip
    monkeypatch.setattr(sys, "argv", arguments)
    lerobot_record.record()
    frames = LeRobotDataset("me/felt", root=tmp_path / "set")
    assert len(frames) > 30
    names = frames.meta.features["observation.state"]["names"]
    felt = [float(each["observation.state"][names.index("x.force")]) for each in frames]
    assert felt[-1] == pytest.approx(AT_REST, rel=0.1)
    assert np.ravel(frames[len(frames) - 1]["action"])[0] == pytest.approx(20.0)


class Bus:
    """Plays the bus of an SO-101 whose elbow is blocked at 5 degrees; the gripper is open."""

    is_calibrated = True

    def __init__(self, port, motors, calibration=None):  # noqa: ARG002 - LeRobot gives it
        self.port, self.motors, self.is_connected = port, motors, False
        self.goals = {name: 50.0 if name == "gripper" else 0.0 for name in motors}

    def connect(self):
        self.is_connected = True

    def disconnect(self, _disable_torque):
        self.is_connected = False

    def torque_disabled(self):
        return nullcontext()

    def configure_motors(self):
        pass

    def write(self, *_):
        pass

    def sync_write(self, _name, values):
        self.goals |= values

    def sync_read(self, _name):
        return {**self.goals, "elbow_flex": min(self.goals["elbow_flex"], 5.0)}


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_an_so_101_follows_with_one_joint_and_its_tracking_error_is_felt(tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.robots.so_follower.so_follower.FeetechMotorsBus", Bus)
    clock = Clock()
    scene = Follower(
        "so101_follower", joints="elbow_flex", units_per_m=300.0, stiffness=100.0, clock=clock,
        port="/dev/none", id="arm", calibration_dir=tmp_path,
    )  # fmt: skip
    play(scene, clock, (0.0,), 0.1)
    assert play(scene, clock, (0.05,), 1.0) == pytest.approx([100.0 * 10.0 / 300.0])
    assert scene._robot.bus.goals == {
        "shoulder_pan": 0.0, "shoulder_lift": 0.0, "elbow_flex": pytest.approx(15.0), "wrist_flex": 0.0,
        "wrist_roll": 0.0, "gripper": 50.0,
    }  # fmt: skip
    scene.close()
    assert not scene._robot.is_connected


@pytest.mark.skipif(not REAL, reason="needs lerobot")
def test_lerobot_finds_the_plug_in_and_makes_both(tmp_path):
    from lerobot.robots import make_robot_from_config
    from lerobot.teleoperators import make_teleoperator_from_config

    robot = make_robot_from_config(HapticnetRobotConfig(calibration_dir=tmp_path))
    hand = make_teleoperator_from_config(HapticnetTeleoperatorConfig(calibration_dir=tmp_path, address=""))
    assert isinstance(robot, HapticnetRobot)
    assert isinstance(hand, HapticnetTeleoperator)
