import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.base import Device
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger, PlantSettings, Sensor, SimulatedDevice

FRAME_US = Servo().frame_us
QUIET = PlantSettings(sensor=Sensor(noise_counts=0.0))
ANY = st.floats(allow_nan=True, allow_infinity=True)


def device(settings: PlantSettings | None = None, seed: int = 0) -> SimulatedDevice:
    return SimulatedDevice(settings or PlantSettings(), np.random.default_rng(seed))


def test_has_a_description() -> None:
    made = device(PlantSettings(finger=Finger(stiffness_n_m=600.0)))
    assert Device in SimulatedDevice.__mro__
    assert "0.6 N/mm" in made.description
    assert made.status == "ready"
    assert made.capabilities.max_force_n == 5.0
    assert 0.015 <= made.capabilities.travel_m < 0.016


def test_pressing_a_finger_reads_the_true_force_within_the_sensor_s_error() -> None:
    made = device()
    for ms in range(2_000):
        reading = made.exchange(2e-6 * ms, ms * 1_000)
        assert reading.t_us == ms * 1_000
        if made.contact_force_n > 0.25:
            assert reading.force_n == pytest.approx(made.contact_force_n, rel=0.04, abs=0.05)
    assert made.contact_force_n > 1.5


def test_reaches_its_displacement_within_the_servos_resolution() -> None:
    made = device(PlantSettings(finger=Finger(contact_m=0.05)))
    for number, displacement_m in enumerate((0.002, 0.0021, 0.008, 0.00795, 0.001, math.nan)):
        for ms in range(500):
            made.exchange(displacement_m, (500 * number + ms) * 1_000)
        # A quarter of the 8 µs deadband and half of the 5 µs backlash, on a 12 mm arm at 10 µs per degree.
        reached_m = 0.0 if math.isnan(displacement_m) else displacement_m
        assert made.plant.displacement_m == pytest.approx(reached_m, abs=0.012 * math.radians(0.45))


def test_setpoints_wait_for_the_next_frame() -> None:
    made = device()
    for now_us in range(0, FRAME_US, 1_000):
        assert made.exchange(0.0, now_us).displacement_m == 0.0
    made.exchange(0.004, FRAME_US)  # which takes a setpoint of the same time
    assert made.plant.displacement_m == 0.0
    assert made.exchange(0.004, FRAME_US + 1_000).displacement_m > 0.0
    assert made.plant.displacement_m > 0.0


def test_the_newest_setpoint_before_a_frame_wins() -> None:
    leaps, waits = device(QUIET), device(QUIET)
    for made, first_m in ((leaps, 0.01), (waits, 0.0)):
        made.exchange(first_m, 0)
        made.exchange(0.004, FRAME_US - 1)
    for now_us in (FRAME_US + 5_000, FRAME_US + 15_000):
        assert leaps.exchange(0.01, now_us) == waits.exchange(0.01, now_us)
    assert leaps.plant.displacement_m > 1e-4


def test_during_a_long_gap_the_last_setpoint_applies() -> None:
    made = device(QUIET)
    made.exchange(0.004, 0)
    reading = made.exchange(0.0, 3_000_001)
    assert reading.force_n > 1.0
    assert reading.displacement_m == pytest.approx(0.004, abs=0.012 * math.radians(0.2))


def test_the_reported_displacement_is_true_except_for_backlash() -> None:
    made = device(PlantSettings(servo=Servo(backlash_deg=0.0)))
    played = device()
    half_play_m = 0.012 * math.radians(0.25)
    for ms in range(3_000):
        displacement_m = 0.003 + 0.002 * math.sin(6.0 * ms / 1_000)
        assert made.exchange(displacement_m, ms * 1_000).displacement_m == made.plant.displacement_m
        reading = played.exchange(displacement_m, ms * 1_000)
        assert abs(reading.displacement_m - played.plant.displacement_m) <= half_play_m


def test_repeated_and_earlier_times_advance_nothing_and_frames_continue() -> None:
    made = device(QUIET)
    for ms in range(1_000):
        settled = made.exchange(0.004, ms * 1_000)
    for now_us in (999_000, 500_000, 105_000, 105_000):
        assert made.exchange(0.008, now_us) == settled._replace(t_us=now_us)
    assert made.exchange(0.008, 120_000) == settled._replace(t_us=120_000)
    assert made.exchange(0.008, 121_000).displacement_m > settled.displacement_m


@given(st.lists(st.tuples(ANY, st.integers(-(10**15), 10**15)), max_size=60))
def test_never_raises_and_stays_within_the_travel(calls: list[tuple[float, int]]) -> None:
    made = device()
    for displacement_m, now_us in calls:
        reading = made.exchange(displacement_m, now_us)
        assert 0 <= reading.adc <= 1023
        assert 0.0 <= reading.force_n <= 20.0
        assert -4e-4 <= made.plant.displacement_m <= made.capabilities.travel_m + 4e-4
