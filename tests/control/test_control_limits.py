import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.limits import ForceLimiter, LimitSettings
from hapticnet.errors import SettingsError

SETTINGS = LimitSettings()
ANY_FORCE = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(ANY_FORCE, st.integers(-(10**6), 10**6)), max_size=60))
def test_output_stays_within_clamp_and_slew_for_any_input(calls: list[tuple[float, int]]) -> None:
    limiter = ForceLimiter(SETTINGS)
    now_us, before_n = 0, 0.0
    for force_n, elapsed_us in calls:
        now_us += elapsed_us
        limited_n = limiter.limit(force_n, now_us)
        assert 0.0 <= limited_n <= SETTINGS.max_force_n
        assert limited_n - before_n <= SETTINGS.slew_n_per_s * max(elapsed_us, 0) * 1e-6 + 1e-12
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


@given(st.floats(0.0, 5.0))
def test_passes_forces_within_the_limits(force_n: float) -> None:
    limiter = ForceLimiter(SETTINGS)
    limiter.limit(0.0, 0)
    assert limiter.limit(force_n, 10**6) == force_n


def test_a_fall_is_not_delayed() -> None:
    limiter = ForceLimiter(SETTINGS)
    limiter.limit(5.0, 0)
    assert limiter.limit(5.0, 10**6) == 5.0
    assert limiter.limit(1.0, 10**6 + 1) == 1.0


@pytest.mark.parametrize("force_n", [math.nan, math.inf, -math.inf, -1e300, -5e-324, -0.0])
def test_an_invalid_force_sets_the_target_to_zero(force_n: float) -> None:
    limiter = ForceLimiter(SETTINGS)
    limiter.limit(5.0, 0)
    limiter.limit(5.0, 10**6)
    assert limiter.limit(force_n, 10**6 + 1) == 0.0


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
