import math

import numpy as np
import pytest
from codec_cases import assert_same, distances, laws, steps, timed, wandering
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import Deadband
from hapticnet.codec.streams import table_of_rows
from hapticnet.perception import WeberLaw
from hapticnet.vectors import magnitude
from hapticnet_literature.velocity_adaptive import VelocityAdaptive, start, watch

MS = 1000


def speeds(t_us: np.ndarray, positions: np.ndarray, time_constant_s: float) -> list[float]:
    """Return the speed after each position, by the rule as the docstring states it."""
    velocity, found, last = np.zeros(positions.shape[1]), [], 0
    for index in range(len(t_us)):
        elapsed_s = (int(t_us[index]) - int(t_us[last])) * 1e-6
        if elapsed_s > 0.0:
            moved = positions[index] - positions[last]
            velocity = (time_constant_s * velocity + moved) / (time_constant_s + elapsed_s)
            last = index
        found.append(magnitude(tuple(velocity.tolist())))
    return found


@given(timed(), laws, st.floats(0.0, 100.0), st.floats(0.0, 1.0), st.sampled_from([0.0, 5.0, 100.0]), steps)
def test_the_held_force_is_within_the_threshold_of_the_present_speed(
    case, law, gain, largest, time_constant_ms, step_n
):
    t_us, stimuli, positions = case
    codec = VelocityAdaptive(
        law=law, speed_gain_s_m=gain, largest_fraction=largest, time_constant_ms=time_constant_ms, step_n=step_n
    )
    decoded = encode_array(codec, t_us, stimuli, positions).decoded
    moving = speeds(t_us, positions, time_constant_ms * 1e-3)
    for far, held, speed in zip(distances(stimuli, decoded), decoded.tolist(), moving, strict=True):
        fraction = max(law.weber_fraction, min(law.weber_fraction + gain * speed, largest))
        threshold = law.multiplier * max(fraction * magnitude(tuple(held)), law.floor_n)
        assert far <= threshold * (1 + 1e-12)


@given(timed(), laws, steps)
def test_without_positions_or_without_gain_it_is_the_deadband(case, law, step_n):
    t_us, stimuli, positions = case
    deadband = encode_array(Deadband(law=law, step_n=step_n), t_us, stimuli)
    assert_same(deadband, encode_array(VelocityAdaptive(law=law, step_n=step_n), t_us, stimuli))
    still = VelocityAdaptive(law=law, step_n=step_n, speed_gain_s_m=0.0)
    assert_same(deadband, encode_array(still, t_us, stimuli, positions))


def speed_after(time_constant_ms, *path):
    """Return the speed [m/s] of a hand after times and positions."""
    axes = len(path[0][1])
    rule = VelocityAdaptive(time_constant_ms=time_constant_ms).rule(axes, table_of_rows)
    moving = start(rule, axes)
    for t_us, position in path:
        moving = watch(rule, moving, t_us, position)
    return moving.speed_m_s


@given(st.integers(1, 3), st.floats(0.01, 1.0))
def test_the_speed_of_a_steady_hand_does_not_depend_on_the_times_of_its_samples(axes, speed):
    times_us = np.cumsum([(0, 1, 700, 1000, 5000)[index % 5] for index in range(300)]).tolist()
    path = [(t_us, (speed * t_us * 1e-6 / math.sqrt(axes),) * axes) for t_us in times_us]
    assert speed_after(10.0, *path) == pytest.approx(speed, rel=1e-3)


def test_speed_rises_with_its_time_constant():
    path = [(ms * MS, (0.1e-3 * ms,)) for ms in range(11)]
    assert speed_after(10.0, *path) == pytest.approx(0.1 * (1 - (10 / 11) ** 10))


def test_a_hand_is_at_rest_after_a_time_that_goes_back_and_a_repeated_time_changes_nothing():
    path = [(10**9, (0.0,)), (10**9 + MS, (0.001,)), (10**9 + MS, (55.0,)), (0, (0.0,)), (MS, (0.002,))]
    assert speed_after(0.0, *path[:3]) == pytest.approx(1.0)
    assert speed_after(0.0, *path[:4]) == 0.0
    assert speed_after(0.0, *path) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("within", "at_m", "beyond"),
    [((1.14,), 0.0001, (1.16,)), ((1.19,), 1e6, (1.21,))],
    ids=["at 0.1 m/s the fraction is 0.15", "it grows no further than its largest"],
)
def test_the_deadband_is_as_wide_as_the_speed_says(within, at_m, beyond):
    law = WeberLaw(weber_fraction=0.05, floor_n=0.0)
    codec = VelocityAdaptive(law=law, speed_gain_s_m=1.0, largest_fraction=0.2, time_constant_ms=0.0)
    for force_n, next_m, silent in ((within, at_m, True), (beyond, at_m, False), (within, 0.0, False)):
        encoder = codec.encoder(1)
        encoder.encode(0, (1.0,), (0.0,))
        assert (encoder.encode(1 * MS, force_n, (next_m,)) is None) == silent


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_hand_in_motion_costs_fewer_packets_than_one_at_rest(axes):
    stimuli = wandering(4000, seed=axes, axes=axes)
    t_us = np.arange(4000, dtype=np.int64) * MS
    positions = 0.05 * np.sin(4.0 * t_us[:, np.newaxis] * 1e-6) + np.zeros((1, axes))
    moving, still = (encode_array(VelocityAdaptive(), t_us, stimuli, where) for where in (positions, None))
    assert len(moving.sent) < 0.75 * len(still.sent)


def test_without_its_position_a_moving_hand_counts_as_at_rest():
    codec = VelocityAdaptive(speed_gain_s_m=10.0)
    encoder = codec.encoder(1)
    encoder.encode(0, (1.0,), (0.0,))
    assert encoder.encode(1000, (1.1,), (0.01,)) is None
    assert encoder.encode(2000, (1.1,)) is not None
