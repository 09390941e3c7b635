"""Positions that are only sent when they matter: lines, bounds, and when the next line is due."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.positions import (
    FASTEST_M_PER_S,
    PositionSender,
    PromisedLine,
    pack_bound,
    pack_line,
    rounded_bound,
    unpack_bound,
    unpack_line,
)
from hapticnet.errors import PeerError, SampleError
from hapticnet.perception import WeberLaw
from hapticnet.stiffness_bound import LONGEST_SILENCE_US, StiffnessBound
from hapticnet.vectors import distance, single

LAW = WeberLaw()
EVERYWHERE = StiffnessBound(0.0, 0.0, (-1.0,), (1.0,))
numbers = st.floats(-1.0, 1.0, width=32)
vectors = st.one_of(*(st.tuples(*[numbers] * axes) for axes in (1, 2, 3)))


def stiff(stiffness, low=-1.0, high=1.0, axes=1):
    return StiffnessBound(stiffness, 0.0, (low,) * axes, (high,) * axes)


def played(sender, hand, *, applied_n=0.0, axes=1):
    """Return the lines that are sent for positions at 1 kHz, as the slave reads them."""
    lines = []
    for index, position in enumerate(hand):
        payload = sender.payload(1000 * index, position, applied_n)
        lines.append(None if payload is None else unpack_line(1000 * index, payload, axes))
    return lines


@given(vectors)
def test_a_line_is_read_as_it_was_written(position):
    axes = len(position)
    none, some = (0.0,) * axes, tuple(float(np.float16(0.1 * (axis + 1))) for axis in range(axes))
    for velocity, acceleration, size in ((none, none, 4), (some, none, 6), (some, some, 8), (none, some, 8)):
        line = PromisedLine(5, position, velocity, acceleration)
        assert unpack_line(5, pack_line(line), axes) == line
        assert len(pack_line(line)) == size * axes


def test_the_golden_line_goes_on_at_its_velocity_and_is_level_before_and_after():
    line = unpack_line(1000, bytes.fromhex("3cac08312e66"), 1)
    assert line == PromisedLine(1000, single((0.021,)), (float(np.float16(0.1)),), (0.0,))
    assert line.at(0) == line.at(1000) == line.position_m
    assert line.at(11_000)[0] == pytest.approx(0.022, abs=1e-6)
    assert line.at(1000 + LONGEST_SILENCE_US) == line.at(10**9)


def test_the_acceleration_of_the_golden_curve_dies_out():
    line = unpack_line(0, bytes.fromhex("3cac08312e664000"), 1)
    assert line.acceleration_m_per_s2 == (2.0,)
    places_m = [line.at(1000 * ms)[0] for ms in range(101)]
    speeds = 1e3 * np.diff(places_m)
    # The velocity grows by 2 m/s² · t · (1 − t / 120 ms), until 60 ms.
    after_s = np.arange(0.5e-3, 0.1, 1e-3)
    fading_s = np.minimum(after_s, 0.06)
    assert speeds == pytest.approx(0.1 + 2.0 * fading_s * (1.0 - fading_s / 0.12), abs=1e-4)
    assert line.arriving_m_per_s(1000) == pytest.approx((0.1 - 0.001,), abs=1e-4)


@pytest.mark.parametrize(
    "payload",
    [
        "",
        "3cac08",
        "7fc00000",
        "7f800000",
        "3cac08317e00",
        "3cac08317c00",
        "3cac08314d00",
        "3cac08312e667e00",
        "3cac08312e665700",
    ],
)
def test_lines_that_cannot_be_are_refused(payload):
    with pytest.raises(PeerError):
        unpack_line(0, bytes.fromhex(payload), 1)


@given(st.binary(max_size=40), st.integers(1, 3))
def test_garbage_is_a_peer_error(data, axes):
    for read in (lambda: unpack_line(0, data, axes), lambda: unpack_bound(data, axes)):
        try:
            read()
        except PeerError:
            continue


@given(st.floats(0.0, 1e6), st.floats(0.0, 1e3), st.floats(-1.0, 0.0), st.floats(1e-6, 1.0), st.floats(0.0, 1e3))
def test_an_bound_is_rounded_so_that_it_promises_no_more(stiffness, damping, low, width, stiffening):
    given_ = StiffnessBound(stiffness, damping, (low,), (low + width,), stiffening)
    rounded = rounded_bound(given_)
    assert rounded is not None
    assert rounded.stiffness_n_per_m >= stiffness
    assert rounded.damping_n_s_per_m >= damping
    assert rounded.stiffening_per_m >= stiffening
    assert given_.low_m[0] <= rounded.low_m[0] <= rounded.high_m[0] <= given_.high_m[0]
    assert unpack_bound(pack_bound(rounded), 1) == rounded


@pytest.mark.parametrize(
    "bound", [None, stiff(math.nan), stiff(math.inf), stiff(-1.0), stiff(1.0, math.nan), stiff(1.0, 1.0, -1.0)]
)
def test_what_cannot_be_an_bound_is_told_as_none(bound):
    assert rounded_bound(bound) is None
    assert pack_bound(None) == b""
    assert unpack_bound(b"", 1) is None


@given(
    st.integers(0, 2**32 - 1),
    st.floats(10.0, 1e6),
    st.floats(0.05, 0.9),
    st.integers(1, 3),
    st.sampled_from(["smooth", "jumps", "noise", "rest"]),
)
def test_the_line_is_never_further_off_than_the_share_of_the_jnd(seed, stiffness, share, axes, kind):
    chance = np.random.default_rng(seed)
    t_s = np.arange(300)[:, np.newaxis] / 1000
    hand = {
        "smooth": 0.05 * np.sin(2 * np.pi * chance.uniform(0.5, 10.0, axes) * t_s),
        "jumps": np.cumsum(chance.normal(0.0, 0.1, (300, axes)) * (chance.random((300, 1)) < 0.05), axis=0),
        "noise": chance.normal(0.0, 1e-3, (300, axes)),
        "rest": np.zeros((300, axes)) + 0.01,
    }[kind]
    sender = PositionSender(LAW, share)
    sender.set_bound(stiff(stiffness, -100.0, 100.0, axes))
    applied_n = float(chance.uniform(0.0, 5.0))
    line = None
    for index, position in enumerate(map(tuple, hand.tolist())):
        payload = sender.payload(1000 * index, position, applied_n)
        line = line if payload is None else unpack_line(1000 * index, payload, axes)
        off_n = stiffness * distance(single(position), line.at(1000 * index))
        assert off_n <= share * LAW.threshold_n(applied_n) * (1.0 + 1e-9)
        assert max(map(abs, line.velocity_m_per_s)) <= FASTEST_M_PER_S


def test_a_hand_at_rest_in_free_air_sends_ten_positions_a_second_without_a_velocity():
    sender = PositionSender(LAW, 0.25)
    sender.set_bound(EVERYWHERE)
    lines = played(sender, [(0.01,)] * 1000)
    assert [index for index, line in enumerate(lines) if line] == list(range(0, 1000, 100))
    assert {line.velocity_m_per_s for line in lines if line} == {(0.0,)}


def test_a_side_of_the_box_is_crossed_with_a_position_at_once():
    sender = PositionSender(LAW, 0.25)
    sender.set_bound(StiffnessBound(0.0, 5.0, (-1.0,), (0.02,)))
    hand = [(0.0001 * index,) for index in range(300)]
    lines = played(sender, hand)
    assert lines[201] is not None, "0.0201 m is the first position outside"
    assert not any(lines[203:]), "the slave is about to follow there, too"
    sender.set_bound(stiff(1000.0, 0.02, 1.0))
    assert sender.payload(300_000, (0.03,), 0.0) is None, "the line is good"
    assert sender.payload(301_000, (0.0315,), 0.0) is not None


def test_every_position_is_sent_while_the_scene_cannot_tell():
    sender = PositionSender(LAW, 0.25)
    assert all(played(sender, [(0.01,)] * 20))
    sender.set_bound(EVERYWHERE)
    sender.set_bound(None)
    assert all(played(sender, [(0.01,)] * 20))


def test_a_position_is_sent_when_it_is_wanted_and_after_a_clock_that_went_back():
    sender = PositionSender(LAW, 0.25)
    sender.set_bound(EVERYWHERE)
    assert sender.payload(1_000_000, (0.0,), 0.0) is not None
    assert sender.payload(1_001_000, (0.0,), 0.0) is None
    assert sender.payload(1_002_000, (0.0,), 0.0, wanted=True) is not None
    assert sender.payload(500_000, (0.0,), 0.0) is not None
    sender.forget()
    assert sender.payload(501_000, (0.0,), 0.0) is not None


@pytest.mark.parametrize("position", [(math.nan,), (math.inf,), (1e16,), ()])
def test_positions_that_cannot_be_are_refused_and_change_nothing(position):
    sender = PositionSender(LAW, 0.25)
    sender.set_bound(EVERYWHERE)
    assert sender.payload(0, (0.0,), 0.0) is not None
    with pytest.raises(SampleError):
        sender.payload(1000, position, 0.0)
    assert sender.payload(2000, (0.0,), 0.0) is None


def test_where_a_spring_stiffens_the_tolerance_shrinks_with_the_force():
    far_m = []
    for applied_n in (0.0, 0.4):
        sender = PositionSender(LAW, 0.25)
        sender.set_bound(StiffnessBound(60.0, 0.0, (-1.0,), (1.0,), 200.0))
        assert sender.payload(0, (0.0,), applied_n) is not None
        steps = (step for step in range(1, 300) if sender.payload(step, (1e-6 * step,), applied_n) is not None)
        far_m.append(1e-6 * next(steps))
    # 6.25 mN over 60 N/m, and 200/m times the force that is possible besides
    assert far_m == pytest.approx([0.25 * 0.025 / (60.0 + 200.0 * (each + 0.05)) for each in (0.0, 0.4)], rel=0.05)
