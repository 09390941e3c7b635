"""The compiled firmware, the host's end of the line and the plant, in lockstep and virtual time."""

import math
from typing import Any

import pytest

from hapticnet.device.base import Reading
from hapticnet.device.simulated import Finger, PlantSettings, Sensor
from hapticnet.errors import SettingsError
from hapticnet.runtime.nano import CYCLES_PER_US, Disturbance, SimulatedNano

MS = 1_000
BOOT_AND_GREET_US = 150 * MS
QUIET = PlantSettings(sensor=Sensor(noise_counts=0.0))

Readings = list[Reading | None]


def play(nano: SimulatedNano, displacement_m: float, start_us: int, end_us: int, step_us: int = MS) -> Readings:
    """Set a displacement in every step; the last is exactly at `end_us`."""
    return [nano.exchange(displacement_m, now_us) for now_us in (*range(start_us, end_us, step_us), end_us)]


def test_it_starts_and_identifies_itself(simulated: Any) -> None:
    nano = simulated()
    assert nano.status == "the port is not open"
    assert "1 N/mm" in nano.description
    readings = play(nano, 0.0, 5_000_000, 5_000_000 + BOOT_AND_GREET_US)
    assert readings[0] is None
    assert nano.status == "ready"
    assert nano.wired.identity is not None
    assert nano.report() == nano.wired.report()
    newest = readings[-1]
    assert newest is not None
    assert 0 <= 5_000_000 + BOOT_AND_GREET_US - newest.t_us < 1_000 * nano.wired.stream_period_ms
    assert newest[1:] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_pressing_a_finger_reads_the_true_force(simulated: Any, stiffness_n_m: float) -> None:
    nano = simulated(PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m)))
    play(nano, 0.0, 0, BOOT_AND_GREET_US)
    compared = 0
    for ms in range(2_000):
        # Only while pressing: during release the sensor reads too much by up to its hysteresis.
        reading = nano.exchange(0.002 + 2.5e-3 * 300.0 / stiffness_n_m * ms / 1_000, BOOT_AND_GREET_US + ms * MS)
        assert reading is not None
        if nano.contact_force_n > 0.25:
            # Calibration error, noise, and the increase of the force in the millisecond since the reading.
            assert reading.force_n == pytest.approx(nano.contact_force_n, rel=0.05, abs=0.06)
            compared += 1
    assert compared > 500


def test_it_reaches_and_reports_its_displacement(simulated: Any) -> None:
    nano = simulated(PlantSettings(finger=Finger(contact_m=0.05)))
    play(nano, 0.0, 0, BOOT_AND_GREET_US)
    now_us = BOOT_AND_GREET_US
    for displacement_m in (0.003, 0.008, 0.0075, 0.001):
        readings = play(nano, displacement_m, now_us, now_us + 600 * MS)
        now_us += 600 * MS
        # Half the backlash, a quarter of the deadband for the goal, and a deadband for a pulse with edges 0.5 µs off.
        half_play_m, deadband_m = 0.012 * math.radians(0.25), 0.012 * math.radians(0.8)
        assert readings[-1] is not None
        assert readings[-1].displacement_m == pytest.approx(nano.plant.displacement_m, abs=half_play_m + deadband_m)
        assert nano.plant.displacement_m == pytest.approx(displacement_m, abs=half_play_m + 1.25 * deadband_m)


def test_the_same_seed_gives_the_same_run_to_the_byte(simulated: Any) -> None:
    def run(seed: int) -> Readings:
        nano = simulated(seed=seed, delay_us=3_000, loss=0.2)
        return [nano.exchange(0.003 + 1e-6 * (ms % 700), ms * MS) for ms in range(1_500)]

    first = run(1)
    assert sum(reading is not None for reading in first) > 1_000
    assert run(1) == first != run(2)


@pytest.mark.parametrize("step_us", [333, 1_000, 1_700, 20_000])
def test_the_firmware_s_clock_follows_the_caller_s_for_any_steps(simulated: Any, step_us: int) -> None:
    nano = simulated(QUIET)
    readings = play(nano, 0.004, 10**12, 10**12 + 1_500 * MS, step_us)
    assert nano.board._cycle / CYCLES_PER_US == pytest.approx(1_500 * MS, abs=2.0)
    assert readings[-1] is not None
    assert readings[-1].force_n == pytest.approx(nano.contact_force_n, rel=0.05)
    assert nano.contact_force_n > 1.5


def test_repeated_earlier_and_distant_times_are_accepted(simulated: Any) -> None:
    nano = simulated(QUIET)
    pressing = play(nano, 0.004, 0, 1_000 * MS)[-1]
    assert pressing is not None
    for now_us in (1_000 * MS, 400 * MS, -(10**15)):
        assert nano.exchange(0.004, now_us) == pressing
        assert nano.contact_force_n > 1.5
    # It retracted during the time without setpoints and then presses again.
    nano.exchange(0.004, 10**15)
    assert nano.contact_force_n == 0.0
    assert play(nano, 0.004, 10**15 + MS, 10**15 + 1_000 * MS)[-1] is not None
    assert nano.contact_force_n > 1.5
    assert nano.board.resets == 0


@pytest.mark.parametrize("displacement_m", [math.nan, -math.inf, -1e300])
def test_an_invalid_displacement_retracts(simulated: Any, displacement_m: float) -> None:
    nano = simulated()
    play(nano, 0.004, 0, 600 * MS)
    assert nano.contact_force_n > 1.5
    assert play(nano, displacement_m, 601 * MS, 1_000 * MS)[-1] is not None
    assert nano.contact_force_n == 0.0


def test_a_device_unplugged_before_the_first_exchange_stays_unplugged(simulated: Any) -> None:
    nano = simulated()
    nano.pull_plug(0)
    assert play(nano, 0.004, 0, 300 * MS)[-1] is None
    assert nano.status == "unplugged"
    nano.plug_in(300 * MS)
    assert play(nano, 0.004, 301 * MS, 500 * MS)[-1] is not None


def test_a_sensor_fault_changes_the_converters_input(simulated: Any) -> None:
    nano = simulated()
    play(nano, 0.004, 0, 600 * MS)
    nano.board.sensor = lambda _counts, _now_us: 2_000.0
    stuck = play(nano, 0.004, 601 * MS, 610 * MS)[-1]
    nano.board.sensor = lambda counts, now_us: counts if now_us < 620 * MS else 0.0
    sound, open_circuit = play(nano, 0.004, 611 * MS, 630 * MS)[8::11]
    assert stuck is not None
    assert stuck.adc == 1023.0
    assert sound is not None
    assert sound.force_n == pytest.approx(nano.contact_force_n, rel=0.05)
    assert open_circuit is not None
    assert open_circuit.adc == 0.0


def test_a_delay_postpones_what_the_host_writes(simulated: Any) -> None:
    def moved_at_ms(delay_us: int) -> int:
        nano = simulated(QUIET, delay_us=delay_us)
        play(nano, 0.0, 0, 600 * MS)
        ms = 600
        while nano.plant.displacement_m < 1e-4:
            ms += 1
            nano.exchange(0.004, ms * MS)
            assert ms < 1_000
        return ms

    assert moved_at_ms(40_000) - moved_at_ms(0) == 40


def test_it_starts_and_presses_with_a_third_of_all_writes_lost_but_not_with_all(simulated: Any) -> None:
    nano = simulated(loss=0.3)
    assert play(nano, 0.004, 0, 2_000 * MS)[-1] is not None
    assert nano.contact_force_n > 1.5
    silent = simulated(loss=1.0)
    assert play(silent, 0.004, 0, 500 * MS)[-1] is None
    assert silent.plant.displacement_m == 0.0


def test_a_simulator_that_ends_is_a_lost_device(simulated: Any) -> None:
    nano = simulated()
    play(nano, 0.0, 0, 200 * MS)
    nano.board._simavr._process.kill()
    nano.board._simavr._process.wait()
    assert play(nano, 0.0, 201 * MS, 210 * MS) == [None] * 10
    assert "simulator ended with code -9" in nano.status


@pytest.mark.parametrize("bad", [{"delay_us": -1}, {"delay_us": 10_000_001}, {"loss": -0.1}, {"loss": math.nan}])
def test_a_disturbance_out_of_range_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="must be between"):
        Disturbance(**bad)
