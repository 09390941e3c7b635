import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.control.hold import (
    LONGEST_STEP_US,
    PAUSE_US,
    ForceLimiter,
    Hold,
    HoldSettings,
)
from hapticnet.device.base import presses
from hapticnet.errors import SampleError, SettingsError
from hapticnet.hardware import MAX_FORCE_N, SLEW_N_PER_S

SETTINGS = HoldSettings()
LIMIT_US = SETTINGS.age_limit_us
END_US = SETTINGS.age_limit_us + SETTINGS.decay_us
RISE_N_PER_US = SETTINGS.rise_n_per_s * 1e-6
MS = 1_000


def holding(force_n: tuple[float, ...], now_us: int, settings: HoldSettings = SETTINGS) -> Hold:
    """Return a hold that applies the whole of a stimulus received at `now_us`."""
    hold = Hold(settings, axes=len(force_n))
    for before_ms in range(1_000, 0, -1):
        hold.receive(force_n, now_us - before_ms * MS)
        hold.value(now_us - before_ms * MS)
    hold.receive(force_n, now_us)
    assert hold.value(now_us) == force_n
    return hold


def follow(hold: Hold, from_us: int, to_us: int, step_us: int = MS) -> list[float]:
    """Return the magnitudes of the force [N] at every step while keepalives arrive."""
    sizes = []
    for now_us in range(from_us, to_us, step_us):
        hold.confirm(now_us)
        sizes.append(math.hypot(*hold.value(now_us)))
    return sizes


def test_before_any_stimulus_the_value_is_zero_even_after_a_keepalive() -> None:
    hold = Hold(SETTINGS, axes=3)
    assert hold.value(5) == (0.0, 0.0, 0.0)
    hold.confirm(10)
    assert hold.value(20) == (0.0, 0.0, 0.0)


def test_holds_unchanged_until_the_age_limit_then_falls_linearly_to_exactly_zero() -> None:
    hold = holding((2.0, -4.0), 1_000)
    assert hold.value(1_000 + LIMIT_US) == (2.0, -4.0)
    assert hold.value(1_000 + LIMIT_US + SETTINGS.decay_us // 2) == pytest.approx((1.0, -2.0))
    assert hold.value(1_000 + END_US) == (0.0, 0.0)


def test_following_tells_whether_any_of_the_stimulus_is_applied() -> None:
    hold = holding((3.0,), 0)
    assert [hold.follow((3.0,), now_us) for now_us in (LIMIT_US, END_US - 1, END_US)] == [True, True, False]


def test_what_is_kept_stays_but_grows_older() -> None:
    hold = holding((0.03,), 0)
    hold.kept = True
    assert hold.value(10 * END_US) == (0.03,)
    assert hold.follow((2.0,), 10 * END_US)
    hold.kept = False
    assert hold.value(10 * END_US) == (0.0,), "not a moment longer than if it had not been kept"
    hold = holding((0.03,), 0)
    hold.kept = True
    assert hold.value(LIMIT_US - MS) == (0.03,)
    hold.kept = False
    assert hold.value(LIMIT_US + SETTINGS.decay_us // 2) == (pytest.approx(0.015),)
    hold = holding((0.03,), 0)
    hold.kept = True
    assert hold.value(10 * END_US) == (0.03,)
    hold.receive((1.5,), 10 * END_US)
    assert hold.value(10 * END_US) == (1.5,), "what follows does not have to rise"


def test_a_keepalive_renews_the_age() -> None:
    hold = holding((3.0,), 0)
    hold.confirm(LIMIT_US)
    assert hold.value(2 * LIMIT_US) == (3.0,)
    assert hold.value(5 * END_US) == (0.0,)


def test_without_decay_the_value_drops_at_the_age_limit() -> None:
    hold = holding((1.0,), 0, HoldSettings(age_limit_us=2_000, decay_us=0))
    assert (hold.value(2_000), hold.value(2_001)) == ((1.0,), (0.0,))


@pytest.mark.parametrize("asked_first", [False, True])
@pytest.mark.parametrize("arrival", ["a keepalive", "a stimulus"])
def test_after_silence_the_force_rises_at_the_slew_limit_until_it_is_whole(arrival: str, asked_first: bool) -> None:
    hold = holding((6.0, 0.0, -8.0), 0)
    if asked_first:
        assert hold.value(10**7) == (0.0, 0.0, 0.0)
    if arrival == "a stimulus":
        hold.receive((6.0, 0.0, -8.0), 10**7)
    sizes = follow(hold, 10**7, 10**7 + 300 * MS)
    assert sizes[:200] == pytest.approx([RISE_N_PER_US * MS * tick for tick in range(200)])
    assert hold.value(10**7 + 300 * MS) == (6.0, 0.0, -8.0)


def test_a_force_that_recovers_during_its_decay_rises_from_where_it_is() -> None:
    hold = holding((4.0,), 0)
    now_us = LIMIT_US + SETTINGS.decay_us // 4
    assert hold.value(now_us) == pytest.approx((3.0,))
    assert follow(hold, now_us, now_us + 40 * MS)[:20] == pytest.approx([3.0 + 0.05 * tick for tick in range(20)])


def test_a_link_that_dies_while_the_force_rises_keeps_it_and_releases_it_no_later() -> None:
    hold = holding((10.0,), 0)
    hold.value(10**7)
    follow(hold, 10**7, 10**7 + 100 * MS)
    alive_us = 10**7 + 99 * MS
    values = [hold.value(now_us)[0] for now_us in range(alive_us, alive_us + END_US + MS, MS)]
    assert max(abs(one - other) for one, other in itertools.pairwise(values)) <= 0.1 + 1e-9
    assert values[-1] == 0.0


def test_the_first_force_of_a_session_rises_at_the_slew_limit_as_well() -> None:
    assert HoldSettings().rise_n_per_s == presses(0.01).slew_n_per_s == SLEW_N_PER_S
    hold = Hold(SETTINGS)
    hold.receive((4.0,), 5_000)
    assert hold.value(5_000) == (0.0,)
    assert hold.value(6_000) == pytest.approx((0.05,))


def test_after_a_restart_the_next_stimulus_rises_from_the_force_applied() -> None:
    hold = holding((2.0,), 0)
    hold.restart()
    assert hold.value(10 * MS) == (2.0,)
    hold.receive((9.0,), 20 * MS)
    assert hold.value(20 * MS) == pytest.approx((2.0,))
    assert follow(hold, 21 * MS, 30 * MS) == pytest.approx([2.0 + 0.05 * tick for tick in range(1, 10)])


def test_a_stimulus_that_falls_while_the_force_rises_is_whole_at_once() -> None:
    hold = Hold(SETTINGS)
    hold.receive((4.0,), 0)
    assert follow(hold, 0, 41 * MS)[-1] == pytest.approx(2.0)
    hold.receive((1.5,), 41 * MS)
    assert hold.value(41 * MS) == (1.5,)
    hold.receive((4.0,), 42 * MS)
    assert hold.value(42 * MS) == (4.0,)
    hold.receive((-9.0,), 43 * MS)
    assert hold.value(43 * MS) == (-9.0,)


@given(
    stimuli=st.lists(
        st.tuples(
            st.sampled_from(["receive", "confirm", "restart", "nothing"]),
            st.tuples(*[st.floats(-10.0, 10.0)] * 3),
            st.one_of(st.integers(0, 2_000), st.integers(0, 400_000), st.just(10**9)),
        ),
        max_size=80,
    )
)
def test_a_force_that_is_not_whole_grows_no_faster_than_the_slew_limit(
    stimuli: list[tuple[str, tuple[float, float, float], int]],
) -> None:
    hold = Hold(SETTINGS, axes=3)
    now_us, before_n, whole, new = 0, 0.0, False, False
    stimulus_n: tuple[float, ...] = (0.0, 0.0, 0.0)
    for call, force_n, elapsed_us in stimuli:
        now_us += elapsed_us
        if call == "receive":
            hold.receive(force_n, now_us)
            stimulus_n = force_n
        elif call == "confirm":
            hold.confirm(now_us)
        elif call == "restart":
            hold.restart()
        value_n = hold.value(now_us)
        size_n = math.hypot(*value_n)
        if not whole or elapsed_us > LIMIT_US or (call == "receive" and new):
            assert size_n <= before_n + RISE_N_PER_US * min(elapsed_us, LONGEST_STEP_US) + 1e-9
        new = call == "restart" or (new and call != "receive")
        whole = value_n == stimulus_n
        before_n = size_n


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
    hold = holding((1.0,), 0)
    values = [hold.value(now_us)[0] for now_us in jumps_us]
    assert values == sorted(values, reverse=True)


def test_after_a_backward_jump_the_stimulus_still_goes_stale() -> None:
    hold = holding((1.0,), 10**12)
    assert hold.value(0) == (1.0,)
    assert hold.value(END_US) == (0.0,)


@pytest.mark.parametrize("bad", [(math.nan,), (math.inf,), (), (1.0, 2.0)])
def test_refuses_a_stimulus_that_is_not_finite_or_of_other_axes(bad: tuple[float, ...]) -> None:
    hold = holding((1.0,), 0)
    with pytest.raises(SampleError):
        hold.receive(bad, 1)
    assert hold.value(2) == (1.0,)


def test_refuses_bad_settings() -> None:
    for name, values in {
        "age_limit_us": (0, -1, 10**9),
        "decay_us": (-1, 10**9),
        "rise_n_per_s": (0.0, -1.0, math.nan, math.inf),
    }.items():
        for value in values:
            with pytest.raises(SettingsError, match="rise" if name == "rise_n_per_s" else "hold"):
                HoldSettings(**{name: value})
    for axes in (0, 4):
        with pytest.raises(SettingsError, match="axes"):
            Hold(SETTINGS, axes=axes)


LIMIT_STEP_N = SLEW_N_PER_S * LONGEST_STEP_US * 1e-6
ANY_FORCE = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(ANY_FORCE, st.integers(-(10**6), 10**6)), max_size=60))
def test_output_stays_within_clamp_and_slew_for_any_input(calls: list[tuple[float, int]]) -> None:
    limiter = ForceLimiter(MAX_FORCE_N, SLEW_N_PER_S)
    now_us, before_n = 0, 0.0
    for force_n, elapsed_us in calls:
        now_us += elapsed_us
        limited_n = limiter.limit(force_n, now_us)
        assert 0.0 <= limited_n <= MAX_FORCE_N
        most_us = min(max(elapsed_us, 0), LONGEST_STEP_US)
        assert limited_n - before_n <= SLEW_N_PER_S * most_us * 1e-6 + 1e-12
        before_n = limited_n


@given(st.lists(st.integers(1, 5_000), min_size=1, max_size=200))
def test_a_rise_does_not_depend_on_the_ticks(elapsed_us: list[int]) -> None:
    limiter = ForceLimiter(MAX_FORCE_N, SLEW_N_PER_S)
    now_us = 1_000
    limited_n = limiter.limit(99.0, now_us)
    for step_us in elapsed_us:
        now_us += step_us
        limited_n = limiter.limit(99.0, now_us)
    expected_n = min(MAX_FORCE_N, SLEW_N_PER_S * (now_us - 1_000) * 1e-6)
    assert limited_n == pytest.approx(expected_n, rel=1e-12)


def pressing(force_n: float) -> tuple[ForceLimiter, int]:
    """Return a limiter whose target is `force_n`, and the time [µs]."""
    limiter = ForceLimiter(MAX_FORCE_N, SLEW_N_PER_S)
    now_us = 0
    while limiter.limit(force_n, now_us) < force_n:
        now_us += 1_000
    return limiter, now_us


@given(st.floats(0.0, 5.0), st.floats(0.0, 1.0))
def test_passes_forces_within_the_limits_and_delays_no_fall(force_n: float, share: float) -> None:
    limiter, now_us = pressing(force_n)
    assert limiter.limit(force_n, now_us + 1_000) == force_n
    assert limiter.limit(share * force_n, now_us + 1_001) == share * force_n


@pytest.mark.parametrize("stalled_us", [LONGEST_STEP_US + 1, 50_000, PAUSE_US - 1])
def test_a_stalled_tick_lets_the_force_rise_by_one_step_only(stalled_us: int) -> None:
    limiter, now_us = pressing(1.0)
    now_us += stalled_us
    assert limiter.limit(5.0, now_us) == pytest.approx(1.0 + LIMIT_STEP_N)
    assert limiter.limit(5.0, now_us + 1_000) == pytest.approx(1.0 + LIMIT_STEP_N + 0.05)


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
    limiter = ForceLimiter(MAX_FORCE_N, SLEW_N_PER_S)
    limiter.limit(5.0, 10**12)
    assert limiter.limit(5.0, 10**12) == 0.0
    assert limiter.limit(5.0, 0) == 0.0
    assert limiter.limit(5.0, 1_000) == pytest.approx(0.05)
