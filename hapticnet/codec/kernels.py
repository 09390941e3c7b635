"""Whole-array encoders compiled by numba (the ``fast`` extra), equal to plain Python sample for sample.

Imported only where a recording is long enough to pay for loading it.
"""

import contextlib
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit

from hapticnet.arrays import FloatArray, refuse_out_of_range
from hapticnet.codec import deadband as deadband_module
from hapticnet.codec import predictive
from hapticnet.codec.arrays import MARGIN
from hapticnet.codec.base import Encoding
from hapticnet.codec.payload import COUNT_BYTES, DOUBLE_BYTES, LARGEST_COUNT, SINGLE_BYTES
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT

IntArray = npt.NDArray[np.int64]
SizeArray = npt.NDArray[np.uint16]


def _forget_stale_kernels() -> None:
    """Have kernels compiled anew when any file of this room is newer than what numba has kept.

    numba looks at the file a kernel stands in, not at those whose constants and functions are compiled into it.
    """
    folder = Path(__file__).parent
    newest_ns = max(file.stat().st_mtime_ns for file in folder.glob("*.py"))
    for kept in (folder / "__pycache__").glob("kernels*.nbi"):
        with contextlib.suppress(OSError):  # somebody else was quicker, or owns the folder
            if kept.stat().st_mtime_ns < newest_ns:
                kept.unlink()


_forget_stale_kernels()

shortcut = njit(cache=True, nogil=True, error_model="numpy")(deadband_module.shortcut)
limited = njit(cache=True, nogil=True, error_model="numpy")(predictive.limited)


def deadband(law: WeberLaw, stimuli: FloatArray, step_n: float) -> Encoding:
    """Encode stimuli of shape (n, a) with the deadband of `law`; a SampleError refuses what is out of range."""
    sent, sizes, decoded = room(stimuli)
    if stimuli.shape[1] == 1:
        count = _scalar(stimuli[:, 0], *fraction_and_floor(law), step_n, sent, sizes, decoded[:, 0])
    else:
        count = _vector(stimuli, *fraction_and_floor(law), step_n, sent, sizes, decoded)
    return encoding(stimuli, count, sent, sizes, decoded)


def fraction_and_floor(law: WeberLaw) -> tuple[float, float]:
    """Return what a threshold is of its reference, and the least threshold [N]."""
    return law.multiplier * law.weber_fraction, law.multiplier * law.floor_n


def room(stimuli: FloatArray) -> tuple[IntArray, SizeArray, FloatArray]:
    """Return room for what is sent, its sizes and what is applied; what is never written is never made resident."""
    samples = len(stimuli)
    return np.empty(samples, dtype=np.int64), np.empty(samples, dtype=np.uint16), np.empty_like(stimuli)


def encoding(stimuli: FloatArray, count: int, sent: IntArray, sizes: SizeArray, decoded: FloatArray) -> Encoding:
    """Return what a kernel has made of a recording; a SampleError refuses the stimulus that ended it.

    Parameters
    ----------
    count
        What the kernel returned: how many were sent or, where a stimulus that is out of range ended it, the complement
        of its place in `sent`.
    """
    if count < 0:
        refuse_out_of_range(stimuli, sent[~count : ~count + 1])
    return Encoding(sent=sent[:count], decoded=decoded, payload_bytes=sizes[:count])


@njit(cache=True, nogil=True, error_model="numpy")
def rounded(x: float, weber: float, floor: float, step: float) -> tuple[int, float, float]:
    """Return size of the payload, what the receiver makes of it, and the threshold around that."""
    if step > 0.0:
        counted = np.rint(x / step)
        reference = counted * step + 0.0
        threshold = max(weber * abs(reference), floor)
        if abs(counted) <= LARGEST_COUNT and abs(x - reference) <= threshold:
            return COUNT_BYTES, reference, threshold
    reference = np.float64(np.float32(x))
    threshold = max(weber * abs(reference), floor)
    if abs(x - reference) <= threshold:
        return SINGLE_BYTES, reference, threshold
    return DOUBLE_BYTES, x, max(weber * abs(x), floor)


@njit(cache=True, nogil=True, error_model="numpy")
def since_us(earlier: int, now: int) -> float:
    """Return how long one time is after another, whatever 64 bits hold; -1 where it is before."""
    return np.float64(np.uint64(now - earlier)) if now >= earlier else -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _scalar(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    """Return how many were sent.

    A stimulus that is out of range ends it: what is returned is then the complement of its place in `sent`.
    """
    count = 0
    low, high, reference, threshold = math.inf, -math.inf, 0.0, -1.0
    # The shortcut's half width, so that it needs no more steps than the rule itself: each send waits for it.
    inner_weber, inner_floor = weber * (1.0 - MARGIN), floor * (1.0 - MARGIN)
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high and not abs(x - reference) <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            size = 0
            if step > 0.0:
                counted = np.rint(x / step)
                reference = counted * step + 0.0
                threshold = max(weber * abs(reference), floor)
                if abs(counted) <= LARGEST_COUNT and abs(x - reference) <= threshold:
                    size = COUNT_BYTES
            if size == 0:
                size = SINGLE_BYTES
                reference = np.float64(np.float32(x))
                threshold = max(weber * abs(reference), floor)
                if not abs(x - reference) <= threshold:
                    size = DOUBLE_BYTES
                    reference = x
                    threshold = max(weber * abs(reference), floor)
            half = max(inner_weber * abs(reference), inner_floor) - MARGIN * abs(reference)
            low, high = reference - half, reference + half
            sizes[count] = size
            count += 1
        decoded[i] = reference
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _vector(
    stimuli: FloatArray,
    weber: float,
    floor: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    """Return how many were sent.

    A stimulus that is out of range ends it: what is returned is then the complement of its place in `sent`.
    """
    axes = stimuli.shape[1]
    reference = np.zeros(axes)
    threshold = -1.0
    count = 0
    for i in range(stimuli.shape[0]):
        distance = 0.0
        for a in range(axes):
            distance += (stimuli[i, a] - reference[a]) ** 2
        if threshold < 0.0 or not math.sqrt(distance) <= threshold:
            sent[count] = i
            for a in range(axes):
                if not abs(stimuli[i, a]) <= LARGEST_COMPONENT:
                    return ~count
            for size in (COUNT_BYTES, SINGLE_BYTES, DOUBLE_BYTES):
                if size == COUNT_BYTES and not step > 0.0:
                    continue
                square, rounding = 0.0, 0.0
                in_range = True
                for a in range(axes):
                    x = stimuli[i, a]
                    if size == COUNT_BYTES:
                        counted = np.rint(x / step)
                        in_range = in_range and abs(counted) <= LARGEST_COUNT
                        reference[a] = counted * step + 0.0
                    elif size == SINGLE_BYTES:
                        reference[a] = np.float64(np.float32(x))
                    else:
                        reference[a] = x
                    square += reference[a] * reference[a]
                    rounding += (x - reference[a]) ** 2
                threshold = max(weber * math.sqrt(square), floor)
                if in_range and math.sqrt(rounding) <= threshold:
                    sizes[count] = size * axes
                    break
            count += 1
        for a in range(axes):
            decoded[i, a] = reference[a]
    return count
