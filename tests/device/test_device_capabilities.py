"""What devices declare, the limits that follow, and how a master says that it adapts."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapticnet as hn
from hapticnet.capabilities import Capabilities
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.device.user import UserActuator
from hapticnet.errors import SettingsError
from hapticnet.node.fingertip import MAY_SWING, Actuator, Rendering
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.base import UserOperator
from hapticnet.operator.haply import HaplyOperator, HaplySettings

FORCES = st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), min_size=1, max_size=50)


class Arm:
    """A device that renders a force on several axes."""

    def __init__(self, **attributes):
        self.told = []
        vars(self).update(attributes)

    def apply(self, force_n, now_us):
        self.told.append((now_us, force_n))


@given(FORCES)
def test_the_magnitude_rises_no_faster_and_no_further_than_the_device_declares(forces_n):
    arm = Arm(axes=3, max_force_n=8.0, slew_n_per_s=400.0, grounded=True)
    rendering = Rendering(UserActuator(arm), MasterSettings(), 3)
    before_n = 0.0
    for tick, force_n in enumerate(forces_n):
        target_n, _, _ = rendering.press(force_n, force_n, 1000 * tick, counts=False)
        size_n = math.hypot(*arm.told[-1][1])
        assert size_n == pytest.approx(target_n)
        assert size_n <= min(before_n + 0.4, 8.0, math.hypot(*force_n)) + 1e-9
        before_n = size_n


@pytest.mark.parametrize(
    ("attributes", "axes", "force_n", "shown"),
    [
        ({"axes": 3}, 3, (1.0, -2.0, 2.0), (1.0, -2.0, 2.0)),
        ({"axes": 3}, 1, (1.0,), (1.0, 0.0, 0.0)),
        ({"axes": 2}, 3, (1.0, -2.0, 2.0), (1.0, -2.0)),
        ({"grounded": True}, 1, (-1.0,), -1.0),
        ({}, 1, (-1.0,), 0.0),
        ({"max_force_n": 20.0}, 1, (15.0,), 15.0),
    ],
)
def test_what_a_device_declares_says_what_it_gets(attributes, axes, force_n, shown):
    arm = Arm(slew_n_per_s=math.inf, **attributes)
    rendering = Rendering(UserActuator(arm), MasterSettings(), axes)
    for now_us in (0, 1000):
        rendering.press(force_n, force_n, now_us, counts=False)
    assert arm.told[-1] == (1000, shown)


def test_a_slow_device_gets_forces_at_its_own_rate_but_zero_at_once():
    arm = Arm(rate_hz=100.0)
    actuator = Actuator(UserActuator(arm))
    for now_us in range(0, 55_000, 1000):
        actuator.press(1.0, now_us)
    assert [now_us for now_us, _ in arm.told] == [0, 10_000, 20_000, 30_000, 40_000, 50_000]
    actuator.press(0.0, 55_000)
    assert arm.told[-1] == (55_000, 0.0)


def test_a_hand_with_a_device_feels_no_more_than_that_declares():
    felt = []
    hand = UserOperator(SimpleNamespace(sample=lambda _: 0.0, feel=lambda _, f: felt.append(f), max_force_n=2.0))
    assert hand.capabilities == Capabilities(max_force_n=2.0, grounded=True)
    for force_n in (5.0, -5.0, 1.0, math.nan):
        hand.feel(0, (force_n,))
    assert felt == [(2.0,), (-2.0,), (1.0,), (0.0,)]
    plain = UserOperator(SimpleNamespace(sample=lambda _: 0.0, feel=lambda _, f: felt.append(f)))
    plain.feel(0, (50.0,))
    assert (felt[-1], plain.capabilities) == ((50.0,), Capabilities())


FINGERTIP = "the device takes 1 axis and 4.6 N, rising by at most 50 N/s: "
CLIPPED = "above that it is clipped"
PLANAR = Arm(axes=2, max_force_n=3.0, slew_n_per_s=math.inf, rate_hz=500.0)


@pytest.mark.parametrize(
    ("device", "axes", "takes", "line"),
    [
        ("sim", 3, "x", f"{FINGERTIP}the force along x is shown, {CLIPPED}"),
        ("sim", 1, "x", f"{FINGERTIP}above that the force is clipped"),
        ("sim", 3, "norm", f"{FINGERTIP}the size of the force is shown, {CLIPPED}"),
        (PLANAR, 3, "x", "the device takes 2 axes and 3 N, 500 times a second: the force along x and y is shown, "
         + CLIPPED),
        (Arm(axes=2, max_force_n=math.inf, slew_n_per_s=math.inf), 2, "x", "the device takes 2 axes"),
    ],
)  # fmt: skip
def test_how_the_force_is_adapted_is_said_in_one_line(device, axes, takes, line):
    made = SimulatedDevice(PlantSettings(), np.random.default_rng(1)) if device == "sim" else UserActuator(device)
    settings = MasterSettings(device_takes=takes)
    assert Rendering(made, settings, axes).adaptations(None, settings) == [line]


def test_a_device_that_moves_the_hand_is_warned_of_unless_there_is_a_coupling():
    hand = HaplyOperator(HaplySettings(axes=1)).capabilities
    settings = MasterSettings(), MasterSettings(coupling="energy-bounded")
    direct, coupled = (Rendering(None, each, 1).adaptations(hand, each) for each in settings)
    (line,) = coupled
    assert line.startswith("the device in the hand takes 1 axis and 2 N, rising by at most 200 N/s: above that the")
    assert direct == [*coupled, MAY_SWING]


def test_the_report_and_the_program_are_told_as_well():
    arm = Arm(max_force_n=3.0)
    with (
        hn.ThreadedSlave("paper:1", listen="127.0.0.1:0") as slave,
        hn.ThreadedMaster(slave.address, device=arm) as master,
    ):
        (line,) = master.adaptations
        report = master.report()
    assert line.startswith("the device takes 1 axis and 3 N, rising by at most 50 N/s: above that")
    assert report["adaptations"] == [line]
    assert report["device"]["capabilities"]["max_force_n"] == 3.0


@pytest.mark.parametrize("values", [{"axes": 0}, {"max_force_n": 0.0}, {"rate_hz": math.nan}, {"grounded": 1}])
def test_invalid_capabilities_are_refused(values):
    with pytest.raises(SettingsError, match="of the device"):
        Capabilities(**values)
