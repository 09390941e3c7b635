"""The C twins of the codecs' whole-array encoders (`peers`), compiled for this machine and called from Python."""

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.linear_predictive import LinearPredictive
from hapticnet.codec.schemes.motion_predictive import MotionPredictive
from hapticnet.perception import WeberLaw
from hapticnet_literature.level_crossing import LevelCrossing
from hapticnet_literature.merging import Merging
from hapticnet_literature.passive import PassiveInterpolative
from hapticnet_literature.probabilistic import Probabilistic
from hapticnet_literature.velocity_adaptive import VelocityAdaptive

Array = npt.NDArray[np.float64]


class Encoded(NamedTuple):
    """Indices of the stimuli that were sent, and the stimulus applied at every sample."""

    sent: npt.NDArray[np.int64]
    decoded: Array


Loop = Callable[[Array], Encoded]

EXACT = ("adaptive-predictive", "motion-predictive")
"""Twins that send and apply what hapticnet does, to the bit."""

PEERS = Path(__file__).parents[1] / "peers"
LAW = WeberLaw()


def load_twins(folder: Path) -> dict[str, Loop]:
    """Return the C loops by codec, compiled for this machine; they allocate what they return, as ours do."""
    levels, edges = map(np.array, LevelCrossing().cells(axes=1))
    lines, curves, moving, losing = LinearPredictive(), AdaptivePredictive(), VelocityAdaptive(), Probabilistic()
    surfaces = MotionPredictive()
    settings: dict[str, tuple[float | Array, ...]] = {
        "deadband": (LAW.multiplier,),
        "level-crossing": (levels, edges, len(levels)),
        "adaptive-predictive": (curves.horizon_ms * 1e3, curves.window_ms * 1e3),
        "motion-predictive": (surfaces.horizon_ms * 1e3, surfaces.window_ms * 1e3, surfaces.stiffest_n_per_m),
        "linear-predictive": (int(lines.slope_samples), lines.horizon_ms * 1e3),
        "velocity-adaptive": (moving.speed_gain_s_m, moving.largest_fraction, moving.time_constant_ms * 1e-3),
        "merging": (int(Merging().window_ms * 1e3),),
        "probabilistic": (losing.loss_probability, losing.deviation_limit),
        "passive-extrapolative": (),
        "passive-interpolative": (PassiveInterpolative().interval_ms * 1e3,),
    }
    return {name: _loop(folder, name.replace("-", "_"), own) for name, own in settings.items()}


def _loop(folder: Path, name: str, settings: tuple[float | Array, ...]) -> Loop:
    library = folder / f"{name}.so"
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, PEERS / f"{name}.c"]
    subprocess.run(command, check=True)
    function = ctypes.CDLL(str(library))[name]
    function.restype = ctypes.c_size_t

    def run(stimuli: Array) -> Encoded:
        samples = len(stimuli)
        decoded, sent = np.empty_like(stimuli), np.empty(samples, dtype=np.int64)
        recording = stimuli, samples, times_us(samples), hand_m(samples), LAW.weber_fraction, LAW.floor_n
        count = function(*map(_argument, (*recording, *settings, decoded, sent)))
        return Encoded(sent[:count], decoded)

    return run


def _argument(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.ctypes.data_as(ctypes.c_void_p)
    return ctypes.c_size_t(value) if isinstance(value, int) else ctypes.c_double(value)


@cache
def times_us(samples: int) -> npt.NDArray[np.int64]:
    """Return a sample each millisecond; computed once, so that it is not measured."""
    return np.arange(samples, dtype=np.int64) * 1000


@cache
def hand_m(samples: int) -> Array:
    """Return the position of a moving hand at each sample; computed once as well."""
    position_m: Array = 0.02 * np.sin(np.arange(samples) * 0.002)
    return position_m
