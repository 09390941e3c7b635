import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.calibration import Calibration
from hapticnet.device.parts import Sensor
from hapticnet.device.simulated import loading_calibration
from hapticnet.errors import SettingsError

SENSOR = Sensor()
CALIBRATION = loading_calibration(SENSOR)


@given(st.integers(-5, 1030), st.integers(-5, 1030))
def test_force_is_monotone_in_counts(a: int, b: int) -> None:
    low, high = sorted((a, b))
    assert 0.0 <= CALIBRATION.force_n(low) <= CALIBRATION.force_n(high) <= 20.0


@given(st.floats(0.2, 20.0))
def test_inverts_the_loading_sensor_over_its_range(force_n: float) -> None:
    assert CALIBRATION.force_n(SENSOR.counts(force_n)) == pytest.approx(force_n, rel=0.04)


@pytest.mark.parametrize("exponent", [0.9, 1.0, 1.1])
def test_is_exact_at_the_calibrated_forces(exponent: float) -> None:
    sensor = Sensor(exponent=exponent)
    calibration = loading_calibration(sensor)
    for force_n in calibration.forces_n:
        assert calibration.force_n(sensor.counts(force_n)) == pytest.approx(force_n, rel=1e-12)


def test_beyond_its_ends_it_falls_to_zero_and_stays_at_the_largest() -> None:
    calibration = Calibration(counts=(100.0, 200.0), forces_n=(0.5, 2.5))
    assert [calibration.force_n(adc) for adc in (-1, 0, 50, 100, 200, 1023)] == [0.0, 0.0, 0.25, 0.5, 2.5, 2.5]


def test_a_reading_that_is_no_number_counts_as_the_largest_force() -> None:
    assert CALIBRATION.force_n(math.nan) == 20.0


@pytest.mark.parametrize(
    ("counts", "forces_n"),
    [
        ((), ()),
        ((100.0,), (1.0,)),
        ((100.0, 200.0), (1.0,)),
        ((200.0, 100.0), (1.0, 2.0)),
        ((100.0, 100.0), (1.0, 2.0)),
        ((100.0, 200.0), (2.0, 1.0)),
        ((0.0, 200.0), (1.0, 2.0)),
        ((100.0, math.nan), (1.0, 2.0)),
        ((100.0, 200.0), (1.0, math.inf)),
    ],
)
def test_refuses_a_table_that_is_not_monotone(counts: tuple[float, ...], forces_n: tuple[float, ...]) -> None:
    with pytest.raises(SettingsError, match="calibration"):
        Calibration(counts, forces_n)
