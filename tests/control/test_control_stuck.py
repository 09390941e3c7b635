"""A sensor that no longer answers, and fingers that do."""

import pytest

from hapticnet.control.stuck import ANSWER_N, StuckSensor

PERIODS = 200


def moving(stuck: StuckSensor, *, from_m: float, speed_m: float, force_n: float, rise_n_m: float) -> int | None:
    """Return after how many periods it was noticed; the force rises by `rise_n_m` per metre."""
    for period in range(PERIODS):
        way_m = speed_m * period
        if stuck.noticed(True, force_n + rise_n_m * way_m, from_m + way_m, 1e-3):
            return period
    return None


@pytest.mark.parametrize("speed_m", [1e-4, -1e-4])
def test_a_force_that_stays_while_the_platform_moves_is_noticed_after_little_more_than_a_newton_of_way(
    speed_m: float,
) -> None:
    noticed = moving(StuckSensor(), from_m=0.003, speed_m=speed_m, force_n=1.0, rise_n_m=0.0)
    assert noticed is not None
    assert 1.0e-3 < noticed * abs(speed_m) < 1.4e-3


@pytest.mark.parametrize("stiffness_n_m", [200.0, 1000.0, 3000.0])
def test_a_finger_that_answers_is_no_stuck_sensor(stiffness_n_m: float) -> None:
    assert moving(StuckSensor(), from_m=0.003, speed_m=1e-5, force_n=0.5, rise_n_m=stiffness_n_m) is None


def test_a_platform_at_rest_proves_nothing() -> None:
    stuck = StuckSensor()
    assert not any(stuck.noticed(True, 1.0, 0.003, 1e-3) for _ in range(10_000))


def test_no_touch_is_no_fault() -> None:
    stuck = StuckSensor()
    assert not any(stuck.noticed(False, 0.0, 1e-4 * period, 1e-3) for period in range(PERIODS))


def test_an_answer_starts_the_watch_anew() -> None:
    stuck = StuckSensor()
    for turn in range(20):
        force_n = 1.0 + 1.5 * ANSWER_N * (turn % 2)
        assert not any(stuck.noticed(True, force_n, 1e-3 * turn + 1e-5 * step, 1e-3) for step in range(90))
