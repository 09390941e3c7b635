import pytest

from hapticnet.scene.layer import LONGEST_STEP_US, Needle
from hapticnet.scene.settings import LARGEST_SPEED_M_PER_S


def moved(*samples: tuple[int, float]) -> Needle:
    needle = Needle()
    for t_us, tip_m in samples:
        needle.advance(t_us, tip_m)
        needle.tip_m = tip_m
    return needle


def test_velocity_is_the_difference_over_the_time_between() -> None:
    assert moved((0, 0.0), (2_000, 0.001)).velocity_m_per_s == pytest.approx(0.5)
    assert moved((0, 0.0), (2_000, -0.001)).velocity_m_per_s == pytest.approx(-0.5)


def test_the_first_sample_has_no_velocity_and_no_duration() -> None:
    needle = moved((7_000_000, 0.3))
    assert (needle.velocity_m_per_s, needle.now_us) == (0.0, 0)


@pytest.mark.parametrize("t_us", [5_000, 4_999, -(10**12)])
def test_a_stamp_that_repeats_or_goes_backwards_adds_no_time(t_us: int) -> None:
    needle = moved((0, 0.0), (5_000, 0.1), (t_us, 0.2))
    assert (needle.velocity_m_per_s, needle.now_us) == (0.0, 5_000)


def test_time_continues_after_the_clock_was_set_back() -> None:
    assert moved((10**9, 0.0), (0, 0.0), (1_000, 0.0)).now_us == 1_000


def test_speed_is_bounded_however_close_the_stamps() -> None:
    assert moved((0, 0.0), (1, 1e9)).velocity_m_per_s == LARGEST_SPEED_M_PER_S
    assert moved((0, 0.0), (1, -1e9)).velocity_m_per_s == -LARGEST_SPEED_M_PER_S


def test_a_stamp_beyond_the_range_of_floats_adds_the_longest_step() -> None:
    needle = moved((0, 0.0), (10**400, 0.1))
    assert needle.now_us == LONGEST_STEP_US
    assert 0.0 < needle.velocity_m_per_s < 1e-9
