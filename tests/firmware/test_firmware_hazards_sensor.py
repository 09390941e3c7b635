"""Tests of docs/understand/safety.md for sensor faults, on the compiled firmware under load, in virtual time."""

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hapticnet.device.calibration import Calibration
from hapticnet.device.profile import GENERIC_CALIBRATION
from hapticnet.node.fingertip import ForceFault
from tests.firmware.rig import FINGERS_N_M, MS, RETRACT_MS, released_ms


def open_input(kind: str) -> Callable[[float, int], float]:
    """Return the reading of a floating input: mains hum at a phase, or noise over the range."""
    if kind == "noise":
        chance = random.Random(3)
        return lambda _counts, _now_us: chance.uniform(0.0, 1023.0)
    hertz, phase = (float(part.split()[0]) for part in kind.split(" at "))
    return lambda _counts, now_us: 400.0 + 300.0 * math.sin(2.0 * math.pi * (hertz * now_us * 1e-6 + phase / 360.0))


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [1.0, 4.6])
def test_a_sensor_that_fails_while_pressing_adds_no_force_and_is_released_with_the_target(
    pressing: Any, stiffness_n_m: float, force_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=force_n)
    before_n = made.felt_n[-1]
    made.nano.board.sensor = lambda _counts, _now_us: 0.0
    felt_n = made.press(force_n, 1_000)
    assert max(felt_n) <= before_n + 0.05
    # Without a change of the reading the platform rests, and the force on the finger stays.
    assert np.ptp(felt_n[-500:]) < 0.05
    assert 0.8 < felt_n[-1] < 1.8
    assert released_ms(made.press(0.0, 400)) <= RETRACT_MS
    assert max(made.press(force_n, 1_000)) < 1.8


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("counts", [100.0, 500.0])
def test_after_an_unexplained_fall_the_platform_stops_and_releases_with_the_target(
    pressing: Any, stiffness_n_m: float, counts: float
) -> None:
    made = pressing(stiffness_n_m, force_n=4.6)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(4.6, 1_000)) <= 5.0
    assert released_ms(made.press(0.0, 500)) <= 2 * RETRACT_MS
    # On the next approach, it is stuck at an intermediate value.
    assert max(made.press(4.6, 1_000)) == 0.0
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("counts", ["50 Hz at 0 deg", "50 Hz at 90 deg", "50 Hz at 162 deg", "60 Hz at 0 deg", "noise"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [None, 1.0, 4.6], ids=["from the start", "1 N", "4.6 N"])
def test_an_open_input_that_hums_or_jumps_is_detected_and_the_finger_released(
    rig: Any, pressing: Any, stiffness_n_m: float, force_n: float | None, counts: str
) -> None:
    made = rig(stiffness_n_m) if force_n is None else pressing(stiffness_n_m, force_n=force_n)
    before_n = max(made.felt_n, default=0.0)
    made.nano.board.sensor = open_input(counts)
    felt_n = made.press(force_n or 4.6, 600)
    assert max(felt_n) <= before_n + 0.1
    assert released_ms(felt_n) <= 400
    assert felt_n[-1] == 0.0
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("force_n", [1.0, 4.6])
def test_a_sensor_shorted_to_the_supply_releases_the_finger(
    pressing: Any, stiffness_n_m: float, force_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=force_n)
    made.nano.board.sensor = lambda _counts, _now_us: 1023.0
    at_ms, before_n = made.now_us // MS, made.felt_n[-1]
    felt_n = made.press(force_n, 500)
    assert max(felt_n) <= before_n + 0.05
    assert released_ms(felt_n) <= 2 * RETRACT_MS
    (noticed_ms,) = made.times_ms(ForceFault)
    assert noticed_ms - at_ms <= 100
    made.nano.board.sensor = None
    made.press(0.0, 300)
    assert max(made.press(force_n, 1_800)) <= 5.0
    assert made.felt_n[-1] == pytest.approx(force_n, rel=0.1, abs=0.15)


@pytest.mark.parametrize("counts", [0.0, 1023.0], ids=["disconnected", "shorted"])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_sensor_dead_from_the_start_never_causes_more_than_5_n(rig: Any, stiffness_n_m: float, counts: float) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) <= (0.0 if counts else 5.0)


@pytest.mark.parametrize("counts", [100.0, 500.0])
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_sensor_stuck_from_the_start_is_detected_before_contact(
    rig: Any, stiffness_n_m: float, counts: float
) -> None:
    made = rig(stiffness_n_m)
    made.nano.board.sensor = lambda _counts, _now_us: counts
    assert max(made.press(5.0, 1_000)) == 0.0
    assert made.times_ms(ForceFault)[0] <= 300


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize(("from_n", "to_n", "most_n"), [(1.0, 3.0, 2.6), (3.0, 5.0, 5.0), (3.0, 0.0, 3.1)])
def test_a_frozen_sensor_is_detected_when_the_platform_moves(
    pressing: Any, stiffness_n_m: float, from_n: float, to_n: float, most_n: float
) -> None:
    made = pressing(stiffness_n_m, force_n=from_n)
    frozen = made.fingertip.reading.adc
    made.nano.board.sensor = lambda _counts, _now_us: frozen
    assert max(made.press(from_n, 300)) <= 1.05 * from_n
    felt_n = made.press(to_n, 800)
    assert max(felt_n) <= most_n
    assert released_ms(felt_n) <= 400
    assert made.times_ms(ForceFault)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_the_target_is_limited_to_the_end_of_the_table(rig: Any, stiffness_n_m: float) -> None:
    table = GENERIC_CALIBRATION
    made = rig(stiffness_n_m, calibration=Calibration(table.counts[:7], table.forces_n[:7]))
    assert made.nano.max_force_n == 3.0
    assert 2.5 < max(made.press(5.0, 2_500)) <= 3.2
    assert not made.times_ms(ForceFault)


def test_a_table_that_reads_too_little_presses_too_hard_undetected(rig: Any) -> None:
    table = GENERIC_CALIBRATION
    made = rig(calibration=Calibration(table.counts, tuple(0.8 * force_n for force_n in table.forces_n)))
    made.press(2.0, 2_000)
    assert made.felt_n[-1] == pytest.approx(2.0 / 0.8, rel=0.06)
    assert not made.times_ms(ForceFault)
