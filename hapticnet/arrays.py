"""Whole recordings as arrays: their types, and the checks that every recording passes."""

import numpy as np
import numpy.typing as npt

from hapticnet.errors import SampleError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def as_recording(stimuli: FloatArray) -> FloatArray:
    """Return a recording as contiguous float64 of shape (n, a), 1 ≤ a ≤ 3.

    Raises SampleError if the recording has another shape.
    """
    array = np.ascontiguousarray(stimuli, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2 or not 1 <= array.shape[1] <= MAX_AXES:
        raise SampleError(f"recording of shape {np.shape(stimuli)}; it must be (n,) or (n, 1 to {MAX_AXES})")
    return array


def refuse_out_of_range(values: FloatArray, what: str = "stimulus", *, first: int = 0) -> None:
    """Check that a recording of shape (n, a) is finite and in range.

    `what`: What the values are, for the message.
    `first`: Index of the first of these samples in the whole recording, for the message.
    Raises SampleError naming the first sample that is not.
    """
    # Minimum and maximum carry NaN on, so that it fails the comparison.
    if not len(values) or -LARGEST_COMPONENT <= values.min() <= values.max() <= LARGEST_COMPONENT:
        return
    index = int(np.argmin((np.abs(values) <= LARGEST_COMPONENT).all(axis=1)))
    raise SampleError(
        f"sample {first + index}: {what} is {values[index].tolist()}; it must be finite and within"
        f" ±{LARGEST_COMPONENT:g}"
    )
