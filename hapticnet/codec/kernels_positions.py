"""Whole-array encoders of one axis that follow the motion of the tool, compiled by numba (the ``fast`` extra).

Equal to the streaming pairs to the bit. What the kernels return is said in `kernels.encoding`.
"""

import math

import numpy as np
from numba import njit

from hapticnet.arrays import FloatArray
from hapticnet.codec.arrays import MARGIN
from hapticnet.codec.base import Encoding
from hapticnet.codec.kernels import (
    IntArray,
    SizeArray,
    encoding,
    fraction_and_floor,
    room,
    rounded,
    shortcut,
    since_us,
)
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, checked_vector


def velocity_adaptive(
    law: WeberLaw,
    t_us: IntArray,
    stimuli: FloatArray,
    positions: FloatArray,
    *,
    speed_gain_s_m: float,
    largest_fraction: float,
    time_constant_s: float,
    step_n: float,
) -> Encoding:
    """Encode stimuli of shape (n, 1) at positions of the same shape; a SampleError also refuses a position."""
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    weber, floor = fraction_and_floor(law)
    gain, largest = law.multiplier * speed_gain_s_m, max(law.multiplier * largest_fraction, weber)
    given = weber, floor, gain, largest, time_constant_s, step_n
    sent, sizes, decoded = room(stimuli)
    count = _moving(times, stimuli[:, 0], positions[:, 0], *given, sent, sizes, decoded[:, 0])
    if count < 0:
        last = int(sent[~count])
        try:
            checked_vector(positions[last], "position")
        except SampleError as error:
            raise SampleError(f"sample {last}: {error}") from error
    return encoding(stimuli, count, sent, sizes, decoded)


def passive_extrapolative(law: WeberLaw, stimuli: FloatArray, positions: FloatArray, *, step_n: float) -> Encoding:
    """Encode stimuli of shape (n, 1) at positions of the same shape."""
    given = *fraction_and_floor(law), step_n
    sent, sizes, decoded = room(stimuli)
    count = _shifted(stimuli[:, 0], positions[:, 0], *given, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


def passive_interpolative(
    law: WeberLaw, t_us: IntArray, stimuli: FloatArray, positions: FloatArray, *, interval_ms: float, step_n: float
) -> Encoding:
    """Encode stimuli of shape (n, 1) at positions of the same shape, with ramps of `interval_ms` at most."""
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    given = *fraction_and_floor(law), interval_ms * 1e3, step_n
    sent, sizes, decoded = room(stimuli)
    count = _ramped(times, stimuli[:, 0], positions[:, 0], *given, sent, sizes, decoded[:, 0])
    return encoding(stimuli, count, sent, sizes, decoded)


@njit(cache=True, nogil=True, error_model="numpy")
def _moving(
    times: IntArray,
    stimuli: FloatArray,
    positions: FloatArray,
    weber: float,
    floor: float,
    gain: float,
    largest: float,
    keep: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    """Return what the others do; a position that is out of range ends it as well."""
    count = 0
    reference, velocity, before = 0.0, 0.0, 0.0
    for i in range(stimuli.shape[0]):
        x, position = stimuli[i], positions[i]
        if not abs(position) <= LARGEST_COMPONENT:
            sent[count] = i
            return ~count
        elapsed = since_us(times[i - 1], times[i]) * 1e-6 if i else -1.0
        if elapsed > 0.0:
            velocity = (keep * velocity + (position - before)) / (keep + elapsed)
            before = position
        elif elapsed < 0.0:
            velocity, before = 0.0, position
        fraction = min(weber + gain * abs(velocity), largest)
        if count == 0 or not abs(x - reference) <= max(fraction * abs(reference), floor):
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            sizes[count], reference, _ = rounded(x, weber, floor, step)
            count += 1
        decoded[i] = reference
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(
    stimuli: FloatArray,
    positions: FloatArray,
    weber: float,
    floor: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    count = 0
    value, threshold, shift = 0.0, -1.0, 0.0
    low, high = math.inf, -math.inf
    along = 0.0  # no direction yet
    point = 0.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high and not abs(x - value) <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            sizes[count], value, threshold = rounded(x, weber, floor, step)
            low, high = shortcut(value, threshold)
            shift = threshold + MARGIN * (threshold + 2.0 * abs(value) + abs(value))
            count += 1
            point = value + shift * along if along != 0.0 else value
        if i and positions[i] != positions[i - 1]:
            turned = 1.0 if positions[i] > positions[i - 1] else -1.0
            if turned != along:
                along = turned
                point = value + shift * along
        decoded[i] = point
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _ramped(
    times: IntArray,
    stimuli: FloatArray,
    positions: FloatArray,
    weber: float,
    floor: float,
    interval: float,
    step: float,
    sent: IntArray,
    sizes: SizeArray,
    decoded: FloatArray,
) -> int:
    count = 0
    value, threshold, shift = 0.0, -1.0, 0.0
    low, high = math.inf, -math.inf
    along, before = 0.0, 0.0  # no direction yet
    start, ramp, origin = 0, 0.0, 0.0
    point, settled = 0.0, False  # settled: only an update or another direction changes it
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not low <= x <= high and not abs(x - value) <= threshold:
            sent[count] = i
            if not abs(x) <= LARGEST_COMPONENT:
                return ~count
            apart = since_us(start, times[i]) if count else 0.0
            origin = origin + apart / ramp * (value - origin) if apart < ramp else value
            sizes[count], value, threshold = rounded(x, weber, floor, step)
            low, high = shortcut(value, threshold)
            if apart <= 0.0 or interval == 0.0:
                origin = value
            start, ramp = times[i], min(apart, interval)
            shift = threshold + MARGIN * (threshold + 2.0 * abs(value) + abs(origin))
            point, settled = value, False
            count += 1
        turned = 1.0 if positions[i] > before else -1.0
        if turned != along and positions[i] != before and i:
            along, settled = turned, False
        before = positions[i]
        if not settled and along != 0.0:
            elapsed = since_us(start, times[i])
            settled = not 0.0 <= elapsed < ramp
            base = value if settled else origin + elapsed / ramp * (value - origin)
            point = base + (shift + max((value - base) * along, 0.0)) * along
        decoded[i] = point
    return count
