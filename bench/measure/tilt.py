"""Would it help to tilt the platform of the fingertip device along the force? What it does to direction and strength.

Three servos lift the corners of the platform: their mean presses, their differences tilt. Here the true force of a
palpation on three axes is played twice, with and without tilt, through the servos of the simulated device (lag, speed,
deadband, backlash, frames of 20 ms). To be told what the parts can do, and no more, the finger is known, targets come
30 ms early, which is the lag of the servos, and nothing slips: the force acts along the normal of the platform.
"""

import argparse
import itertools
import math
import statistics
from typing import Any, Final

import numpy as np
import record

from hapticnet.arrays import FloatArray
from hapticnet.device.kinematics import Linkage, Pulses
from hapticnet.device.parts import Finger, Servo
from hapticnet.device.servos import Servos
from hapticnet.experiment.scene_force import scene_trial
from hapticnet.experiment.trial import Trial
from hapticnet.hardware import CONTACT_M, MAX_FORCE_N
from hapticnet.operator.palpation import PalpatingOperator, PalpationSettings
from hapticnet.scene.presets import find_scene
from hapticnet.scene.sources import make_scene

Row = dict[str, Any]

CORNER_M: Final = 0.015
"""Distance [m] of the corners from the centre of the platform. An assumption: a finger is about as wide."""

CORNERS: Final = tuple((math.cos(angle), math.sin(angle)) for angle in (0.0, 2.0 * math.pi / 3.0, -2.0 * math.pi / 3.0))
CONTACTS_M: Final = (CONTACT_M, 0.007)
"""Where the finger is [m above retracted]: as the device is described, and in the middle of the travel."""

LEAD_S: Final = 0.03
LARGEST_SLOPE: Final = math.tan(math.radians(35.0))
FELT_N: Final = 0.5
"""Force [N] from which its direction counts."""

FINGERS_N_M: Final = (300.0, 1000.0, 3000.0)
TICK_US: Final = 1000


def measure(arguments: argparse.Namespace) -> Row:
    """Return what becomes of direction and strength, with and without tilt, in the mean over the hands."""
    trials = []
    for seed in range(arguments.seed, arguments.seed + arguments.seeds):
        hand = PalpatingOperator(PalpationSettings(palpations=2), np.random.default_rng(seed))
        trials.append(scene_trial(make_scene(find_scene("phantom")), hand, name=f"phantom {seed}"))
    rows = []
    for contact_m, stiffness_n_m, tilts in itertools.product(CONTACTS_M, FINGERS_N_M, (False, True)):
        finger = Finger(stiffness_n_m=stiffness_n_m, contact_m=contact_m)
        found = [played(trial, finger, tilts) for trial in trials]
        means = {key: statistics.fmean(row[key] for row in found) for key in found[0]}
        rows.append({"contact_m": contact_m, "stiffness_n_m": stiffness_n_m, "tilts": tilts, **means})
    return {"corner_m": CORNER_M, "lead_s": LEAD_S, "felt_n": FELT_N, "rows": rows}


def played(trial: Trial, finger: Finger, tilts: bool) -> dict[str, float]:
    """Return errors of the force that the platform exerts."""
    true = trial.stimuli
    strength = np.minimum(np.linalg.norm(true, axis=1), MAX_FORCE_N)
    targets = ahead(np.column_stack([depths_m(strength, finger), slopes(true) if tilts else np.zeros((len(true), 2))]))
    heights = moved(targets, tilts)
    mean_m = heights.mean(axis=1)
    force_n = np.array([finger.force_n(each_m) for each_m in mean_m.tolist()])
    felt = force_n[:, np.newaxis] * normals(heights)
    pressed = strength > FELT_N
    cosine = np.sum(normals(heights) * true, axis=1)[pressed] / np.linalg.norm(true[pressed], axis=1)
    angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return {
        "angle_median_deg": float(np.median(angles)),
        "angle_p95_deg": float(np.percentile(angles, 95.0)),
        "strength_rmse_n": float(np.sqrt(np.mean((force_n - strength) ** 2))),
        "vector_rmse_n": float(np.sqrt(np.mean(np.sum((felt - true) ** 2, axis=1)))),
    }


def depths_m(strength_n: FloatArray, finger: Finger) -> FloatArray:
    """Return the heights [m] of the platform at which a finger is pressed so strongly; below it without a force."""
    heights_m = np.linspace(0.0, Linkage().travel_m, 4000)
    forces_n = np.array([finger.force_n(height_m) for height_m in heights_m.tolist()])
    found: FloatArray = np.interp(strength_n, forces_n[forces_n > 0.0], heights_m[forces_n > 0.0])
    return np.where(strength_n > 0.0, found, finger.contact_m - 0.5e-3)


def slopes(true: FloatArray) -> FloatArray:
    """Return the slopes of the platform along the second and third axis, shape (n, 2); level without a force."""
    ahead_n = np.maximum(true[:, :1], 1e-3)
    steep = true[:, 1:] / ahead_n * (np.linalg.norm(true, axis=1, keepdims=True) > 0.05)
    limited: FloatArray = np.clip(steep, -LARGEST_SLOPE, LARGEST_SLOPE)
    return limited


def ahead(targets: FloatArray) -> FloatArray:
    """Return targets as they will be after the lead."""
    samples = round(LEAD_S * 1e6 / TICK_US)
    return np.concatenate([targets[samples:], np.repeat(targets[-1:], samples, axis=0)])


def moved(targets: FloatArray, tilts: bool) -> FloatArray:
    """Return the heights [m] of the corners, shape (n, 3), for heights and slopes of the platform, shape (n, 3)."""
    linkage, servo = Linkage(), Servo()
    corners = [Servos(linkage, servo) for _ in CORNERS]  # each shows one servo, because all three get the same pulse
    heights = np.empty((len(targets), 3))
    held: Pulses = corners[0].taken_us
    for index, (height_m, *steep) in enumerate(targets.tolist()):
        if index * TICK_US % servo.frame_us == 0:
            if tilts:
                lifts_m = [CORNER_M * (y * steep[0] + z * steep[1]) for y, z in CORNERS]
                # No corner leaves the travel: the others would then press the finger.
                low, high = height_m / max(-min(lifts_m), 1e-9), (linkage.travel_m - height_m) / max(*lifts_m, 1e-9)
                lifted = [height_m + min(1.0, low, high) * lift_m for lift_m in lifts_m]
                one, two, three = (round(2.0 * linkage.pulse_us(each_m)) / 2.0 for each_m in lifted)
                held = (one, two, three)
            else:
                held = linkage.pulses_us(height_m, held)
            for corner, pulse_us in zip(corners, held, strict=True):
                corner.take((pulse_us,) * 3)
        for place, corner in enumerate(corners):
            corner.move(TICK_US)
            heights[index, place] = corner.displacement_m
    return heights


def normals(heights: FloatArray) -> FloatArray:
    """Return the unit normals of the platform, shape (n, 3), for the heights of its corners [m]."""
    away = heights - heights.mean(axis=1, keepdims=True)
    slope = away @ np.array(CORNERS) * (2.0 / 3.0 / CORNER_M)
    normal = np.column_stack([np.ones(len(heights)), slope])
    unit: FloatArray = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return unit


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1), default=3, help="how many hands")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
