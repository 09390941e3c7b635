"""Passive reduction: no energy out of nothing, whatever force and motion do."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.vectors import magnitude
from hapticnet_literature.passive import PassiveExtrapolative, PassiveInterpolative

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
laws = st.builds(
    WeberLaw,
    weber_fraction=st.one_of(st.just(0.0), st.floats(1e-12, 1.0)),
    floor_n=st.one_of(st.just(0.0), st.floats(1e-12, 2.0)),
    multiplier=st.sampled_from([0.0, 0.3, 1.0, 4.0]),
)
steps_n = st.sampled_from([0.0, 0.001])
codecs = st.one_of(
    st.builds(PassiveExtrapolative, law=laws, step_n=steps_n),
    st.builds(PassiveInterpolative, law=laws, step_n=steps_n, interval_ms=st.sampled_from([0.0, 3.0, 1000.0])),
)
forces = st.one_of(st.floats(-10.0, 10.0), st.floats(-1e15, 1e15), st.sampled_from([0.0, 1.0, 1.025, 1.05, 1e15]))
positions = st.one_of(st.floats(-0.1, 0.1), st.floats(-1e15, 1e15), st.sampled_from([0.0, 1e-9, 5e-324, 1e15]))


@st.composite
def motions(draw):
    axes, count = draw(st.integers(1, 3)), draw(st.integers(0, 30))
    steps_us = st.one_of(st.just(1000), st.sampled_from([0, -1000, 2_000_000]))
    times_us = np.cumsum(draw(st.lists(steps_us, min_size=count, max_size=count)), dtype=np.int64)
    size = {"min_size": count * axes, "max_size": count * axes}
    where = np.array(draw(st.lists(positions, **size)), dtype=float).reshape(count, axes)
    true = np.array(draw(st.lists(forces, **size)), dtype=float).reshape(count, axes)
    true[np.abs(true) < 1e-150] = 0.0  # the norm of several axes takes less for nothing
    return times_us, true, where


def work(force: list[float], before: list[float], after: list[float]) -> Fraction:
    """Return force times way, exactly."""
    return sum(Fraction(f) * (Fraction(a) - Fraction(b)) for f, b, a in zip(force, before, after, strict=True))


@given(motions(), codecs)
@example((np.arange(3), np.array([[1.0], [1.05], [0.95]]), np.array([[0.0], [1e-3], [5e-324]])), PassiveInterpolative())
def test_no_sample_creates_energy(motion, codec):
    times_us, true, where = motion
    decoded = encode_array(codec, times_us, true, where).decoded
    for index in range(1, len(true)):
        ends = where[index - 1].tolist(), where[index].tolist()
        # The very floats that are applied, in exact arithmetic: not even a rounding creates any.
        assert work(true[index].tolist(), *ends) <= work(decoded[index].tolist(), *ends)


def adversary(codec, samples: int = 3000, axes: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return true forces, applied forces and positions where the hand turns whenever that gains it most."""
    rng = np.random.default_rng(7)
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    force, position = np.ones(axes), np.zeros(axes)
    rows = []
    for index in range(samples):
        force = force + rng.normal(0.0, 0.02, axes)
        if rows:
            lacking = rows[-1][0] - rows[-1][1]  # of the applied force: goes where it is weaker than the true one
            position = position + 1e-3 * lacking / max(float(np.linalg.norm(lacking)), 1e-12)
        payload = encoder.encode(1000 * index, tuple(force.tolist()), tuple(position.tolist()))
        if payload is not None:
            decoder.decode(1000 * index, payload)
        rows.append((force, np.array(decoder.reconstruct(1000 * index, tuple(position.tolist()))), position))
    true, applied, where = map(np.array, zip(*rows, strict=True))
    return true, applied, where


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("codec", [PassiveExtrapolative(law=LAW), PassiveInterpolative(law=LAW)])
def test_a_hand_that_plays_for_energy_gets_none_where_the_deadband_gives_it_some(codec, axes):
    true, applied, where = adversary(codec, axes=axes)
    created = np.cumsum(np.sum((true - applied)[1:] * np.diff(where, axis=0), axis=1))
    assert created.max() <= 0.0
    true, applied, where = adversary(Deadband(law=LAW), axes=axes)
    held = np.sum((true - applied)[1:] * np.diff(where, axis=0), axis=1)
    assert held.sum() > 0.0


@given(motions())
def test_along_the_next_motion_only_a_change_of_direction_creates_energy_and_no_more_than_stated(motion):
    times_us, true, where = (each[:, :1] if each.ndim == 2 else each for each in motion)
    true, where = np.clip(true, -10.0, 10.0), np.clip(where, -1.0, 1.0)
    encoding = encode_array(PassiveExtrapolative(law=LAW), times_us, true, where)
    held = encode_array(Deadband(law=LAW), times_us, true).decoded
    direction = 0.0
    for index in range(len(true) - 1):
        direction = np.sign(where[index, 0] - where[index - 1, 0]) or direction if index else 0.0
        ahead_m = where[index + 1, 0] - where[index, 0]
        created = (true[index, 0] - encoding.decoded[index, 0]) * ahead_m
        if ahead_m * direction > 0.0:
            assert created <= 0.0
        else:
            assert created <= 2.0 * LAW.threshold_n(abs(held[index, 0])) * abs(ahead_m) * (1 + 1e-9)


@given(motions(), laws)
def test_the_extrapolative_error_is_two_thresholds_at_most(motion, law):
    times_us, true, where = motion
    applied = encode_array(PassiveExtrapolative(law=law), times_us, true, where).decoded
    held = encode_array(Deadband(law=law), times_us, true).decoded
    for x, a, h in zip(true.tolist(), applied.tolist(), held.tolist(), strict=True):
        error = magnitude(tuple(p - q for p, q in zip(x, a, strict=True)))
        threshold, size = law.threshold_n(magnitude(tuple(h))), magnitude(tuple(h))
        assert error <= 2.0 * threshold + 1e-14 * (threshold + size)


@given(motions(), codecs)
def test_without_positions_it_is_the_deadband(motion, codec):
    times_us, true, _ = motion
    plain = encode_array(Deadband(law=codec.law, step_n=codec.step_n), times_us, true)
    encoding = encode_array(codec, times_us, true)
    assert encoding.sent.tolist() == plain.sent.tolist()
    assert encoding.payload_bytes.tolist() == plain.payload_bytes.tolist()
    assert encoding.decoded.tobytes() == plain.decoded.tobytes()


def test_the_shift_is_against_the_motion_and_stays_at_rest():
    codec = PassiveExtrapolative(law=LAW)
    where = np.array([[0.0], [0.0], [1e-3], [1e-3], [2e-3], [1e-3], [1e-3]])
    applied = encode_array(codec, np.arange(7) * 1000, np.ones((7, 1)), where).decoded[:, 0]
    assert applied.tolist() == pytest.approx([1.0, 1.0, 1.05, 1.05, 1.05, 0.95, 0.95])


def test_for_two_axes_the_shift_lies_along_the_motion():
    codec = PassiveExtrapolative(law=WeberLaw(weber_fraction=0.0, floor_n=0.5))
    where = np.array([[0.0, 0.0], [3e-3, 4e-3]])
    applied = encode_array(codec, np.arange(2) * 1000, np.array([[1.0, 0.0]] * 2), where).decoded
    assert applied[1].tolist() == pytest.approx([1.3, 0.4])


@pytest.mark.parametrize(
    ("interval_ms", "step_m", "rise", "fall"),
    [
        (4.0, 1e-3, [1.5, 5.5, 5.5], [5.5, 5.5, 4.5, 3.5, 2.5, 1.5, 1.5]),
        (2.0, -1e-3, [0.5, 0.5, 2.5, 4.5], [4.5, 0.5, 0.5]),
    ],
)
def test_a_breach_comes_as_a_ramp_and_a_rise_at_once_and_on_the_way_out_the_other_way_round(
    interval_ms, step_m, rise, fall
):
    codec = PassiveInterpolative(law=WeberLaw(weber_fraction=0.0, floor_n=0.5), interval_ms=interval_ms)
    true = np.array([1.0] * 10 + [5.0] * 10 + [1.0] * 10)[:, np.newaxis]
    applied = encode_array(codec, np.arange(30) * 1000, true, step_m * np.arange(30)[:, np.newaxis]).decoded[:, 0]
    assert applied[9:][: len(rise)].tolist() == pytest.approx(rise)
    assert applied[19:][: len(fall)].tolist() == pytest.approx(fall)


@pytest.mark.parametrize("codec", [PassiveExtrapolative(), PassiveInterpolative()])
@given(payload=st.binary(max_size=30), axes=st.integers(1, 3))
def test_a_corrupt_payload_changes_nothing_or_leads_to_a_finite_force(codec, payload, axes):
    decoder = codec.decoder(axes)
    decoder.decode(0, np.ones(axes, dtype=">f4").tobytes())
    decoder.reconstruct(0, (0.0,) * axes)
    before = decoder.reconstruct(1000, (1e-3,) * axes)
    try:
        decoder.decode(2000, payload)
    except PeerError:
        assert decoder.reconstruct(2000, (2e-3,) * axes) == pytest.approx(before)
    else:
        assert all(map(math.isfinite, decoder.reconstruct(2000, (2e-3,) * axes)))
