"""Objects of the user's in the place of a fingertip device."""

import json
import math

import numpy as np
import pytest

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.base import Reading
from hapticnet.device.user import UserActuator, UserDevice, as_user_device
from hapticnet.errors import SettingsError, UserCodeError
from hapticnet.node.fingertip import Actuator, DeviceFound, DeviceLost, Fingertip


class Platform:
    """A platform on a finger that is 2 mm away and as stiff as 1 N/mm."""

    def __init__(self, answer=None, **attributes):
        self.answer, self.told = answer, []
        vars(self).update(attributes)

    def exchange(self, displacement_m, _):
        self.told.append(displacement_m)
        return self.answer() if self.answer else max(0.0, 1000.0 * (displacement_m - 0.002))


def test_a_class_with_exchange_is_a_device_that_the_force_loop_drives():
    fingertip = Fingertip(UserDevice(Platform()), ForceControlSettings())
    for now_us in range(0, 3_000_000, 1000):
        fingertip.press(1.5, now_us)
    assert fingertip.sensed_n == pytest.approx(1.5, abs=0.1)
    assert fingertip.next_event() == DeviceFound("Platform (own device)")


def test_displacements_stay_within_the_travel():
    made = Platform(travel_m=0.003)
    device = UserDevice(made)
    for displacement_m in (-1.0, 0.002, 1.0, math.nan, math.inf):
        device.exchange(displacement_m, 0)
    assert made.told == [0.0, 0.002, 0.003, 0.0, 0.0]


def test_a_device_without_a_reading_is_lost():
    device = UserDevice(Platform(lambda: None))
    fingertip = Fingertip(device, ForceControlSettings())
    assert device.exchange(0.001, 0) is None
    assert device.status == "it gives no reading"
    device.made.answer = None
    fingertip.press(1.0, 1000)
    device.made.answer = lambda: None
    fingertip.press(1.0, 2000)
    assert [type(fingertip.next_event()) for _ in range(2)] == [DeviceFound, DeviceLost]


def test_it_may_return_a_whole_reading_and_describe_itself():
    reading = Reading(3, 512.0, 1.0, 0.0015)
    device = UserDevice(Platform(lambda: reading, description="my rig", status="warm", max_force_n=2.0, travel_m=0.01))
    assert device.exchange(0.002, 5) is reading
    assert (device.description, device.status) == ("my rig", "warm")
    assert (device.capabilities.max_force_n, device.capabilities.travel_m) == (2.0, 0.01)


@pytest.mark.parametrize("answer", ["1", float("nan"), 1e300, (1.0,), Reading(0, 0.0, math.inf, 0.0), [None], 10**400])
def test_a_wrong_reading_and_what_it_raises_are_errors_of_the_user(answer):
    with pytest.raises(UserCodeError, match=r"^Platform.exchange returned .* a finite number \[N\], a Reading or"):
        UserDevice(Platform(lambda: answer)).exchange(0.0, 0)
    with pytest.raises(UserCodeError, match=r"^Platform.exchange raised ZeroDivisionError: .*test_device_user.py, "):
        UserDevice(Platform(lambda: 1 / 0)).exchange(0.0, 0)


@pytest.mark.parametrize(
    "attributes",
    [
        {"travel_m": 0.0},
        {"travel_m": 17},
        {"max_force_n": math.nan},
        {"travel_m": "5 mm"},
        {"grounded": 1},
        {"rate_hz": -1.0},
        {"slew_n_per_s": True},
    ],
)
def test_attributes_that_cannot_be_used_are_refused(attributes):
    with pytest.raises(SettingsError, match=r"^device own.py:Platform: [a-z_]+ (of the device )?is "):
        UserDevice(Platform(**attributes), "device own.py:Platform")


def test_what_it_says_of_itself_stays_on_one_line():
    class Leaving(Platform):
        @property
        def status(self):
            raise SystemExit(3)

    assert UserDevice(Platform(description="two\nlines\x1b[2J")).description == "two lines?[2J"
    assert UserDevice(Leaving()).status.startswith("reading status raised SystemExit: 3")


def test_its_report_never_spoils_the_report_of_the_run():
    def endless():
        whole = {}
        whole["itself"] = whole
        return whole

    assert UserDevice(Platform()).report() == {}
    assert UserDevice(Platform(report=lambda: {"volts": 5, "at": object})).report()["volts"] == 5
    for report in (lambda: 1 / 0, lambda: 3, endless, lambda: exit(3)):
        assert "Platform.report raised" in json.dumps(UserDevice(Platform(report=report)).report())


class Motor:
    """An actuator that renders a force by itself."""

    def __init__(self, answer=lambda _: None, **attributes):
        self.answer, self.told = answer, []
        vars(self).update(attributes)

    def apply(self, force_n, _):
        self.told.append(force_n)
        return self.answer(force_n)


def test_an_actuator_gets_forces_within_the_limits_and_rising_no_faster_than_they_allow():
    made = Motor(max_force_n=2.0)
    actuator = Actuator(as_user_device(made))
    for now_us in range(0, 100_000, 1000):
        actuator.press(3.0, now_us)
    assert made.told[0] == 0.0
    assert max(b - a for a, b in zip(made.told, made.told[1:], strict=False)) == pytest.approx(0.05)
    assert (made.told[-1], actuator.target_n, actuator.sensed_n, actuator.reading) == (2.0, 2.0, 2.0, None)
    for bad in (math.nan, -1.0, math.inf):
        actuator.press(bad, 100_000)
        assert made.told[-1] == 0.0
    assert actuator.next_event() == DeviceFound("Motor (own device)")
    assert actuator.next_event() is None
    report = actuator.report()
    assert report.pop("capabilities") == {
        "axes": 1, "max_force_n": 2.0, "slew_n_per_s": 50.0, "rate_hz": None, "travel_m": 0.005, "grounded": False,
    }  # fmt: skip
    assert report == {"description": "Motor (own device)", "status": "ready", "line": {}}


def test_what_an_actuator_senses_is_taken_and_checked():
    actuator = Actuator(UserActuator(Motor(lambda force_n: 0.9 * force_n)))
    for now_us in range(0, 100_000, 1000):
        actuator.press(1.0, now_us)
    assert actuator.sensed_n == pytest.approx(0.9)
    for answer in (lambda _: "1", lambda _: math.nan, lambda _: (1.0,)):
        with pytest.raises(UserCodeError, match=r"^Motor.apply returned .* a finite number \[N\] or None$"):
            UserActuator(Motor(answer)).apply((1.0,), 0)
    with pytest.raises(UserCodeError, match=r"^Motor.apply raised ZeroDivisionError: .*test_device_user.py, line"):
        UserActuator(Motor(lambda _: 1 / 0)).apply((1.0,), 0)


def test_the_method_says_which_kind_of_device_it_is():
    assert isinstance(as_user_device(Platform()), UserDevice)
    assert isinstance(as_user_device(Motor()), UserActuator)
    with pytest.raises(
        SettingsError, match=r"it: has neither exchange\(displacement_m, now_us\) nor apply\(force_n, n"
    ):
        as_user_device(object(), "it")


def test_a_master_drives_an_actuator_until_it_fails(loopback):
    from hapticnet.node.master import Failed, MasterNode, MasterSettings

    made = Motor()
    link = loopback()
    hand = link.master._operator
    link.master = MasterNode(hand, UserActuator(made), MasterSettings(), np.random.default_rng(1))
    link.run(2_000_000)
    assert max(made.told) > 0.5
    assert link.master.target_n == made.told[-1]
    made.answer = lambda _: 1 / 0
    link.run(500_000)
    events = []
    while (event := link.master.next_event()) is not None:
        events.append(event)
    assert [type(event) for event in events].count(Failed) == 1
    assert "Motor.apply raised ZeroDivisionError" in link.master.failure
    assert made.told[-1] == 0.0
