"""The C twins of the codecs' whole-array encoders (`peers`), compiled for this machine and called from Python."""

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticnet.codec.schemes.adaptive_predictive import AdaptivePredictive
from hapticnet.codec.schemes.level_crossing import LevelCrossing
from hapticnet.codec.schemes.linear_predictive import LinearPredictive
from hapticnet.codec.schemes.merging import Merging
from hapticnet.codec.schemes.passive import PassiveInterpolative
from hapticnet.codec.schemes.probabilistic import Probabilistic
from hapticnet.codec.schemes.velocity_adaptive import VelocityAdaptive
from hapticnet.perception import WeberLaw

Array = npt.NDArray[np.float64]
Loop = Callable[[Array], int]

PEERS = Path(__file__).parents[1] / "peers"
LAW = WeberLaw()


def load_twins(folder: Path) -> dict[str, Loop]:
    """Return the C loops by codec, compiled for this machine; they allocate what they return, as ours do."""
    weber, floor = ctypes.c_double(LAW.weber_fraction), ctypes.c_double(LAW.floor_n)
    levels, edges = map(np.array, LevelCrossing().cells(axes=1))
    lines = LinearPredictive()

    def line(stimuli: Array) -> tuple[Any, ...]:
        slope_samples, horizon_us = ctypes.c_size_t(int(lines.slope_samples)), ctypes.c_double(lines.horizon_ms * 1e3)
        return times_us(len(stimuli)), weber, floor, slope_samples, horizon_us

    def moving(stimuli: Array) -> tuple[Any, ...]:
        codec = VelocityAdaptive()
        bounds = map(ctypes.c_double, (codec.speed_gain_s_m, codec.largest_fraction, codec.time_constant_ms * 1e-3))
        return times_us(len(stimuli)), hand_m(len(stimuli)), weber, floor, *bounds

    def merged(stimuli: Array) -> tuple[Any, ...]:
        return times_us(len(stimuli)), weber, floor, ctypes.c_int64(int(Merging().window_ms * 1e3))

    def ramps(stimuli: Array) -> tuple[Any, ...]:
        interval_us = ctypes.c_double(PassiveInterpolative().interval_ms * 1e3)
        return times_us(len(stimuli)), hand_m(len(stimuli)), weber, floor, interval_us

    def curves(stimuli: Array) -> tuple[Any, ...]:
        ours = AdaptivePredictive()
        bounds = ctypes.c_double(ours.horizon_ms * 1e3), ctypes.c_double(ours.window_ms * 1e3)
        return times_us(len(stimuli)), weber, floor, *bounds

    losing = Probabilistic()
    loss, limit = ctypes.c_double(losing.loss_probability), ctypes.c_double(losing.deviation_limit)
    between: dict[str, Callable[[Array], tuple[Any, ...]]] = {
        "deadband": lambda _: (weber, floor, ctypes.c_double(LAW.multiplier)),
        "level-crossing": lambda _: (weber, floor, levels, edges, ctypes.c_size_t(len(levels))),
        "adaptive-predictive": curves,
        "linear-predictive": line,
        "velocity-adaptive": moving,
        "merging": merged,
        "probabilistic": lambda _: (weber, floor, loss, limit),
        "passive-extrapolative": lambda stimuli: (hand_m(len(stimuli)), weber, floor),
        "passive-interpolative": ramps,
    }
    return {name: _loop(folder, name.replace("-", "_"), given) for name, given in between.items()}


def _loop(folder: Path, name: str, given: Callable[[Array], tuple[Any, ...]]) -> Loop:
    library = folder / f"{name}.so"
    command = ["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, PEERS / f"{name}.c"]
    subprocess.run(command, check=True)
    function = ctypes.CDLL(str(library))[name]
    function.restype = ctypes.c_size_t

    def run(stimuli: Array) -> int:
        decoded, sent = np.empty_like(stimuli), np.empty(len(stimuli), dtype=np.int64)
        parts = (stimuli, ctypes.c_size_t(len(stimuli)), *given(stimuli), decoded, sent)
        pointers = [p.ctypes.data_as(ctypes.c_void_p) if isinstance(p, np.ndarray) else p for p in parts]
        return int(function(*pointers))

    return run


@cache
def times_us(samples: int) -> npt.NDArray[np.int64]:
    """Return a sample each millisecond; made once, so that making them is not measured."""
    return np.arange(samples, dtype=np.int64) * 1000


@cache
def hand_m(samples: int) -> Array:
    """Return the position at each of them of a hand that comes and goes; made once as well."""
    position_m: Array = 0.02 * np.sin(np.arange(samples) * 0.002)
    return position_m
