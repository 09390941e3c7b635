"""Objects of the user's in the place of a fingertip device."""

import json
import math

import pytest

from hapticnet.control.force import ForceControlSettings
from hapticnet.control.limits import LimitSettings
from hapticnet.device.base import Reading
from hapticnet.device.user import UserDevice
from hapticnet.errors import SettingsError, UserCodeError
from hapticnet.node.fingertip import DeviceFound, DeviceLost, Fingertip


class Platform:
    """A platform on a finger that is 2 mm away and as stiff as 1 N/mm."""

    def __init__(self, answer=None, **attributes):
        self.answer, self.told = answer, []
        vars(self).update(attributes)

    def exchange(self, displacement_m, _):
        self.told.append(displacement_m)
        return self.answer() if self.answer else max(0.0, 1000.0 * (displacement_m - 0.002))


def test_a_class_with_exchange_is_a_device_that_the_force_loop_drives():
    fingertip = Fingertip(UserDevice(Platform()), LimitSettings(), ForceControlSettings())
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
    fingertip = Fingertip(device, LimitSettings(), ForceControlSettings())
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
    assert (device.description, device.status, device.max_force_n, device.travel_m) == ("my rig", "warm", 2.0, 0.01)


@pytest.mark.parametrize("answer", ["1", float("nan"), 1e300, (1.0,), Reading(0, 0.0, math.inf, 0.0), [None]])
def test_a_wrong_reading_is_an_error_of_the_user(answer):
    with pytest.raises(UserCodeError, match=r"^Platform.exchange returned .* a finite number \[N\], a Reading or"):
        UserDevice(Platform(lambda: answer)).exchange(0.0, 0)


def test_what_it_raises_is_told_with_its_line():
    with pytest.raises(UserCodeError, match=r"^Platform.exchange raised ZeroDivisionError: .*test_device_user.py, "):
        UserDevice(Platform(lambda: 1 / 0)).exchange(0.0, 0)


@pytest.mark.parametrize(
    "attributes", [{"travel_m": 0.0}, {"travel_m": 7}, {"max_force_n": math.nan}, {"travel_m": "5 mm"}]
)
def test_attributes_that_cannot_be_used_are_refused(attributes):
    with pytest.raises(SettingsError, match=r"^device own.py:Platform: (travel_m|max_force_n) is "):
        UserDevice(Platform(**attributes), "device own.py:Platform")


def test_its_report_never_spoils_the_report_of_the_run():
    def endless():
        whole = {}
        whole["itself"] = whole
        return whole

    assert UserDevice(Platform()).report() == {}
    assert UserDevice(Platform(report=lambda: {"volts": 5, "at": object})).report()["volts"] == 5
    for report in (lambda: 1 / 0, lambda: 3, endless):
        assert "Platform.report raised" in json.dumps(UserDevice(Platform(report=report)).report())
