"""Setpoints of a wired device and the estimate of its servos, with a stand-in for the firmware."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.servos import Linkage
from hapticnet.device.wired import WiredDevice
from tests.device.standin import CALIBRATION, LONGEST, SHORTEST, STEP, Line, StandIn, line, streaming

ANY = st.floats(allow_nan=True, allow_infinity=True)


def test_the_estimate_is_within_a_tenth_of_a_millimetre_of_the_true_servos() -> None:
    made = streaming()
    rng = random.Random(2)
    displacement_m = furthest = 0.0
    for ms in range(20_000):
        if ms % 50 == 0:
            displacement_m = rng.choice([displacement_m, rng.uniform(0.0, 0.015), displacement_m + 0.0001, math.nan])
        reading = made.step(displacement_m)
        assert reading is not None
        assert abs(reading.displacement_m - made.device.servos.displacement_m) < 1e-4
        furthest = max(furthest, reading.displacement_m)
    assert furthest > 0.010


def test_a_step_limited_by_the_firmware_is_estimated() -> None:
    made = streaming()
    made.run(55, 0.01)
    # On a slow line, a frame may take a setpoint before the next one, made without knowing this, arrives.
    delayed: list[bytes] = []

    def late(data: bytes) -> bytes:
        delayed.append(data)
        return delayed.pop(0) if len(delayed) > 25 else b""

    made.device_hears = late
    for ms in range(4_000):
        reading = made.step(0.012 if ms // 33 % 2 else 0.0)
        assert reading is not None
        assert abs(reading.displacement_m - made.device.servos.displacement_m) < 1e-4
    assert made.device.step_limited > 0


def test_the_platform_reaches_its_displacement_and_stays() -> None:
    made = streaming()
    made.run(1_000, 0.008)
    assert made.device.servos.displacement_m == pytest.approx(0.008, abs=6e-5)
    arrived = len(made.device.setpoints)
    made.run(1_000, 0.008)
    assert len(made.device.setpoints) - arrived == 50  # a sign of life per frame
    made.run(1_000, math.nan)
    assert made.device.servos.displacement_m < 6e-5
    made.run(1_000, 1e300)
    assert made.device.servos.displacement_m == pytest.approx(made.host.capabilities.travel_m, abs=6e-5)


@given(st.lists(st.tuples(ANY, st.integers(1, 45)), max_size=30))
def test_setpoints_are_within_limits_and_a_step_of_the_held_pulses(plan: list[tuple[float, int]]) -> None:
    made = streaming()
    for displacement_m, ms in plan:
        made.run(ms, displacement_m)
    for setpoint, held in made.device.setpoints:
        for pulse, held_pulse in zip(setpoint[1:], held, strict=True):
            assert SHORTEST <= pulse <= LONGEST
            assert pulse - held_pulse <= STEP
    assert made.device.refused == 0
    assert made.device.step_limited == 0


def test_setpoints_of_a_wider_linkage_stay_within_the_firmware_s_limits() -> None:
    made = Line(WiredDevice(CALIBRATION, linkage=Linkage(retracted_us=1100.0, extended_us=2200.0)), StandIn())
    made.open()
    for displacement_m in (0.0, 1.0, math.nan):
        made.run(500, displacement_m)
    pulses = {pulse for setpoint, _ in made.device.setpoints for pulse in setpoint[1:]}
    assert min(pulses) == SHORTEST
    assert max(pulses) == LONGEST
    assert made.device.refused == 0


def test_a_pending_setpoint_is_not_confused_with_one_of_an_earlier_host() -> None:
    device = StandIn()
    device.applied = 1  # happens to be the last number of an earlier host
    made = line(device)
    for _ in range(100):
        reading = made.step(0.005)
        if reading is not None:
            assert abs(reading.displacement_m - device.servos.displacement_m) < 1e-4
    assert device.servos.displacement_m > 0.001
