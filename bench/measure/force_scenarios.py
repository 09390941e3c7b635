"""What can happen to a finger on a simulated device while the force loop presses it, and the largest force on it."""

import contextlib
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.base import Reading
from hapticnet.device.simulated import Finger, PlantSettings, SimulatedDevice, loading_calibration
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.node.fingertip import Fingertip
from hapticnet.runtime.nano import Disturbance, SensorHook, SimulatedNano

FROM_N, TO_N = 0.4, 2.0
TICK_US = 1000
SEED_SHIFT_US = 3000
"""Delay [µs] of each seed's start, and of its step or event, to the previous seed's: elsewhere in the servo frame
and the control period."""

MAINS_HZ = 50.0

Row = dict[str, Any]


class LateDevice(SimulatedDevice):
    """A simulated device with delayed commands and a sensor that can be broken, like a `SimulatedNano`."""

    def __init__(self, settings: PlantSettings, rng: np.random.Generator, delay_ms: int) -> None:
        super().__init__(settings, rng)
        self.sensor: SensorHook | None = None
        self._under_way = deque([0.0] * delay_ms)
        self._newtons = loading_calibration(settings.sensor).force_n

    def exchange(self, displacement_m: float, now_us: int) -> Reading:
        self._under_way.append(displacement_m)
        reading = super().exchange(self._under_way.popleft(), now_us)
        if self.sensor is None:
            return reading
        counts = self.sensor(reading.adc, now_us)
        return reading._replace(adc=counts, force_n=self._newtons(counts))


Simulated: TypeAlias = LateDevice | SimulatedNano


@contextlib.contextmanager
def started(
    kind: str, settings: PlantSettings, seed: int, *, delay_ms: int = 0, loss: float = 0.0
) -> Iterator[tuple[Simulated, int]]:
    """Yield a device that gives readings, and the time [µs] to continue from."""
    with contextlib.ExitStack() as stack:
        rng = np.random.default_rng(seed)
        device: Simulated = (
            LateDevice(settings, rng, delay_ms)
            if kind == "sim"
            else stack.enter_context(
                contextlib.closing(
                    SimulatedNano(settings, rng, disturbance=Disturbance(delay_us=1000 * delay_ms, loss=loss))
                )
            )
        )
        now_us = 0
        while device.exchange(0.0, now_us) is None:
            now_us += TICK_US
        yield device, now_us + TICK_US + SEED_SHIFT_US * seed


Event: TypeAlias = tuple[float, Callable[[Simulated, Finger], None]]


@dataclass(frozen=True, slots=True)
class Scenario:
    """A target over time [s], how long it is followed [s], and what happens meanwhile."""

    target_n: Callable[[float], float]
    seconds: int
    events: tuple[Event, ...] = ()


def sine(hertz: float) -> Scenario:
    """Six seconds between 0 and 5 N, then the middle."""
    return Scenario(lambda s: 2.5 + (2.5 * math.sin(2.0 * math.pi * hertz * s) if s < 6.0 else 0.0), 10)


def put(**changes: float) -> Callable[[Simulated, Finger], None]:
    """Return an event: the finger is replaced by one that differs by these factors."""

    def happen(device: Simulated, finger: Finger) -> None:
        scaled = {name: factor * getattr(finger, name) for name, factor in changes.items()}
        device.plant.exchange_finger(replace(finger, **scaled))

    return happen


def broken(hook: SensorHook) -> Callable[[Simulated, Finger], None]:
    """Return an event: the sensor breaks."""

    def happen(device: Simulated, _: Finger) -> None:
        place = device.board if isinstance(device, SimulatedNano) else device
        place.sensor = hook

    return happen


def freeze(device: Simulated, finger: Finger) -> None:
    """Freeze the sensor at its present reading."""
    kept: list[float] = []

    def hook(counts: float, _: int) -> float:
        kept.append(counts)
        return kept[0]

    broken(hook)(device, finger)


def hum(_: float, now_us: int) -> float:
    """Return the reading of an open input [counts]: mains hum."""
    return 400.0 + 300.0 * math.sin(2e-6 * math.pi * MAINS_HZ * now_us)


SCENARIOS = {
    "step 0.4 to 5 N": Scenario(lambda s: FROM_N if s < 2.5 else 5.0, 8),
    "ramp of 1 N/s to 5 N": Scenario(lambda s: min(s, 5.0), 9),
    "sine 0.5 Hz": sine(0.5),
    "sine 1 Hz": sine(1.0),
    "sine 3 Hz": sine(3.0),
    "withdrawn and back": Scenario(lambda _: 2.0, 10, ((3.0, put(contact_m=10.0)), (5.0, put()))),
    "twice as stiff at 1.5 N": Scenario(lambda _: 1.5, 9, ((4.0, put(stiffness_n_m=2.0)),)),
    "twice as stiff at 2 N": Scenario(lambda _: 2.0, 9, ((4.0, put(stiffness_n_m=2.0)),)),
    "sensor at 0 from the start": Scenario(lambda _: 5.0, 7, ((0.0, broken(lambda *_: 0.0)),)),
    "sensor at 0 while pressing": Scenario(lambda _: 5.0, 8, ((3.0, broken(lambda *_: 0.0)),)),
    "sensor at full scale": Scenario(lambda _: 5.0, 8, ((3.0, broken(lambda *_: 1023.0)),)),
    "sensor frozen, 1 to 3 N": Scenario(lambda s: 1.0 if s < 3.5 else 3.0, 8, ((3.0, freeze),)),
    "sensor frozen, 3 to 5 N": Scenario(lambda s: 3.0 if s < 3.5 else 5.0, 8, ((3.0, freeze),)),
    "sensor falls to half its counts": Scenario(lambda _: 5.0, 8, ((3.0, broken(lambda counts, _: 0.5 * counts)),)),
    "input open, 50 Hz hum": Scenario(lambda _: 3.0, 8, ((3.0, broken(hum)),)),
}


def played(
    settings: PlantSettings,
    control: ForceControlSettings,
    target_n: Callable[[float], float],
    seconds: int,
    delay_ms: int,
    seed: int,
    *,
    kind: str = "sim",
    loss: float = 0.0,
    events: tuple[Event, ...] = (),
) -> tuple[np.ndarray, str | None]:
    """Return the true force [N] tick by tick, and the loop's reason to give up, if any."""
    true_n = np.empty(1000 * seconds)
    with started(kind, settings, seed, delay_ms=delay_ms, loss=loss) as (device, start_us):
        fingertip = Fingertip(device, control)
        fault = None
        # Events also move within the control period: a reading inside one is averaged with those before it.
        to_come = [(at_s + 1e-6 * SEED_SHIFT_US * seed, happen) for at_s, happen in events]
        for tick in range(len(true_n)):
            while to_come and tick >= 1000 * to_come[0][0]:
                to_come.pop(0)[1](device, settings.finger)
            fingertip.press(target_n(1e-3 * tick), start_us + TICK_US * tick)
            true_n[tick] = device.contact_force_n
            fault = fault or fingertip.controller.fault
    return true_n, fault


def at_rest(true_n: np.ndarray) -> bool:
    """Tell whether the force moved in at most one of the last three seconds: a servo takes a step now and then."""
    return int((np.ptp(true_n[-3000:].reshape(3, 1000), axis=1) > 0.02).sum()) <= 1


def largest_rows(
    kind: str, fingers_n_m: tuple[float, ...], disturbances: list[tuple[int, float]], seeds: range
) -> list[Row]:
    """Return the largest true force in each scenario, on each finger, with each delay and loss."""
    rows = []
    for name, scenario in SCENARIOS.items():
        for stiffness_n_m, (delay_ms, loss) in itertools.product(fingers_n_m, disturbances):
            settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
            runs = [
                played(
                    settings, ForceControlSettings(), scenario.target_n, scenario.seconds, delay_ms, seed,
                    kind=kind, loss=loss, events=scenario.events,
                )
                for seed in seeds
            ]  # fmt: skip
            rows.append(
                {
                    "scenario": name,
                    "stiffness_n_m": stiffness_n_m,
                    "delay_ms": delay_ms,
                    "loss": loss,
                    "max_n": max(float(true_n.max()) for true_n, _ in runs),
                    "above_limit_ms": max(int((true_n > MAX_FORCE_N).sum()) for true_n, _ in runs),
                    "at_rest": all(at_rest(true_n) for true_n, _ in runs),
                    "end_n": [round(float(true_n[-1]), 3) for true_n, _ in runs],
                    "faults": sorted({fault for _, fault in runs if fault}),
                }
            )
    return rows
