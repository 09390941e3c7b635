"""Test signals for codecs, from zero to far above any hand's force, and a check that both halves agree."""

import copy
import copyreg
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Decoder, Encoder
from hapticnet.codec.registry import every_codec
from hapticnet.experiment.trials import Trial
from hapticnet.perception import WeberLaw

PERIOD_US = 1000
SLOPES_N_PER_S = tuple(10.0**exponent for exponent in range(-9, 10))
SETTLING_SAMPLES = 32

copyreg.pickle(struct.Struct, lambda form: (struct.Struct, (form.format,)))  # so that codecs can be copied


def force_codecs() -> dict[str, type[Any]]:
    """Return the codecs that reproduce any force, by name; bench/measure/stability.py measures the others."""
    return {name: codec for name, codec in every_codec().items() if not getattr(codec, "renders_model", False)}


def trials(samples: int, rng: np.random.Generator) -> list[Trial]:
    """Return one-axis recordings of about `samples` samples; variants of one signal share its name."""
    ms = np.arange(samples)
    clock = PERIOD_US * ms
    hand = hand_force(samples, rng)
    noise = rng.normal(size=samples)
    spikes = hand.copy()
    spikes[50::97] += 1e5 * rng.choice([-1.0, 1.0], len(spikes[50::97]))
    # 20 N/s up for 150 ms, then a drop in one sample; and a rise to 4 N within two samples, then constant.
    breaches = 0.02 * (ms % 150) + np.where(ms % 300 < 150, 1.0, 0.3)
    wall = np.clip(2.0 * (ms % 200 - 100), 0.0, 4.0)
    gaps_us = np.where(rng.random(samples) < 0.02, 300_000.0, rng.exponential(1500.0, samples))
    kept = rng.random(samples) > 0.3
    jumps_us = np.where(rng.random(samples) < 0.01, rng.integers(-(2**40), 2**40, samples), PERIOD_US)
    plain = {
        "zero": np.zeros(samples),
        "constant": np.full(samples, 1.7),
        "noise of 1e-12 N": 1e-12 * noise,
        "noise of 1e-6 N": 1e-6 * noise,
        "noise of 20 mN": 0.02 * noise,
        "sign changes": np.where(ms % 2, -1.0, 1.0) * (1.0 + ms / samples),
        "steps": rng.uniform(-5.0, 5.0, samples // 40 + 1)[ms // 40],
        "spikes of 1e5 N": spikes,
        "breaches": breaches,
        "wall": wall,
        "any float": rng.choice([-1.0, 1.0], samples) * 10.0 ** rng.uniform(-12.0, 15.0, samples),
        "hand": hand,
        "hand x 1e-12": 1e-12 * hand,
        "hand x 1e12": 1e12 * hand,
    }
    timed = {
        "repeated times": (np.repeat(clock[: samples // 3 + 1], 3)[:samples], hand),
        "constant time": (np.zeros(samples, dtype=np.int64), hand),
        "irregular times": (np.cumsum(gaps_us.astype(np.int64)), hand),
        "missing samples": (clock[kept], hand[kept]),
        "time jumps": (np.cumsum(jumps_us.astype(np.int64)), hand),
    }
    # There and back, on both sides of zero.
    triangle = np.interp(ms / samples, [0.0, 0.25, 0.75, 1.0], [0.0, 0.25, -0.25, 0.0]) * samples / 1000.0
    return [
        *(_trial(name, clock, stimuli) for name, stimuli in plain.items()),
        *(_trial(name, t_us, stimuli) for name, (t_us, stimuli) in timed.items()),
        *(_trial("ramps 1e-9..1e9 N/s", clock, slope * triangle) for slope in SLOPES_N_PER_S),
    ]


def hand_force(samples: int, rng: np.random.Generator) -> FloatArray:
    """Return a force that wanders between 0 and 4 N like a hand's, with a little noise."""
    seconds = np.arange(samples) / 1000.0
    one, other = rng.uniform(0.0, 6.0, 2)
    force: FloatArray = 2.0 + np.sin(3.0 * seconds + one) + np.sin(7.1 * seconds + other)
    return force + rng.normal(0.0, 0.003, samples)


def _trial(name: str, t_us: npt.NDArray[np.int64], stimuli: FloatArray) -> Trial:
    # A hand that moves by 20 mm and back twice a second, at up to 126 mm/s.
    positions = 0.01 * np.sin(4.0 * np.pi * np.arange(len(stimuli)) / 1000.0)
    return Trial(name=name, t_us=t_us, stimuli=stimuli[:, np.newaxis], positions=positions[:, np.newaxis])


def in_step(encoder: Encoder, decoder: Decoder, law: WeberLaw, t_us: int, x: float) -> bool:
    """Return whether the encoder's dead zone is centred, to the bit, on the value that the decoder applies.

    An encoder that assumes a different value does not send the first number beyond one of the two ends. The check
    holds for every codec with the deadband's rule once the hand rests, because rate limits and repetitions end while
    the stimulus is constant. Encoder and decoder are copied, not changed.

    Parameters
    ----------
    t_us, x
        Time [µs] and value [N] of the last stimulus, of one axis.
    """
    encoder, decoder = copy.deepcopy((encoder, decoder))
    for _ in range(SETTLING_SAMPLES):
        t_us += PERIOD_US
        payload = encoder.encode(t_us, (x,))
        if payload is not None:
            decoder.decode(t_us, payload)
    t_us += PERIOD_US
    (applied,) = decoder.reconstruct(t_us)
    threshold = law.threshold_n(abs(applied))
    for side in (-1.0, 1.0):
        outside = applied + side * (2.0 * threshold + 1e-9)
        end = farthest(lambda x: abs(x - applied) <= threshold, applied, outside)
        if copy.deepcopy(encoder).encode(t_us, (math.nextafter(end, outside),)) is None:
            return False
    return True


def farthest(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the last number from `inside` towards `outside` for which `holds` is true."""
    while (middle := 0.5 * (inside + outside)) not in (inside, outside):
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return inside
