"""Whole recordings: the check at their door, and the choice between plain Python and compiled kernels."""

import importlib.util
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.codec.base import FloatArray
from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES

COMPILE_ABOVE_SAMPLES = 2_000_000
"""Recordings longer than this go to the compiled kernels where the ``fast`` extra is installed.

Loading a cached kernel costs about 0.6 s, in which plain Python encodes some ten million samples; compiling it for
the first time costs two to three times that.
"""

COMPILE_STREAM_ABOVE_SAMPLES = 300_000
"""The same for codecs that have no plain Python but the streaming pair's, which takes some 2 µs a sample."""

MARGIN: Final = 2.0**-50
"""By how much, of reference and threshold, a shortcut is narrower than its dead zone: more than they round."""


def as_recording(stimuli: FloatArray) -> FloatArray:
    """Return a recording as contiguous float64 of shape (n, a), refusing other shapes with a SampleError."""
    array = np.ascontiguousarray(stimuli, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2 or not 1 <= array.shape[1] <= MAX_AXES:
        raise SampleError(f"recording of shape {np.shape(stimuli)}; it must be (n,) or (n, 1 to {MAX_AXES})")
    return array


def refuse_out_of_range(stimuli: FloatArray, sent: npt.NDArray[np.int64]) -> None:
    """Refuse a recording in which a transmitted stimulus is not finite or out of range.

    Only transmitted ones are looked at: no dead zone contains NaN, infinity or a value that is out of range by more
    than a threshold, so that none of them can hide in silence.

    Raises
    ------
    SampleError
        Naming the first such sample.
    """
    chosen = stimuli[sent]
    good = (np.abs(chosen) <= LARGEST_COMPONENT).all(axis=1)
    if not good.all():
        first = int(sent[np.argmin(good)])
        raise SampleError(
            f"sample {first}: stimulus is {stimuli[first].tolist()}; it must be finite and within"
            f" ±{LARGEST_COMPONENT:g}"
        )


@cache
def fast_extra_installed() -> bool:
    """Tell whether the ``fast`` extra (numba) can be imported, without importing it."""
    return importlib.util.find_spec("numba") is not None


def worth_compiling(stimuli: FloatArray, *others: npt.NDArray[np.generic]) -> bool:
    """Tell whether a recording of one axis is long enough for a compiled kernel, and whether there can be one.

    There is none where the times or positions that belong to it are not as many.
    """
    samples = len(stimuli)
    fitting = stimuli.shape[1] == 1 and all(other.size == samples for other in others)
    return fitting and samples > COMPILE_STREAM_ABOVE_SAMPLES and fast_extra_installed()
