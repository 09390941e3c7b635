import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.errors import SampleError, SettingsError

SETTINGS = HoldSettings()
LIMIT_US = SETTINGS.age_limit_us
END_US = SETTINGS.age_limit_us + SETTINGS.decay_us


def test_before_any_stimulus_the_value_is_zero() -> None:
    hold = Hold(SETTINGS, axes=3)
    assert hold.value(5) == (0.0, 0.0, 0.0)


def test_a_keepalive_without_a_stimulus_holds_zero() -> None:
    hold = Hold(SETTINGS)
    hold.confirm(10)
    assert hold.value(20) == (0.0,)


def test_holds_unchanged_until_the_age_limit_then_falls_linearly_to_exactly_zero() -> None:
    hold = Hold(SETTINGS, axes=2)
    hold.receive((2.0, -4.0), 1_000)
    assert hold.value(1_000 + LIMIT_US) == (2.0, -4.0)
    assert hold.value(1_000 + LIMIT_US + SETTINGS.decay_us // 2) == pytest.approx((1.0, -2.0))
    assert hold.value(1_000 + END_US) == (0.0, 0.0)


def test_a_keepalive_renews_the_age_and_restores_the_stimulus() -> None:
    hold = Hold(SETTINGS)
    hold.receive((3.0,), 0)
    hold.confirm(LIMIT_US)
    assert hold.value(2 * LIMIT_US) == (3.0,)
    assert hold.value(5 * END_US) == (0.0,)
    hold.confirm(5 * END_US + 1)
    assert hold.value(5 * END_US + 2) == (3.0,)


def test_without_decay_the_value_drops_at_the_age_limit() -> None:
    hold = Hold(HoldSettings(age_limit_us=10, decay_us=0))
    hold.receive((1.0,), 0)
    assert (hold.value(10), hold.value(11)) == ((1.0,), (0.0,))


@given(
    force_n=st.floats(-5.0, 5.0),
    calls=st.lists(st.tuples(st.sampled_from(["receive", "confirm", "value"]), st.integers(0, 400_000)), max_size=60),
)
def test_a_force_never_outlives_age_limit_and_decay(force_n: float, calls: list[tuple[str, int]]) -> None:
    hold = Hold(SETTINGS)
    now_us = alive_us = 0
    for call, elapsed_us in calls:
        now_us += elapsed_us
        if call == "receive":
            hold.receive((force_n,), now_us)
            alive_us = now_us
        elif call == "confirm":
            hold.confirm(now_us)
            alive_us = now_us
        (value_n,) = hold.value(now_us)
        assert abs(value_n) <= abs(force_n)
        if now_us - alive_us >= END_US:
            assert value_n == 0.0


@given(st.lists(st.integers(-(2**62), 2**62), min_size=1, max_size=30))
def test_clock_jumps_never_make_a_stimulus_younger(jumps_us: list[int]) -> None:
    hold = Hold(SETTINGS)
    hold.receive((1.0,), 0)
    values = [hold.value(now_us)[0] for now_us in jumps_us]
    assert values == sorted(values, reverse=True)


def test_after_a_backward_jump_the_stimulus_still_goes_stale() -> None:
    hold = Hold(SETTINGS)
    hold.receive((1.0,), 10**12)
    assert hold.value(0) == (1.0,)
    assert hold.value(END_US) == (0.0,)


@pytest.mark.parametrize("bad", [(math.nan,), (math.inf,), (), (1.0, 2.0)])
def test_refuses_a_stimulus_that_is_not_finite_or_of_other_axes(bad: tuple[float, ...]) -> None:
    hold = Hold(SETTINGS)
    hold.receive((1.0,), 0)
    with pytest.raises(SampleError):
        hold.receive(bad, 1)
    assert hold.value(2) == (1.0,)


@pytest.mark.parametrize(("age_limit_us", "decay_us"), [(0, 1), (-1, 1), (10**9, 1), (1, -1), (1, 10**9)])
def test_refuses_bad_settings(age_limit_us: int, decay_us: int) -> None:
    with pytest.raises(SettingsError, match="hold"):
        HoldSettings(age_limit_us=age_limit_us, decay_us=decay_us)


@pytest.mark.parametrize("axes", [0, 4])
def test_refuses_bad_axes(axes: int) -> None:
    with pytest.raises(SettingsError, match="axes"):
        Hold(SETTINGS, axes=axes)
