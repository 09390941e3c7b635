"""Forces, times, positions and codecs as users give them, checked and converted to hapticnet's own types."""

from collections.abc import Mapping
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, IntArray, as_recording
from hapticnet.checks import axes_of, check_parameter
from hapticnet.codec import registry
from hapticnet.codec.base import Codec
from hapticnet.codec.plugins import checked_class, rehearse
from hapticnet.errors import SampleError, SettingsError
from hapticnet.experiment.trials import Trial
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.recordings.loading import Recording

DEFAULT_RATE_HZ: Final = 1000.0

SHORTEST_PERIOD_US: Final = 10.0
LONGEST_PERIOD_US: Final = 5e5
"""Median sample period [µs] of plausible time stamps: 2 Hz to 100 kHz. Times in another unit fall outside."""

LARGEST_TIME_US: Final = 1e17  # largest time stamp [µs]; microseconds up to here are exact enough in float64
TIME_COLUMNS: Final = ("t", "t_s", "t_ms", "t_us", "time", "time_s", "timestamp")
"""Columns of a table that cannot be a force."""


ForceLike: TypeAlias = npt.ArrayLike | Recording
"""Forces [N], shape (n,) or (n, a) with 1 to 3 axes: list, array, pandas Series or DataFrame; or a recording."""


def read_trial(
    force: Any,
    *,
    rate_hz: float | None,
    t_s: npt.ArrayLike | None,
    t_us: npt.ArrayLike | None,
    position: npt.ArrayLike | None,
    name: str = "force",
) -> Trial:
    """Return a recording from a user's arguments.

    Raise SampleError if forces, positions or times are not finite numbers, differ in length or are implausible,
    SettingsError if more than one kind of times is given, or the rate is out of range.
    """
    if isinstance(force, Recording):
        if not (rate_hz is None and t_s is None and t_us is None and position is None):
            raise SettingsError(f"{name} is a recording with times and positions; omit rate_hz, t_s, t_us and position")
        return Trial(name=name, t_us=force.t_us, stimuli=force.force, positions=force.position)
    stimuli = as_forces(force, name)
    positions = None
    if position is not None:
        positions = as_forces(position, "position")
        check_shapes(positions, stimuli, "position", name)
    times_us = as_times_us(len(stimuli), rate_hz=rate_hz, t_s=t_s, t_us=t_us)
    return Trial(name=name, t_us=times_us, stimuli=stimuli, positions=positions)


def as_forces(values: Any, name: str) -> FloatArray:
    """Return numbers of shape (n,) or (n, a) as float64 of shape (n, a), n ≥ 1."""
    for column in getattr(values, "columns", ()):
        if str(column).lower() in TIME_COLUMNS:
            raise SampleError(f"{name} has a column {column!r}; select the columns of {name}, and give times by name")
    if values is None:
        raise SampleError(f"{name} is None; it must be real numbers")
    if np.ma.is_masked(values):
        raise SampleError(f"{name} has masked values; fill them or leave their samples out")
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise SampleError(f"{name} is not a table of numbers: {error}") from error
    if array.dtype == object and any(isinstance(each, str) for each in array.flat):
        array = array.astype(str)
    if array.dtype != object and not np.can_cast(array.dtype, np.float64, "same_kind"):
        raise SampleError(f"{name} is of type {array.dtype}; it must be real numbers")
    try:
        array = as_recording(array.astype(np.float64))
    except (TypeError, ValueError, OverflowError) as error:
        raise SampleError(f"{name} is not made of numbers: {error}") from error
    except SampleError as error:
        raise SampleError(f"{name}: {error}") from error
    if not len(array):
        raise SampleError(f"{name} is empty; it must have at least one sample")
    return array


def check_shapes(one: FloatArray, other: FloatArray, name: str, other_name: str) -> None:
    """Check that two recordings have the same shape; raise SampleError if not."""
    if one.shape != other.shape:
        raise SampleError(
            f"{name} has {len(one)} samples of {axes_of(one.shape[1])}, {other_name} {len(other)} of {other.shape[1]};"
            " they must match"
        )


def as_times_us(
    samples: int, *, rate_hz: float | None, t_s: npt.ArrayLike | None, t_us: npt.ArrayLike | None
) -> IntArray:
    """Return time stamps [µs], shape (n,), from at most one of rate, seconds and microseconds; else 1 kHz."""
    named = {"rate_hz": rate_hz, "t_s": t_s, "t_us": t_us}
    given = [name for name, value in named.items() if value is not None]
    if len(given) > 1:
        raise SettingsError(f"times are given as {' and '.join(given)}; give one of rate_hz, t_s and t_us")
    if not given or given == ["rate_hz"]:
        rate_hz = DEFAULT_RATE_HZ if rate_hz is None else rate_hz
        check_parameter("rate_hz", rate_hz, 1e-3, 1e6, "Hz")
        even: IntArray = np.rint(np.arange(samples) * (1e6 / rate_hz)).astype(np.int64)
        return even
    (name,) = given
    scale = 1e6 if name == "t_s" else 1.0
    unit = "s" if name == "t_s" else "µs"
    times = as_forces(named[name], name)
    if times.shape[1] != 1 or len(times) != samples:
        raise SampleError(f"{name} has {times.size} values for {samples} samples; the numbers must match")
    times = times[:, 0]
    bad = np.flatnonzero(~(np.abs(times) * scale <= LARGEST_TIME_US))
    if bad.size:
        raise SampleError(f"{name}[{bad[0]}] is {times[bad[0]]}; it must be finite and within ±1e11 s")
    gaps = np.diff(times)
    if (gaps < 0).any():
        at = int(np.argmax(gaps < 0)) + 1
        raise SampleError(f"{name}[{at}] is {times[at]:g} {unit}, before {name}[{at - 1}], {times[at - 1]:g} {unit}")
    if samples > 1:
        _check_period(name, unit, float(np.median(gaps)) * scale, float(np.median(gaps)))
    return np.rint(times * scale).astype(np.int64)


def _check_period(name: str, unit: str, period_us: float, period: float) -> None:
    if SHORTEST_PERIOD_US <= period_us <= LONGEST_PERIOD_US:
        return
    other, factor = ("t_us", 1e-6) if name == "t_s" else ("t_s", 1e6)
    guess = "give rate_hz if the sampling is even"
    if SHORTEST_PERIOD_US <= period_us * factor <= LONGEST_PERIOD_US:
        guess = f"if these are {'micro' if other == 't_us' else ''}seconds, pass them as {other}"
    elif SHORTEST_PERIOD_US <= period_us * factor**0.5 <= LONGEST_PERIOD_US:
        guess = "if these are milliseconds, pass t_s = milliseconds / 1000"
    raise SampleError(f"the median period of {name} is {period:g} {unit}; it must be between 10 µs and 0.5 s; {guess}")


def as_codec(
    codec: str | Codec,
    *,
    weber_fraction: float | None,
    floor_n: float | None,
    multiplier: float | None,
    parameters: Mapping[str, float],
) -> Codec:
    """Return a codec object from a name with parameters, ``FILE.py:Class``, ``package.module:Class`` or an object.

    Raise SettingsError if the codec or a parameter is unknown or out of range, given twice, or given for an object.
    """
    law = {"weber_fraction": weber_fraction, "floor_n": floor_n, "multiplier": multiplier}
    if not isinstance(codec, str):
        extra = [name for name, value in {**law, **parameters}.items() if value is not None]
        if extra:
            raise SettingsError(f"codec is an object with its own law and parameters; omit {', '.join(extra)}")
        if type(codec) not in registry.all_codecs().values():
            rehearse(codec, type(codec).__name__)
        return codec
    name, written = registry.parse_codec(codec)
    twice = sorted(written.keys() & parameters.keys())
    if twice:
        raise SettingsError(f"parameter {twice[0]!r} is given twice, in {codec!r} and by name")
    return registry.make_codec(
        name,
        WeberLaw(
            weber_fraction=PAPER_WEBER_FRACTION if weber_fraction is None else weber_fraction,
            floor_n=PAPER_FLOOR_N if floor_n is None else floor_n,
            multiplier=1.0 if multiplier is None else multiplier,
        ),
        {**written, **parameters},
    )


def serve_class(kind: type[Any]) -> None:
    """Register a codec's class, so that it can be asked for by name."""
    if kind not in registry.all_codecs().values():
        registry.register_codec(checked_class(kind, f"{kind.__module__}:{kind.__qualname__}"))
