import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from lerobot_interface import DeviceNotConnectedError
from plugin_helpers import AT_REST, HANDS, Broken, Clock, remote, simulated, teleoperator, until

import hapticnet as hn
from hapticnet.errors import SettingsError
from lerobot_robot_hapticnet import Follower, HapticnetSimulatedConfig
from lerobot_robot_hapticnet.config import Joints
from lerobot_robot_hapticnet.link import Tool


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
        return seen == pytest.approx({"x.force": AT_REST, "x.pos": at_rest_mm}, rel=0.06)

    until(is_there)
    assert robot.get_observation()["x.pos"] == pytest.approx(20.0 - 1e3 * AT_REST / 300.0, abs=0.5)
    far.disconnect()
    assert not far.is_connected
    with pytest.raises(DeviceNotConnectedError, match="call connect"):
        far.get_observation()


def test_steps_of_an_action_are_made_small(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("lerobot_robot_hapticnet.link.time", SimpleNamespace(monotonic=clock))
    tool = Tool(Joints(), None)
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
    until(lambda: hand.get_action() == {"x.pos": 20.0} and still.force_n == pytest.approx(AT_REST, rel=0.06))
    assert far.send_action({"x.pos": 0.0}) == {"x.pos": 20.0}  # it is the hand that moves it
    until(lambda: far.get_observation()["x.force"] == pytest.approx(AT_REST, rel=0.06))
    hand.send_feedback({"x.force": 3.0})  # comes by the session
    far.disconnect()
    assert hand.is_connected
    ticks = hand.report()["ticks"]
    assert len(still.forces) > 0.9 * ticks > 30
    hand.disconnect()


def test_robot_and_hand_of_one_session_must_agree(tmp_path):
    far = remote(tmp_path, "127.0.0.1:1")
    with pytest.raises(
        SettingsError, match=r"share the session.*codec is 'raw' at one and 'motion-predictive' at the other"
    ):
        teleoperator(tmp_path, "127.0.0.1:1", codec="raw")
    assert not far.is_connected


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
        until(lambda: hand.get_action()["x.pos"] == pytest.approx(30.0 - 1e3 * pressed_n / spring, abs=2.0), 10.0)
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
    with pytest.raises(DeviceNotConnectedError, match="has force:1, but x, y need force:2"):
        hand.connect()
