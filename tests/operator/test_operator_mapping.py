"""The mapping between hand and scene, and its clutch."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapticnet as hn
from hapticnet.capabilities import Capabilities
from hapticnet.errors import SettingsError, UnavailableError, UserCodeError
from hapticnet.operator.base import UserOperator
from hapticnet.operator.mapping import FADE_US, RISE_US, Mapped, Mapping, mapped
from hapticnet.operator.remote import RemoteOperator
from hapticnet.parts import parse_parts
from hapticnet.perception import WeberLaw
from hapticnet.samples import ForceSample, PositionSample
from tests.conftest import linked
from tests.ready import wait_until

ANGLES = st.tuples(*[st.floats(-360.0, 360.0)] * 3)
PLACES = st.tuples(*[st.floats(-0.3, 0.3)] * 3)
SCALES = st.floats(0.01, 100.0)


class Hand:
    """A hand at a place, which notes what it feels."""

    duration_us = None

    def __init__(self, *at_m):
        self.at_m, self.axes, self.clutched, self.felt = at_m, len(at_m), False, []

    def sample(self, t_us):
        return PositionSample(t_us, self.at_m)

    def feel(self, t_us, force_n):
        self.felt.append((t_us, force_n))


@given(ANGLES, PLACES, PLACES, SCALES)
def test_a_mapping_turns_and_scales_and_its_inverse_brings_back(frame, place_m, other_m, scale):
    hand = Hand(*place_m)
    tool = Mapped(hand, Mapping(scale=scale, frame_deg=frame, offset_m=(0.1, 0.0, -0.1)))
    at = np.array(tool.sample(0).position_m)
    hand.at_m = other_m
    there = np.array(tool.sample(1000).position_m)
    assert np.linalg.norm(there - at) == pytest.approx(scale * math.dist(place_m, other_m), rel=1e-9, abs=1e-12)
    rows = np.array(tool._rows if tool._rows is not None else np.eye(3))
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rows) == pytest.approx(1.0)
    np.testing.assert_allclose(rows.T @ (there - [0.1, 0.0, -0.1]) / scale, other_m, atol=1e-12)


@given(ANGLES, PLACES, PLACES, SCALES, SCALES)
def test_work_in_the_hand_is_that_in_the_scene_by_the_stated_scale(frame, force_n, step_m, scale, force_scale):
    hand = Hand(0.0, 0.0, 0.0)
    tool = Mapped(hand, Mapping(scale=scale, force_scale=force_scale, frame_deg=frame))
    before = tool.sample(0).position_m
    hand.at_m = step_m
    moved_m = np.subtract(tool.sample(0).position_m, before)
    in_hand = float(np.dot(tool.to_hand(force_n), step_m))
    assert in_hand * tool.scale == pytest.approx(float(np.dot(force_n, moved_m)), rel=1e-9, abs=1e-9)


@given(st.lists(st.tuples(PLACES, st.booleans()), min_size=2, max_size=60), ANGLES, SCALES)
def test_nothing_jumps_on_clutching_whatever_the_hand_does(path, frame, scale):
    hand = Hand(*path[0][0])
    tool = Mapped(hand, Mapping(scale=scale, frame_deg=frame))
    before, was_open = None, False
    for tick, (place_m, is_open) in enumerate(path):
        moved_m = math.dist(place_m, hand.at_m)
        hand.at_m, hand.clutched = place_m, is_open
        at = tool.sample(1000 * tick).position_m
        if before is not None:
            most_m = 0.0 if is_open or was_open else scale * moved_m
            assert math.dist(at, before) <= most_m * (1.0 + 1e-9) + 1e-9
        before, was_open = at, is_open


def test_the_force_fades_while_the_clutch_is_open_and_rises_when_it_closes():
    hand = Hand(0.01)
    tool = Mapped(hand, Mapping(force_scale=0.5))
    forces_n = []
    for tick in range(700):
        tool.open = 100 <= tick < 300
        tool.sample(1000 * tick)
        tool.feel(1000 * tick, (4.0,))
        forces_n.append(hand.felt[-1][1][0])
    assert forces_n[99] == 2.0
    assert forces_n[100 + FADE_US // 1000 : 300] == [0.0] * (200 - FADE_US // 1000)
    assert forces_n[300 + RISE_US // 1000 + 1] == 2.0
    steps_n = np.diff(forces_n)
    assert steps_n.max() == pytest.approx(2.0 * 1000 / RISE_US)
    assert steps_n.min() == pytest.approx(-2.0 * 1000 / FADE_US)


def test_later_parts_go_through_and_the_first_one_is_mapped():
    hand = Hand(0.01, 0.0, 0.0, 0.5)
    hand.parts = parse_parts(["force:3", "grip:1"])
    tool = Mapped(hand, Mapping(scale=2.0, force_scale=0.5, frame_deg=(0.0, 0.0, 90.0)))
    assert tool.sample(0).position_m == pytest.approx((0.0, 0.02, 0.0, 0.5))
    assert tool.to_hand((0.0, 4.0, 0.0, 7.0)) == pytest.approx((2.0, 0.0, 0.0, 7.0))


def test_the_jnd_is_the_hands_so_its_floor_is_divided_by_the_scale_of_forces():
    law = WeberLaw(weber_fraction=0.07, floor_n=0.03, multiplier=2.0)
    assert Mapping(force_scale=0.5).asked(law) == replace(law, floor_n=0.06)
    link = linked(Hand(0.01), lambda _: Spring(), mapping=Mapping(force_scale=0.5), law=law)
    link.run(500_000)
    (context,) = link.slave.contexts
    assert context.codec.law == replace(law, floor_n=0.06)
    assert link.master._operator.hand.felt[-1][1] == pytest.approx((0.5 * context.newest[3][0],))


class Spring:
    axes, name = 1, "spring"

    def step(self, sample):
        return ForceSample(sample.t_us, (200.0 * sample.position_m[0],))


def test_a_device_in_the_hand_has_its_limits_in_newtons_of_the_scene():
    hand = Hand(0.0)
    hand.capabilities = Capabilities(max_force_n=3.0, slew_n_per_s=100.0, grounded=True)
    hand.applied_n = (1.5,)
    tool = Mapped(hand, Mapping(scale=2.0, force_scale=0.5))
    assert tool.capabilities == Capabilities(max_force_n=6.0, slew_n_per_s=200.0, grounded=True)
    assert (tool.applied_n, tool.scale) == ((3.0,), 4.0)
    assert tool.adaptation == (
        "1 mm of the hand is 2 mm of the tool and 1 N of the scene 0.5 N in the hand, so that stiffness is true"
    )
    assert not hasattr(Mapped(Hand(0.0), Mapping(scale=3.0)), "applied_n")
    hand.capabilities = Capabilities(max_force_n=20.0, grounded=True)
    weak = Mapped(hand, Mapping(force_scale=0.001))
    assert weak.capabilities == Capabilities(max_force_n=1e4, grounded=True), "the most that a device may declare"


def test_without_mapping_and_clutch_the_operator_is_itself():
    plain = UserOperator(SimpleNamespace(sample=lambda _: 0.0))
    assert mapped(plain, Mapping()) is plain
    with_clutch = UserOperator(SimpleNamespace(sample=lambda _: 0.0, clutched=True))
    assert isinstance(mapped(with_clutch, Mapping()), Mapped)


def test_a_clutch_that_raises_is_blamed_on_the_hand_and_ends_the_session():
    class Broken:
        faulty = True

        @property
        def clutched(self):
            if self.faulty:
                raise ValueError("no button")
            return False

        def sample(self, _):
            return 0.0

    hand = Broken()
    with pytest.raises(UserCodeError, match=r"Broken.clutched raised ValueError.*no button"):
        hn.virtual_link(scene=Spring(), operator=hand)
    hand.faulty = False
    link = hn.virtual_link(scene=Spring(), operator=hand)
    hand.faulty = True
    with pytest.raises(UnavailableError, match=r"Broken.clutched raised ValueError.*no button"):
        link.run(seconds=0.1)


def test_a_program_opens_the_clutch_by_udp():
    hand = RemoteOperator()
    for now_us, data, clutched in ((0, b'{"position_m": [0.0], "clutched": true}', True), (1, b"[0.0]", False)):
        hand.receive(data, ("127.0.0.1", 1), now_us)
        assert hand.clutched is clutched


def test_a_program_in_python_has_scale_and_clutch():
    with (
        hn.ThreadedSlave(Spring(), listen="127.0.0.1:0") as slave,
        hn.ThreadedMaster(slave.address, codec="raw", start=0.01, scale=2.0, force_scale=0.5) as master,
    ):
        wait_until(lambda: master.force_n == pytest.approx((2.0,)))
        master.clutch = True
        wait_until(lambda: master.force_n == (0.0,))
        master.position = 0.0
        master.clutch = False
        wait_until(lambda: master.force_n == pytest.approx((2.0,)))
        master.change(floor_n=0.02)
        assert master.node.codec.law.floor_n == pytest.approx(0.04)
        assert "stiffness is true" in master.adaptations[-1]


@pytest.mark.parametrize(
    ("axes", "frame", "offset", "message"),
    [
        (2, "0,0,90", None, "frame has 3 angles and the tool 2 axes"),
        (1, "90", None, "frame has 1 angles and the tool 1 axes"),
        (1, None, "0,0", "offset has 2 coordinates; the tool has 1 axes"),
        (1, "x", None, "frame is 'x'; it must be 1 to 3 numbers of degrees"),
        (3, "0,0,nan", None, "angle of the frame is nan"),
        (1, None, "90", "offset of the tool is 90.0 m; it must be between -10 and 10"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused(axes, frame, offset, message):
    with pytest.raises(SettingsError, match=message):
        Mapped(Hand(*[0.0] * axes), Mapping.parse(1.0, 1.0, frame, offset))
