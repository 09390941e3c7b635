"""Speed and error of the force loop: step responses, control rates, stability and the largest force.

The device is simulated, in Python or (``--device simavr``) as the compiled firmware in lockstep. All of it runs in
virtual time; only the processor time of the control rates depends on the machine. The control rates show the speed
that averaging more readings costs and the error it avoids. Stability is in force_edge.py, the largest force in
force_scenarios.py.
"""

import argparse
import math
import os
import statistics
import time
from dataclasses import asdict

import numpy as np
import record
from force_edge import edge_rows
from force_scenarios import FROM_N, SEED_SHIFT_US, TICK_US, TO_N, Row, largest_rows, started

from hapticnet.control.finger import compressed
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.base import Device, Reading
from hapticnet.device.servos import ROUNDING, Linkage
from hapticnet.device.simulated import Finger, PlantSettings
from hapticnet.experiment.step_response import averaged, step_figures
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.procedures import StepTest

FINGERS_N_M = (300.0, 600.0, 1000.0, 2000.0, 3000.0)
RATES_HZ = (25, 50, 100, 200, 500)
USUAL_HZ = 1_000_000 // ForceControlSettings().period_us
DELAYS_MS = (0, 10, 20, 40)
LOSS = 0.3


def step_response(kind: str, stiffness_n_m: float, seed: int, control: ForceControlSettings) -> Row:
    """Return time, target, sensed force as the loop averages it, and true force of one step; and its figures."""
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    with started(kind, settings, seed) as (device, now_us):
        fingertip = Fingertip(device, control)
        test = StepTest(fingertip, from_n=FROM_N, to_n=TO_N, before_us=2_500_000 + SEED_SHIFT_US * seed)
        while not test.tick(now_us):
            now_us += TICK_US
    assert test.step_us is not None
    columns = test.recording.table()
    columns["sensed_n"] = averaged(columns["sensed_n"], control.period_us // TICK_US)
    t_s = (columns["t_us"] - test.step_us) * 1e-6
    figures = {
        force: asdict(step_figures(t_s, columns[f"{force}_n"], at_s=0.0, from_n=FROM_N, to_n=TO_N))
        for force in ("sensed", "true")
    }
    return {"t_s": t_s, "columns": columns, "figures": figures}


def summary(figures: list[Row]) -> Row:
    """Return median and worst of each figure, errors without their sign; None where it was never reached."""
    row: Row = {}
    for name in figures[0]:
        values = [math.inf if each[name] is None else abs(each[name]) for each in figures]
        both = {"median": statistics.median(values), "worst": max(values)}
        row[name] = {key: None if value == math.inf else value for key, value in both.items()}
    return row


def step_rows(kind: str, fingers_n_m: tuple[float, ...], seeds: range, control: ForceControlSettings) -> list[Row]:
    """Return the figures of the step on each finger, over all seeds, and the trace of the first."""
    rows = []
    for stiffness_n_m in fingers_n_m:
        runs = [step_response(kind, stiffness_n_m, seed, control) for seed in seeds]
        shown = slice(*np.searchsorted(runs[0]["t_s"], (-0.1, 0.7)), 2)
        columns = {"t_s": runs[0]["t_s"], **{name: runs[0]["columns"][name] for name in ("sensed_n", "true_n")}}
        rows.append(
            {
                "stiffness_n_m": stiffness_n_m,
                "sensed": summary([run["figures"]["sensed"] for run in runs]),
                "true": summary([run["figures"]["true"] for run in runs]),
                **coarseness(stiffness_n_m, control),
                "trace": {name: np.round(column[shown], 4).tolist() for name, column in columns.items()},
            }
        )
    return rows


def coarseness(stiffness_n_m: float, control: ForceControlSettings) -> Row:
    """Return how coarse the servos' deadband makes the force at the end of the step.

    One servo moves by a deadband, or not at all; it stays where it is if less than `ROUNDING` of that is missing.
    """
    linkage, finger = Linkage(), Finger(stiffness_n_m=stiffness_n_m)
    stood_m = finger.contact_m + compressed(TO_N) / stiffness_n_m
    pulse_us = linkage.pulse_us(stood_m)
    moved_m = (linkage.displacement_m(pulse_us + linkage.deadband_us) - stood_m) / 3.0
    step_n = finger.force_n(stood_m + 0.5 * moved_m) - finger.force_n(stood_m - 0.5 * moved_m)
    rest_n = max(control.deadband_n, control.deadband_fraction * TO_N)
    return {"servo_step_m": moved_m, "servo_step_n": step_n, "steady_bound_n": max(ROUNDING * step_n, rest_n)}


class Replayed(Device):
    """A device that replays the readings of another."""

    def __init__(self, device: Device, readings: list[Reading | None]) -> None:
        self.capabilities = device.capabilities
        self.description, self.status = device.description, device.status
        self._next = iter(readings).__next__

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:  # noqa: ARG002
        return self._next()


def processor_us(kind: str, control: ForceControlSettings, seed: int, repetitions: int) -> float:
    """Return processor time [µs] that a second of limits and force loop takes, without the device's share."""
    with started(kind, PlantSettings(), seed) as (device, start_us):
        readings: list[Reading | None] = []
        fingertip = Fingertip(device, control)
        targets = [(start_us + TICK_US * tick, FROM_N if tick < 2500 else TO_N) for tick in range(4500)]
        for now_us, target_n in targets:
            fingertip.press(target_n, now_us)
            readings.append(fingertip.reading)
    pressing_s, replaying_s = [], []
    for _ in range(repetitions):
        replayed = Replayed(device, readings)
        press = Fingertip(Replayed(device, readings), control).press
        for call, spent_s in ((replayed.exchange, replaying_s), (press, pressing_s)):
            begun_s = time.process_time()
            for now_us, target_n in targets:
                call(target_n, now_us)
            spent_s.append(time.process_time() - begun_s)
    return 1e6 * (min(pressing_s) - min(replaying_s)) / (1e-6 * TICK_US * len(targets))


def rate_rows(
    kind: str, rates_hz: tuple[int, ...], fingers_n_m: tuple[float, ...], seeds: range, repetitions: int
) -> list[Row]:
    """Return speed, error and processor time at each control rate."""
    rows = []
    for rate_hz in rates_hz:
        control = ForceControlSettings(period_us=1_000_000 // rate_hz)
        fingers = step_rows(kind, fingers_n_m, seeds, control)
        for finger in fingers:
            del finger["trace"]
        cpu_us = processor_us(kind, control, seeds[0], repetitions)
        rows.append({"rate_hz": rate_hz, "cpu_us_per_s": cpu_us, "fingers": fingers})
    usual_us = next(row["cpu_us_per_s"] for row in rows if row["rate_hz"] == USUAL_HZ)
    return [{**row, "cpu_ratio": row["cpu_us_per_s"] / usual_us} for row in rows]


def measure(arguments: argparse.Namespace) -> Row:
    """Return all results."""
    kind, quick = arguments.device, arguments.quick
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    if kind == "simavr" and hasattr(os, "sched_setaffinity"):
        # This process and the simulator take turns: on one core they wake each other without delay.
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    fingers_n_m = FINGERS_N_M[::2] if quick else FINGERS_N_M
    delays_ms = DELAYS_MS[::3] if quick else DELAYS_MS
    disturbances = [(delay_ms, 0.0) for delay_ms in delays_ms]
    if kind == "simavr":
        disturbances += [(0, LOSS), (delays_ms[-1], LOSS)]
    few = seeds if kind == "sim" else seeds[:2]
    return {
        "device": kind,
        "from_n": FROM_N,
        "to_n": TO_N,
        "step": step_rows(kind, fingers_n_m, seeds, ForceControlSettings()),
        "rates": rate_rows(kind, RATES_HZ[::2] if quick else RATES_HZ, fingers_n_m, seeds, 1 if quick else 7),
        "edges": edge_rows((1000.0,) if quick else (300.0, 1000.0), delays_ms, seeds[:1] if quick else seeds[:4]),
        "largest": largest_rows(kind, fingers_n_m, disturbances, few[:1] if quick else few[:4]),
    }


def main() -> None:
    parser = record.options(__doc__, seed=0)
    parser.add_argument("--device", choices=("sim", "simavr"), default="sim")
    parser.add_argument("--seeds", type=record.within(1), default=10, help="number of noises and step times")
    parser.add_argument("--quick", action="store_true", help="fewer fingers, rates and delays")
    unit = "as in each name; overshoot, loss and ratios are fractions, null was never reached"
    record.run(parser, measure, unit=unit)


if __name__ == "__main__":
    main()
