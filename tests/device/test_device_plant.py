import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Finger, Sensor, Servo
from hapticnet.device.plant import Plant, PlantSettings
from hapticnet.errors import SettingsError

FRAME_US = Servo().frame_us
LAG_S = Servo().lag_s
LINKAGE = Linkage()
PRESSING: Pulses = (1500.0, 1500.0, 1500.0)
QUIET = PlantSettings(sensor=Sensor(noise_counts=0.0))
IDEAL = PlantSettings(
    servo=Servo(backlash_deg=0.0), finger=Finger(contact_m=0.05), sensor=Sensor(noise_counts=0.0, hysteresis=0.0)
)


def plant(settings: PlantSettings = QUIET, seed: int = 0) -> Plant:
    made = Plant(settings, np.random.default_rng(seed))
    made.step(made.latched_us, 0)
    return made


def settled_at(made: Plant, displacement_m: float, now_us: int) -> int:
    """Send the platform somewhere, let it arrive, and return the counts."""
    pulse_us = LINKAGE.pulse_us(displacement_m)
    made.step((pulse_us,) * 3, now_us)
    return made.step((pulse_us,) * 3, now_us + 5_000_000)


def test_pulses_wait_for_the_next_frame() -> None:
    made = plant()
    for now_us in range(1_000, FRAME_US, 1_000):
        made.step(PRESSING, now_us)
        assert made.displacement_m == 0.0
    made.step(PRESSING, FRAME_US)
    made.step(PRESSING, FRAME_US + 1_000)
    assert made.displacement_m > 0.0


def test_the_newest_pulses_before_a_frame_win() -> None:
    made = plant()
    made.step((1900.0,) * 3, 1_000)
    made.step(PRESSING, FRAME_US - 1)
    made.step((1900.0,) * 3, FRAME_US + 5_000)
    assert made.latched_us == PRESSING


def test_a_small_motion_is_a_first_order_lag() -> None:
    made = plant(IDEAL)
    made.step((1260.0,) * 3, FRAME_US)
    for after_us in (10_000, 19_000, 45_000, 100_000):
        made.step((1260.0,) * 3, FRAME_US + after_us)
        pulse_us = LINKAGE.pulse_us(made.displacement_m)
        assert pulse_us == pytest.approx(1260.0 - 60.0 * math.exp(-after_us * 1e-6 / LAG_S), abs=0.02)


def test_a_large_motion_goes_at_the_speed_limit() -> None:
    made = plant(IDEAL)
    made.step((2000.0,) * 3, FRAME_US)
    made.step((2000.0,) * 3, FRAME_US + 100_000)
    assert LINKAGE.pulse_us(made.displacement_m) == pytest.approx(1200.0 + 353.0 * 10.0 * 0.1)


@given(st.lists(st.integers(1, 150_000), min_size=1, max_size=60))
def test_the_motion_does_not_depend_on_the_steps(steps_us: list[int]) -> None:
    end_us = sum(steps_us)
    in_steps, at_once = plant(), plant()
    now_us = 0
    for made in (in_steps, at_once):
        made.step((1700.0, 1500.0, 1250.0), 0)
    for step_us in steps_us:
        now_us += step_us
        in_steps.step((1700.0, 1500.0, 1250.0), now_us)
    at_once.step((1700.0, 1500.0, 1250.0), end_us)
    assert in_steps.displacement_m == pytest.approx(at_once.displacement_m, abs=2e-6)
    assert in_steps.latched_us == at_once.latched_us


@given(st.lists(st.tuples(st.floats(1200.0, 2000.0), st.integers(-(10**12), 10**12)), max_size=40))
def test_any_time_stamps_are_survived(calls: list[tuple[float, int]]) -> None:
    made = plant(PlantSettings())
    for pulse_us, now_us in calls:
        assert 0 <= made.step((pulse_us,) * 3, now_us) <= 1023
        assert -1e-4 <= made.displacement_m <= LINKAGE.travel_m + 1e-4


def test_repeated_and_backward_times_advance_nothing_and_the_clock_goes_on() -> None:
    made = plant(PlantSettings())
    counts = settled_at(made, 0.004, 0)
    at_m = made.displacement_m
    for now_us in (5_000_000, 4_000_000, 1_000_000, 1_000_000):
        assert made.step((1900.0,) * 3, now_us) == counts
        assert made.displacement_m == at_m
    made.step((1900.0,) * 3, 1_000_000 + 2 * FRAME_US)
    assert made.displacement_m > at_m


def test_a_servo_ignores_less_than_its_deadband() -> None:
    made = plant(IDEAL)
    settled_at(made, 0.004, 0)
    before_m = made.displacement_m
    pulse_us = LINKAGE.pulse_us(0.004)
    made.step((pulse_us + 7.9,) * 3, 6_000_000)
    made.step((pulse_us + 7.9,) * 3, 7_000_000)
    assert made.displacement_m == before_m
    made.step((pulse_us + 8.1, pulse_us, pulse_us), 8_000_000)
    made.step((pulse_us + 8.1, pulse_us, pulse_us), 9_000_000)
    assert made.displacement_m == pytest.approx(before_m + 0.012 * math.radians(0.81) / 3, rel=0.05)


def test_backlash_lags_behind_on_reversal() -> None:
    made = plant(dataclasses.replace(IDEAL, servo=Servo(backlash_deg=2.0)))
    settled_at(made, 0.006, 0)
    assert LINKAGE.pulse_us(0.006) - LINKAGE.pulse_us(made.displacement_m) == pytest.approx(10.0, abs=0.02)
    settled_at(made, LINKAGE.displacement_m(LINKAGE.pulse_us(0.006) - 19.0), 10_000_000)
    assert LINKAGE.pulse_us(0.006) - LINKAGE.pulse_us(made.displacement_m) == pytest.approx(10.0, abs=0.02)


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
@pytest.mark.parametrize("stiffening", [0.0, 0.3, 0.9])
def test_a_finger_has_its_stiffness_at_one_newton(stiffness_n_m: float, stiffening: float) -> None:
    finger = Finger(stiffness_n_m=stiffness_n_m, stiffening=stiffening)
    displacements_m = np.linspace(0.002, 0.012, 100_001)
    forces_n = np.array([finger.force_n(displacement_m) for displacement_m in displacements_m])
    at = int(np.argmax(forces_n >= 1.0))
    assert np.gradient(forces_n, displacements_m)[at] == pytest.approx(stiffness_n_m, rel=1e-3)
    assert np.all(np.diff(forces_n) >= 0.0)


@pytest.mark.parametrize("displacement_m", [-1.0, 0.0, 0.0019])
def test_a_finger_that_is_not_touched_gives_no_force(displacement_m: float) -> None:
    assert Finger().force_n(displacement_m) == 0.0


def test_the_force_cannot_exceed_what_stalls_the_servos() -> None:
    made = plant(dataclasses.replace(QUIET, finger=Finger(stiffness_n_m=1e5)))
    settled_at(made, 0.015, 0)
    assert made.contact_force_n == pytest.approx(3 * 0.108 / 0.012)


@pytest.mark.parametrize(("force_n", "per_count_n"), [(2.0, 0.009), (10.0, 0.12)])
def test_the_converter_resolves_what_a_10_kohm_divider_gives(force_n: float, per_count_n: float) -> None:
    sensor = Sensor()
    slope = (sensor.counts(force_n + 0.01) - sensor.counts(force_n - 0.01)) / 0.02
    assert 1.0 / slope == pytest.approx(per_count_n, rel=0.05)


def test_below_the_threshold_the_sensor_is_silent() -> None:
    made = plant(PlantSettings())
    assert settled_at(made, 0.00215, 0) == 0
    assert made.contact_force_n > 0.05
    assert settled_at(made, 0.0024, 10_000_000) > 150


def test_unloading_reads_the_hysteresis_more_and_loading_none() -> None:
    sensor = Sensor(noise_counts=0.0)
    made = plant()
    for ms, displacement_m in enumerate((0.0030, 0.0035, 0.0040)):
        counts = settled_at(made, displacement_m, ms * 10_000_000)
        assert counts == int(sensor.counts(made.contact_force_n))
    counts = settled_at(made, 0.0030, 30_000_000)
    assert counts == int(sensor.counts(made.contact_force_n / 0.9))
    # Resistance at the same force is 10 % lower than while loading.
    conductance = [n / (1024 - n) for n in (sensor.counts(made.contact_force_n), counts + 0.5)]
    assert conductance[0] / conductance[1] == pytest.approx(0.9, abs=0.005)


def test_noise_has_its_standard_deviation_and_depends_on_the_seed_alone() -> None:
    readings = []
    for seed in (1, 1, 2):
        made = plant(PlantSettings(sensor=Sensor(noise_counts=2.0)), seed)
        settled_at(made, 0.004, 0)
        readings.append([made.step(made.latched_us, 6_000_000 + tick) for tick in range(3_000)])
    assert readings[0] == readings[1] != readings[2]
    assert np.std(readings[0]) == pytest.approx(2.0, abs=0.15)


def test_another_finger_is_felt_at_once() -> None:
    made = plant()
    settled_at(made, 0.004, 0)
    before_n = made.contact_force_n
    made.exchange_finger(Finger(stiffness_n_m=2000.0))
    assert made.contact_force_n > 2.0 * before_n
    made.exchange_finger(Finger(contact_m=0.02))
    assert made.contact_force_n == 0.0


@pytest.mark.parametrize("part", [Servo, Finger, Sensor])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_refuses_bad_settings(part: type[Servo] | type[Finger] | type[Sensor], value: float) -> None:
    for field in dataclasses.fields(part):
        with pytest.raises(SettingsError, match="must be between"):
            part(**{field.name: value})
