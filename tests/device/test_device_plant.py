import dataclasses
import math

import numpy as np
import pytest

from hapticnet.device.servos import Linkage, Servo
from hapticnet.device.simulated import Finger, Plant, PlantSettings, Sensor
from hapticnet.errors import SettingsError

LINKAGE = Linkage()
QUIET = PlantSettings(sensor=Sensor(noise_counts=0.0))


def plant(settings: PlantSettings = QUIET, seed: int = 0) -> Plant:
    made = Plant(settings, np.random.default_rng(seed))
    made.advance(0)
    return made


def settled_at(made: Plant, displacement_m: float, now_us: int) -> int:
    """Move the platform to a displacement and return the counts."""
    made.advance(now_us)
    made.take((LINKAGE.pulse_us(displacement_m),) * 3)
    made.advance(now_us + 5_000_000)
    return made.read()


def test_pulses_given_one_by_one_have_the_effect_of_a_frame() -> None:
    together, one_by_one = plant(), plant()
    together.take((1500.0, 1520.0, 1540.0))
    for index, pulse_us in enumerate((1500.0, 1520.0, 1540.0)):
        one_by_one.advance(2_500.5 * index)
        one_by_one.take_one(index, pulse_us)
    for made in (together, one_by_one):
        made.advance(5_000_000)
    assert one_by_one.displacement_m == together.displacement_m
    assert one_by_one.contact_force_n == together.contact_force_n > 1.0


def test_the_first_time_only_sets_the_clock() -> None:
    made = Plant(QUIET, np.random.default_rng(0))
    made.take((1500.0,) * 3)
    made.advance(10**12)
    assert made.displacement_m == 0.0


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
@pytest.mark.parametrize("stiffening", [0.0, 0.3, 0.9])
def test_a_finger_has_its_stiffness_at_one_newton(stiffness_n_m: float, stiffening: float) -> None:
    finger = Finger(stiffness_n_m=stiffness_n_m, stiffening=stiffening)
    displacements_m = np.linspace(0.002, 0.012, 100_001)
    forces_n = np.array([finger.force_n(displacement_m) for displacement_m in displacements_m])
    at = int(np.argmax(forces_n >= 1.0))
    assert np.gradient(forces_n, displacements_m)[at] == pytest.approx(stiffness_n_m, rel=1e-3)
    assert np.all(np.diff(forces_n) >= 0.0)
    assert finger.force_n(-1.0) == finger.force_n(0.0019) == 0.0


@pytest.mark.parametrize("stiffening", [5e-324, 1e-310, 1e-13, 1e-12])
def test_a_finger_that_hardly_stiffens_is_a_linear_spring(stiffening):
    finger, spring = Finger(stiffening=stiffening), Finger(stiffening=0.0)
    assert finger.force_n(0.003) == pytest.approx(spring.force_n(0.003), rel=1e-11)


def test_the_force_cannot_exceed_the_servos_stall_force() -> None:
    made = plant(dataclasses.replace(QUIET, finger=Finger(stiffness_n_m=1e5)))
    settled_at(made, 0.015, 0)
    assert made.contact_force_n == pytest.approx(3 * 0.108 / 0.012)


@pytest.mark.parametrize(("force_n", "per_count_n"), [(2.0, 0.009), (10.0, 0.12)])
def test_the_converter_has_the_resolution_of_a_10_kohm_divider(force_n: float, per_count_n: float) -> None:
    sensor = Sensor()
    slope = (sensor.counts(force_n + 0.01) - sensor.counts(force_n - 0.01)) / 0.02
    assert 1.0 / slope == pytest.approx(per_count_n, rel=0.05)


def test_below_its_threshold_the_sensor_reads_zero() -> None:
    made = plant(PlantSettings())
    assert settled_at(made, 0.00215, 0) == 0
    assert made.contact_force_n > 0.05
    assert settled_at(made, 0.0024, 10_000_000) > 150


def test_unloading_readings_are_higher_by_the_hysteresis() -> None:
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
        readings.append([made.read() for _ in range(3_000)])
    assert readings[0] == readings[1] != readings[2]
    assert np.std(readings[0]) == pytest.approx(2.0, abs=0.15)


def test_a_voltage_is_the_mean_and_the_noise_without_rounding() -> None:
    made = plant(PlantSettings(sensor=Sensor(noise_counts=2.0)))
    assert made.level_counts() == 0.0
    settled_at(made, 0.004, 0)
    levels = [made.level_counts() for _ in range(3_000)]
    assert np.mean(levels) == pytest.approx(Sensor().counts(made.contact_force_n), abs=0.2)
    assert np.std(levels) == pytest.approx(2.0, abs=0.15)
    assert sum(level == int(level) for level in levels) < 10


def test_an_exchanged_finger_takes_effect_at_once() -> None:
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
        bad = -1 if isinstance(field.default, int) else value
        with pytest.raises(SettingsError, match="must be between"):
            part(**{field.name: bad})
