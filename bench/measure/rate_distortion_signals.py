"""Signals for the codecs: the paper's scene, forces made from a seed, and recordings given on the command line.

Anyone can repeat the figures on made signals; each one poses one difficulty for codecs. Their amplitudes and
durations are assumptions, chosen to be typical. Positions increase inward; all are sampled at 1 kHz.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.errors import SettingsError
from hapticnet.experiment.trials import Trial
from hapticnet.recordings.loading import load_recording

Array = npt.NDArray[np.float64]
Made = Callable[[np.random.Generator, int], tuple[Array, Array]]

RATE_HZ: Final = 1000.0
SENSOR_NOISE_N: Final = 5e-3
TREMOR_M: Final = 50e-6
KINESTHETIC: Final = "stiff wall"


def made_signals(seed: int, seconds: float) -> list[Trial]:
    """Return every made signal, `seconds` long, each from its own branch of `seed`."""
    samples = round(seconds * RATE_HZ)
    t_us = np.arange(samples, dtype=np.int64) * round(1e6 / RATE_HZ)
    trials = []
    for (name, made), rng in zip(MADE.items(), np.random.default_rng(seed).spawn(len(MADE)), strict=True):
        force_n, position_m = (each.reshape(samples, -1) for each in made(rng, samples))
        trials.append(Trial(name=name, t_us=t_us, stimuli=force_n, positions=position_m))
    return trials


def recorded_signals(arguments: Sequence[str]) -> list[Trial]:
    """Return the recordings given as in `recorded_signal`; recordings with equal names get their whole paths."""
    trials = [recorded_signal(argument) for argument in dict.fromkeys(arguments)]
    names = [trial.name for trial in trials]
    return [
        trial if names.count(trial.name) == 1 else replace(trial, name=argument)
        for argument, trial in zip(dict.fromkeys(arguments), trials, strict=True)
    ]


def recorded_signal(argument: str) -> Trial:
    """Return a recording given as ``FILE[:FORCE[:POSITION[:SCALE]]]``; columns are separated by commas."""
    file, force, position, scale = (*argument.split(":"), "", "", "")[:4]
    path = Path(file)
    try:
        metres = float(scale) if scale else None
    except ValueError:
        raise SettingsError(f"{argument!r}: {scale!r} must be the metres in one unit of position") from None
    signal = load_recording(path, columns=force or None, position=position or None, position_scale=metres)
    return Trial(name=path.stem, t_us=signal.t_us, stimuli=signal.force, positions=signal.position)


def smooth_palpation(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return presses on an elastic body of 400 N/m, 2 to 10 mm deep, without any noise."""
    depth_m = presses(rng, samples, move_s=(0.4, 1.2), rest_s=(0.1, 0.5), depth_m=(2e-3, 10e-3))
    return 400.0 * depth_m, depth_m


def noisy_hold(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return 2 N held by a hand whose force wanders by a few per cent, with sensor noise."""
    wander_n = coloured(rng, samples, correlation_s=0.5, rms=0.1)
    position_m = 5e-3 + coloured(rng, samples, correlation_s=0.05, rms=TREMOR_M)
    return 2.0 + wander_n + rng.normal(0.0, 0.03, samples), position_m


def impacts(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return taps on something hard: a burst of decaying vibration, then a held force.

    The model is a decaying sinusoid in proportion to the speed of the tap: Okamura, Cutkosky and Dennerlein,
    "Reality-based models for vibration feedback in virtual environments" (2001); their parameters are not used.
    """
    force_n = rng.normal(0.0, SENSOR_NOISE_N, samples)
    position_m = np.zeros(samples)
    at = 0
    while at < samples:
        hit = min(at + round(RATE_HZ * rng.uniform(0.15, 0.5)), samples)
        position_m[at:hit] = -5e-3 * np.sin(np.linspace(0.0, np.pi, hit - at))
        end = min(hit + round(RATE_HZ * rng.uniform(0.05, 0.2)), samples)
        t_s = np.arange(end - hit) / RATE_HZ
        burst = rng.uniform(0.5, 3.0) * np.exp(-t_s / 0.02) * np.cos(2.0 * np.pi * rng.uniform(60.0, 200.0) * t_s)
        force_n[hit:end] += rng.uniform(0.5, 2.0) + burst
        position_m[hit:end] = force_n[hit:end] / 5000.0
        at = end
    return force_n, position_m


def free_motion(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return the reading of a sensor in free air: friction and inertia of the tool, around zero, with noise."""
    position_m = presses(rng, samples, move_s=(0.5, 1.5), rest_s=(0.1, 0.3), depth_m=(20e-3, 80e-3))
    inertia_n = 0.05 * np.gradient(np.gradient(position_m, 1.0 / RATE_HZ), 1.0 / RATE_HZ)
    return inertia_n + coloured(rng, samples, correlation_s=0.02, rms=0.05) + rng.normal(
        0.0, SENSOR_NOISE_N, samples
    ), position_m


def stiff_wall(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return an arm pressing a wall of 3 kN/m with up to about 25 N, most of the time in contact.

    The scale is typical of teleoperation with the whole arm, for which the reductions were published.
    """
    depth_m = presses(rng, samples, move_s=(0.3, 0.9), rest_s=(0.1, 0.4), depth_m=(2e-3, 8.5e-3))
    position_m = depth_m - 0.5e-3 + coloured(rng, samples, correlation_s=0.03, rms=TREMOR_M)
    return np.maximum(3000.0 * position_m, 0.0) + rng.normal(0.0, SENSOR_NOISE_N, samples), position_m


def turning_touch(rng: np.random.Generator, samples: int) -> tuple[Array, Array]:
    """Return presses on an elastic body by a tool that slides about and turns, with a sensor's noise, three axes."""
    depth_m = presses(rng, samples, move_s=(0.4, 1.2), rest_s=(0.1, 0.5), depth_m=(2e-3, 10e-3))
    tilt = np.stack([coloured(rng, samples, correlation_s=1.0, rms=0.3) for _ in range(2)], axis=1)
    normal = np.column_stack([tilt, np.ones(samples)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    force_n = 400.0 * depth_m[:, np.newaxis] * normal + rng.normal(0.0, SENSOR_NOISE_N, (samples, 3))
    return force_n, depth_m[:, np.newaxis] * normal


MADE: Final[dict[str, Made]] = {
    "smooth palpation": smooth_palpation,
    "noisy hold": noisy_hold,
    "impacts": impacts,
    "free motion": free_motion,
    KINESTHETIC: stiff_wall,
    "turning touch": turning_touch,
}


def presses(
    rng: np.random.Generator,
    samples: int,
    *,
    move_s: tuple[float, float],
    rest_s: tuple[float, float],
    depth_m: tuple[float, float],
) -> Array:
    """Return positions that move to random depths, three out of four times, or back to 0, and rest there.

    Each move has minimum jerk: Flash and Hogan, "The coordination of arm movements" (1985).
    """
    path_m = np.zeros(samples)
    at, here_m = 0, 0.0
    while at < samples:
        there_m = rng.uniform(*depth_m) if here_m == 0.0 or rng.random() < 0.75 else 0.0
        for seconds, to_m in ((rng.uniform(*move_s), there_m), (rng.uniform(*rest_s), there_m)):
            end = min(at + round(seconds * RATE_HZ), samples)
            s = np.arange(1, end - at + 1) / (seconds * RATE_HZ)
            path_m[at:end] = here_m + (to_m - here_m) * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
            at, here_m = end, to_m
    return path_m


def coloured(rng: np.random.Generator, samples: int, *, correlation_s: float, rms: float) -> Array:
    """Return noise of the first order, whose autocorrelation falls by a factor e in `correlation_s`."""
    keep = float(np.exp(-1.0 / (correlation_s * RATE_HZ)))
    value, values = 0.0, np.empty(samples)
    for index, draw in enumerate(rng.normal(0.0, rms * np.sqrt(1.0 - keep * keep), samples).tolist()):
        values[index] = value = keep * value + draw
    return values
