"""Whole recordings as arrays: their types, and the checks that every recording passes."""

import numpy as np
import numpy.typing as npt

from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def as_recording(stimuli: FloatArray) -> FloatArray:
    """Return a recording as contiguous float64 of shape (n, a), 1 ≤ a ≤ 3.

    Raises
    ------
    SampleError
        If the recording has another shape.
    """
    array = np.ascontiguousarray(stimuli, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2 or not 1 <= array.shape[1] <= MAX_AXES:
        raise SampleError(f"recording of shape {np.shape(stimuli)}; it must be (n,) or (n, 1 to {MAX_AXES})")
    return array


def refuse_out_of_range(stimuli: FloatArray, chosen: IntArray) -> None:
    """Check that the chosen samples of a recording of shape (n, a) are finite and in range.

    Raises
    ------
    SampleError
        Naming the first sample that is not.
    """
    good = (np.abs(stimuli[chosen]) <= LARGEST_COMPONENT).all(axis=1)
    if not good.all():
        first = int(chosen[np.argmin(good)])
        raise SampleError(
            f"sample {first}: stimulus is {stimuli[first].tolist()}; it must be finite and within"
            f" ±{LARGEST_COMPONENT:g}"
        )
