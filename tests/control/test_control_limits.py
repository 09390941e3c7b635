import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.hold import LONGEST_STEP_US, PAUSE_US, ForceLimiter, LimitSettings
from hapticnet.errors import SettingsError

SETTINGS = LimitSettings()
STEP_N = SETTINGS.slew_n_per_s * LONGEST_STEP_US * 1e-6
ANY_FORCE = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(ANY_FORCE, st.integers(-(10**6), 10**6)), max_size=60))
def test_output_stays_within_clamp_and_slew_for_any_input(calls: list[tuple[float, int]]) -> None:
    limiter = ForceLimiter(SETTINGS)
    now_us, before_n = 0, 0.0
    for force_n, elapsed_us in calls:
        now_us += elapsed_us
        limited_n = limiter.limit(force_n, now_us)
        assert 0.0 <= limited_n <= SETTINGS.max_force_n
        most_us = min(max(elapsed_us, 0), LONGEST_STEP_US)
        assert limited_n - before_n <= SETTINGS.slew_n_per_s * most_us * 1e-6 + 1e-12
        before_n = limited_n


@given(st.lists(st.integers(1, 5_000), min_size=1, max_size=200))
def test_a_rise_does_not_depend_on_the_ticks(elapsed_us: list[int]) -> None:
    limiter = ForceLimiter(SETTINGS)
    now_us = 1_000
    limited_n = limiter.limit(99.0, now_us)
    for step_us in elapsed_us:
        now_us += step_us
        limited_n = limiter.limit(99.0, now_us)
    expected_n = min(SETTINGS.max_force_n, SETTINGS.slew_n_per_s * (now_us - 1_000) * 1e-6)
    assert limited_n == pytest.approx(expected_n, rel=1e-12)


def pressing(force_n: float) -> tuple[ForceLimiter, int]:
    """Return a limiter whose target is `force_n`, and the time [µs]."""
    limiter = ForceLimiter(SETTINGS)
    now_us = 0
    while limiter.limit(force_n, now_us) < force_n:
        now_us += 1_000
    return limiter, now_us


@given(st.floats(0.0, 5.0))
def test_passes_forces_within_the_limits(force_n: float) -> None:
    limiter, now_us = pressing(force_n)
    assert limiter.limit(force_n, now_us + 1_000) == force_n


def test_a_fall_is_not_delayed() -> None:
    limiter, now_us = pressing(5.0)
    assert limiter.limit(1.0, now_us + 1) == 1.0


@pytest.mark.parametrize("stalled_us", [LONGEST_STEP_US + 1, 50_000, PAUSE_US - 1])
def test_a_stalled_tick_lets_the_force_rise_by_one_step_only(stalled_us: int) -> None:
    limiter, now_us = pressing(1.0)
    now_us += stalled_us
    assert limiter.limit(5.0, now_us) == pytest.approx(1.0 + STEP_N)
    assert limiter.limit(5.0, now_us + 1_000) == pytest.approx(1.0 + STEP_N + 0.05)


@pytest.mark.parametrize("paused_us", [PAUSE_US, 10_000_000, 10**15])
def test_after_a_pause_the_force_rises_from_zero(paused_us: int) -> None:
    limiter, now_us = pressing(3.0)
    now_us += paused_us
    assert limiter.limit(3.0, now_us) == 0.0
    assert limiter.limit(3.0, now_us + 1_000) == pytest.approx(0.05)


@pytest.mark.parametrize("force_n", [math.nan, math.inf, -math.inf, -1e300, -5e-324, -0.0])
def test_an_invalid_force_sets_the_target_to_zero(force_n: float) -> None:
    limiter, now_us = pressing(5.0)
    assert limiter.limit(force_n, now_us + 1) == 0.0


def test_the_target_does_not_rise_at_repeated_or_earlier_times() -> None:
    limiter = ForceLimiter(SETTINGS)
    limiter.limit(5.0, 10**12)
    assert limiter.limit(5.0, 10**12) == 0.0
    assert limiter.limit(5.0, 0) == 0.0
    assert limiter.limit(5.0, 1_000) == pytest.approx(0.05)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", ["max_force_n", "slew_n_per_s"])
def test_refuses_bad_settings(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match="must be above 0"):
        LimitSettings(**{name: value})


def test_refuses_limits_above_those_of_the_device() -> None:
    with pytest.raises(SettingsError, match=r"5\.5"):
        LimitSettings(max_force_n=5.5)
