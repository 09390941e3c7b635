"""Limits, force loop and simulated device in virtual time: what the finger feels."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from hapticnet.control.force_settings import ForceControlSettings, for_known_finger
from hapticnet.device.base import Reading
from hapticnet.device.servos import Servo
from hapticnet.device.simulated import Finger, PlantSettings, SimulatedDevice
from hapticnet.errors import UnavailableError
from hapticnet.experiment.step_response import step_figures
from hapticnet.node.fingertip import DeviceFound, DeviceLost, FingerMet, FingerNotMet, Fingertip
from hapticnet.node.loopback import Loopback
from hapticnet.node.procedures import StepTest, Tuning
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from tests.conftest import linked

FINGERS_N_M = (300.0, 600.0, 1000.0, 2000.0, 3000.0)


class Meddled(SimulatedDevice):
    """A device whose reading is spoiled, whose finger changes, or whose platform is told late, by a hook."""

    def __init__(self, settings: PlantSettings, seed: int, delay_ms: int = 0) -> None:
        super().__init__(settings, np.random.default_rng(seed))
        self.spoil: Callable[[int, float], float | None] = lambda _ms, force_n: force_n
        self._late = [0.0] * delay_ms

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        self._late.append(displacement_m)
        reading = super().exchange(self._late.pop(0), now_us)
        force_n = self.spoil(now_us // 1_000, reading.force_n)
        return None if force_n is None else reading._replace(force_n=force_n)


@dataclass
class Trace:
    """What one run gave, tick by tick."""

    contact_n: np.ndarray
    sensed_n: np.ndarray
    displacement_m: np.ndarray
    fingertip: Fingertip


def play(
    target_n: Callable[[int], float],
    milliseconds: int,
    *,
    settings: PlantSettings | None = None,
    seed: int = 0,
    delay_ms: int = 0,
    spoil: Callable[[int, float], float | None] | None = None,
    meddle: Callable[[int, Meddled], None] = lambda _ms, _device: None,
) -> Trace:
    device = Meddled(settings or PlantSettings(), seed, delay_ms)
    if spoil:
        device.spoil = spoil
    fingertip = Fingertip(device, ForceControlSettings())
    rows = []
    for ms in range(milliseconds):
        meddle(ms, device)
        fingertip.press(target_n(ms), ms * 1_000)
        rows.append((device.contact_force_n, fingertip.sensed_n, fingertip.displacement_m))
    contact_n, sensed, displacement = np.array(rows).T
    return Trace(contact_n, sensed, displacement, fingertip)


def at_rest(trace: np.ndarray, *, seconds: int) -> bool:
    """Tell whether the force hardly moved in the last seconds; a servo may take a step now and then."""
    moved = np.ptp(trace[-seconds * 1_000 :].reshape(seconds, 1_000), axis=1) > 0.02
    return bool(moved.sum() <= seconds // 3)


def stiffness(n_per_m: float, **servo: float) -> PlantSettings:
    return PlantSettings(finger=Finger(stiffness_n_m=n_per_m), servo=Servo(**servo))


def step(stiffness_n_m: float, seed: int, **servo: float) -> tuple[StepTest, SimulatedDevice, list[float]]:
    """0.4 to 2 N, at a moment that lies elsewhere in the servo frame for each seed."""
    device = SimulatedDevice(stiffness(stiffness_n_m, **servo), np.random.default_rng(seed))
    test = StepTest(
        Fingertip(device, ForceControlSettings()),
        from_n=0.4,
        to_n=2.0,
        before_us=2_500_000 + 3_000 * seed,
    )
    contact_n = []
    now_us = 0
    while not test.tick(now_us):
        now_us += 1_000
        contact_n.append(device.contact_force_n)
    return test, device, contact_n


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
def test_a_step_is_answered_fast_and_without_a_blow_on_any_finger(stiffness_n_m: float, seed: int) -> None:
    test, _, contact_n = step(stiffness_n_m, seed)
    assert test.step_us is not None
    t_s = np.arange(len(contact_n)) * 1e-3
    figures = step_figures(t_s, contact_n, at_s=test.step_us * 1e-6, from_n=contact_n[test.step_us // 1000], to_n=2.0)
    assert figures.rise_s is not None
    assert 0.03 < figures.rise_s <= 0.2
    assert figures.overshoot <= 0.05
    # One servo's deadband moves the mean of three by 0.056 mm: on a stiff finger more than 5 % of this step.
    coarseness_n = 0.53 * 0.056e-3 * 1.3 * stiffness_n_m
    assert abs(figures.steady_error_n) <= max(0.05, coarseness_n)
    assert figures.ripple_peak_to_peak_n <= 0.05
    if stiffness_n_m <= 1000.0:
        assert figures.settling_s is not None
        assert figures.settling_s <= 0.35


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("lag_s", [0.02, 0.04])
def test_servos_faster_or_slower_than_believed_do_little_harm(stiffness_n_m: float, lag_s: float) -> None:
    _, _, contact_n = step(stiffness_n_m, 1, lag_s=lag_s)
    assert max(contact_n) <= 2.0 + 0.15 * 1.6
    assert at_rest(np.array(contact_n), seconds=1)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("delay_ms", [0, 10, 20, 40])
def test_no_target_and_no_delay_bring_more_than_the_device_limit_or_a_limit_cycle(
    stiffness_n_m: float, delay_ms: int
) -> None:
    targets = (5.0, 0.0, 5.0, 2.0, 50.0, 0.3, 5.0, 5.0)
    trace = play(
        lambda ms: targets[ms // 1_500], 1_500 * len(targets), settings=stiffness(stiffness_n_m), delay_ms=delay_ms
    )
    assert 4.0 < trace.contact_n.max() <= 5.0
    assert at_rest(trace.contact_n, seconds=2)


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_a_withdrawn_finger_is_not_chased_and_its_return_is_no_blow(stiffness_n_m: float) -> None:
    finger = Finger(stiffness_n_m=stiffness_n_m)

    def withdraw(ms: int, device: Meddled) -> None:
        if ms == 3_000:
            device.plant.exchange_finger(replace(finger, contact_m=0.02))
        if ms == 5_000:
            device.plant.exchange_finger(finger)

    trace = play(lambda _: 2.0, 9_000, settings=PlantSettings(finger=finger), meddle=withdraw)
    pressed_m = trace.displacement_m[2_900]
    assert trace.displacement_m[3_500:5_000].max() <= pressed_m + ForceControlSettings().search_m
    assert trace.contact_n[5_000:].max() < 5.0
    assert trace.contact_n[-1] == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("stiffness_n_m", [300.0, 600.0, 1000.0, 1500.0])
@pytest.mark.parametrize("delay_ms", [0, 40])
def test_a_finger_that_turns_twice_as_stiff_is_let_go_of_within_servo_frames(
    stiffness_n_m: float, delay_ms: int
) -> None:
    def stiffen(ms: int, device: Meddled) -> None:
        if ms == 4_000:
            device.plant.exchange_finger(Finger(stiffness_n_m=2.0 * stiffness_n_m))

    trace = play(lambda _: 1.5, 9_000, settings=stiffness(stiffness_n_m), meddle=stiffen, delay_ms=delay_ms)
    struck_n = trace.contact_n[4_000]
    assert trace.contact_n.max() <= min(5.0, struck_n + 1e-9)
    assert (trace.contact_n[4_250 + delay_ms :]).max() < 2.3
    assert trace.contact_n[-1] == pytest.approx(1.5, abs=0.25)
    assert at_rest(trace.contact_n, seconds=2)


def test_a_lost_device_is_told_and_met_like_a_stranger_when_it_is_back() -> None:
    trace = play(lambda _: 2.0, 8_000, spoil=lambda ms, sensed_n: None if 3_000 <= ms < 4_000 else sensed_n)
    events = [trace.fingertip.next_event() for _ in range(4)]
    assert [type(event) for event in events] == [DeviceFound, DeviceLost, DeviceFound, type(None)]
    assert trace.displacement_m[3_050:4_000].max() == 0.0
    speeds = np.diff(trace.displacement_m[4_000:4_150:10])
    assert speeds.max() <= ForceControlSettings().approach_speed_m_s * 0.01 + 1e-12
    assert trace.contact_n[4_000:].max() <= 2.2
    assert trace.contact_n[-1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("stiffness_n_m", FINGERS_N_M)
@pytest.mark.parametrize("contact_m", [0.001, 0.006])
def test_tuning_finds_finger_and_stiffness_with_bounded_force(stiffness_n_m: float, contact_m: float) -> None:
    finger = Finger(stiffness_n_m=stiffness_n_m, contact_m=contact_m)
    device = SimulatedDevice(PlantSettings(finger=finger), np.random.default_rng(1))
    tuning = Tuning(Fingertip(device, ForceControlSettings(reach_m=device.capabilities.travel_m)))
    now_us, strongest_n = 0, 0.0
    while not tuning.tick(now_us):
        now_us += 1_000
        strongest_n = max(strongest_n, device.contact_force_n)
    tuned = tuning.result()
    assert tuned.stiffness_n_m == pytest.approx(stiffness_n_m, rel=0.15)
    assert tuned.contact_m == pytest.approx(contact_m, abs=2e-4)
    assert tuned.residual_m < 1e-4
    assert strongest_n < 2.3
    assert device.contact_force_n == 0.0
    known = for_known_finger(stiffness_n_m=tuned.stiffness_n_m, contact_m=tuned.contact_m)
    assert known.reach_m == pytest.approx(contact_m + 0.0011, abs=2e-4)
    assert known.finger.stiffness_n_m == tuned.stiffness_n_m


@pytest.mark.parametrize("lost_after_us", [-1_000_000, 100_000, 1_900_000])
def test_a_step_during_which_the_device_is_lost_gives_no_figures(lost_after_us: int) -> None:
    device = Meddled(stiffness(1000.0), 1)
    test = StepTest(Fingertip(device, ForceControlSettings()), from_n=0.4, to_n=2.0)
    lost_us = 2_500_000 + lost_after_us
    device.spoil = lambda ms, sensed_n: None if lost_us <= 1_000 * ms < lost_us + 20_000 else sensed_n
    with pytest.raises(UnavailableError, match=f"lost {lost_us / 1e6:.1f} s into the test"):
        any(test.tick(now_us) for now_us in range(0, 5_000_000, 1_000))


def both(finger: Finger, *, first_touch: bool = True) -> tuple[Loopback, SimulatedDevice]:
    """Return both nodes, and the device of the master."""
    operator = ScriptedOperator(InsertionSettings(insertions=1), np.random.default_rng(1))
    device = SimulatedDevice(PlantSettings(finger=finger), np.random.default_rng(1))
    return linked(operator, device=device, first_touch=first_touch), device


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_a_finger_is_met_before_the_session_with_little_more_than_a_newton(stiffness_n_m: float) -> None:
    loopback, device = both(Finger(stiffness_n_m=stiffness_n_m))
    master, largest_n, met = loopback.master, 0.0, None
    for _ in range(5_000):
        loopback.run(1_000)
        if master.connected:
            break
        largest_n = max(largest_n, device.contact_force_n)
        met = met or next((event for event in iter(master.next_event, None) if isinstance(event, FingerMet)), None)
    assert master.connected
    assert met is not None
    assert met.contact_m == pytest.approx(0.002, abs=0.0004)
    assert met.stiffness_n_m == pytest.approx(stiffness_n_m, rel=0.35)
    assert 0.8 <= largest_n <= 2.2  # the search meets a stiff finger with 2 N, as without a first touch
    assert device.contact_force_n == 0.0


def test_without_a_finger_the_session_comes_all_the_same() -> None:
    loopback, _ = both(Finger(contact_m=0.5))
    loopback.run(7_000_000)
    assert loopback.master.connected
    events = list(iter(loopback.master.next_event, None))
    assert any(isinstance(event, FingerNotMet) and "finger" in event.reason for event in events)


def test_a_master_that_is_closed_while_it_touches_ends() -> None:
    loopback, _ = both(Finger())
    loopback.run(300_000)
    assert not loopback.master.connected
    loopback.close()
    assert loopback.master.finished


def test_a_device_that_raises_while_it_touches_ends_the_session() -> None:
    loopback, device = both(Finger())

    def exchange(displacement_m: float, now_us: int) -> None:  # noqa: ARG001
        raise RuntimeError("torn off")

    device.exchange = exchange  # type: ignore[method-assign,assignment]
    loopback.run(100_000)
    assert loopback.master.failure is not None
    assert "torn off" in loopback.master.failure


def test_the_finger_is_found_only_on_request() -> None:
    loopback, device = both(Finger(), first_touch=False)
    loopback.run(200_000)
    assert loopback.master.connected
    assert device.contact_force_n == 0.0
