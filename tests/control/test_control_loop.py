"""Limiter, controller and simulated device in virtual time: what the finger feels."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from hapticnet.control.force import ForceController, ForceControlSettings
from hapticnet.control.limits import ForceLimiter, LimitSettings
from hapticnet.device.parts import Finger, Servo
from hapticnet.device.plant import PlantSettings
from hapticnet.device.simulated import SimulatedDevice

FINGERS_N_M = (300.0, 600.0, 1000.0, 2000.0, 3000.0)
STEP_MS = 2_500


@dataclass
class Trace:
    """What one run gave, tick by tick."""

    contact_n: np.ndarray
    sensed_n: np.ndarray
    displacement_m: np.ndarray


def play(
    target_n: Callable[[int], float],
    milliseconds: int,
    *,
    settings: PlantSettings | None = None,
    seed: int = 0,
    meddle: Callable[[int, SimulatedDevice, float], float] = lambda _ms, _device, sensed_n: sensed_n,
) -> Trace:
    """Run the force loop at 1 kHz; `meddle` may change the device and returns what the controller is told."""
    device = SimulatedDevice(settings or PlantSettings(), np.random.default_rng(seed))
    controller = ForceController(ForceControlSettings())
    limiter = ForceLimiter(LimitSettings())
    rows = []
    sensed_n = 0.0
    for ms in range(milliseconds):
        now_us = ms * 1_000
        displacement_m = controller.update(limiter.limit(target_n(ms), now_us), sensed_n, now_us)
        sensed_n = meddle(ms, device, device.exchange(displacement_m, now_us).force_n)
        rows.append((device.contact_force_n, sensed_n, displacement_m))
    contact_n, sensed, displacement = np.array(rows).T
    return Trace(contact_n, sensed, displacement)


def step_trace(stiffness_n_m: float, *, seed: int, lag_s: float = 0.03) -> Trace:
    """0.4 to 2 N, at a moment that lies elsewhere in the servo frame for each seed."""
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m), servo=Servo(lag_s=lag_s))
    at_ms = STEP_MS + 3 * seed
    trace = play(lambda ms: 0.4 if ms < at_ms else 2.0, at_ms + 2_000, settings=settings, seed=seed)
    return Trace(trace.contact_n[at_ms:], trace.sensed_n[at_ms:], trace.displacement_m[at_ms:])


@pytest.mark.parametrize("seed", range(8))
def test_a_step_on_the_typical_finger_is_fast_and_steady(seed: int) -> None:
    trace = step_trace(1000.0, seed=seed)
    # What the controller sees: readings averaged over its own period.
    sensed_n = np.convolve(np.concatenate([np.full(9, trace.sensed_n[0]), trace.sensed_n]), np.full(10, 0.1), "valid")
    for force_n in (sensed_n, trace.contact_n):
        rise_ms = int(np.argmax(force_n >= 1.84)) - int(np.argmax(force_n >= 0.56))
        outside = np.flatnonzero(np.abs(force_n - 2.0) > 0.05 * 1.6)
        assert 50 < rise_ms <= 200
        assert force_n.max() <= 2.0 + 0.05 * 1.6
        assert outside[-1] < 350
    assert abs(sensed_n[-1_000:].mean() - 2.0) <= 0.05
    assert abs(trace.contact_n[-1_000:].mean() - 2.0) <= 0.05
    assert np.ptp(trace.contact_n[-1_000:]) <= 0.05


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("lag_s", [0.02, 0.03, 0.04])
def test_a_step_overshoots_little_on_any_finger(stiffness_n_m: float, lag_s: float) -> None:
    trace = step_trace(stiffness_n_m, seed=1, lag_s=lag_s)
    assert trace.contact_n.max() <= 2.0 + 0.15 * 1.6
    # The deadband may have doubled twice.
    assert abs(trace.sensed_n[-500:].mean() - 2.0) <= 4.0 * ForceControlSettings().deadband_n


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_at_constant_target_the_loop_comes_to_rest(stiffness_n_m: float) -> None:
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    for seed, target_n in enumerate((0.3, 1.0, 2.0, 3.5)):
        trace = play(lambda _, n=target_n: n, 20_000, settings=settings, seed=seed)
        moved = np.ptp(trace.contact_n[8_000:].reshape(12, 1_000), axis=1) > 0.02
        assert moved.sum() <= 4, f"still moving in {moved.sum()} of 12 s at {target_n} N"


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_no_target_brings_more_than_the_device_limit(stiffness_n_m: float) -> None:
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    targets = (5.0, 0.0, 5.0, 2.0, 50.0, 0.3, 5.0)
    trace = play(lambda ms: targets[ms // 1_500], 1_500 * len(targets), settings=settings)
    assert 4.0 < trace.contact_n.max() <= 5.0


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_below_the_threshold_the_finger_is_let_go_and_found_again(stiffness_n_m: float) -> None:
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    trace = play(lambda ms: 0.1 if 2_500 <= ms < 5_000 else 2.0, 7_000, settings=settings)
    assert trace.contact_n[2_800:5_000].max() < 0.1
    assert len(set(trace.displacement_m[3_000:5_000])) == 1
    assert trace.contact_n[-1] == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("stuck_n", [0.0, 20.0, math.nan])
@pytest.mark.parametrize("from_ms", [0, 3_000])
def test_a_stuck_sensor_never_brings_more_than_the_device_limit(
    stiffness_n_m: float, stuck_n: float, from_ms: int
) -> None:
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    trace = play(
        lambda _: 5.0, 8_000, settings=settings, meddle=lambda ms, _, sensed_n: sensed_n if ms < from_ms else stuck_n
    )
    assert trace.contact_n.max() <= 5.0
    if stuck_n != 0.0:
        assert trace.contact_n[from_ms + 400 :].max() == 0.0


def test_a_sensor_stuck_in_between_is_bounded_by_the_travel() -> None:
    trace = play(lambda _: 3.0, 8_000, meddle=lambda ms, _, sensed_n: sensed_n if ms < 3_000 else 1.0)
    assert trace.displacement_m.max() == ForceControlSettings().travel_m


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_a_withdrawn_finger_is_not_chased_and_its_return_is_no_blow(stiffness_n_m: float) -> None:
    finger = Finger(stiffness_n_m=stiffness_n_m)

    def withdraw(ms: int, device: SimulatedDevice, sensed_n: float) -> float:
        if ms == 3_000:
            device.plant.exchange_finger(Finger(stiffness_n_m=stiffness_n_m, contact_m=0.02))
        if ms == 5_000:
            device.plant.exchange_finger(finger)
        return sensed_n

    trace = play(lambda _: 2.0, 8_000, settings=PlantSettings(finger=finger), meddle=withdraw)
    touch_m = np.flatnonzero(trace.sensed_n > 0)[0]
    assert trace.displacement_m[4_000:5_000].max() <= trace.displacement_m[touch_m] + 0.001
    assert trace.contact_n[5_000:].max() < 5.0
    assert trace.contact_n[-1] == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("hertz", [0.5, 1.0, 3.0])
def test_a_sine_target_stays_within_the_limit(hertz: float) -> None:
    for stiffness_n_m in FINGERS_N_M:
        settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
        trace = play(lambda ms: 2.5 + 2.5 * math.sin(2e-3 * math.pi * hertz * ms), 4_000, settings=settings)
        assert trace.contact_n.max() <= 5.0


def test_the_same_seed_gives_the_same_run() -> None:
    runs = [play(lambda ms: 1.0 + ms / 2_000, 2_000, seed=seed) for seed in (3, 3, 4)]
    assert np.array_equal(runs[0].sensed_n, runs[1].sensed_n)
    assert np.array_equal(runs[0].displacement_m, runs[1].displacement_m)
    assert not np.array_equal(runs[0].sensed_n, runs[2].sensed_n)
