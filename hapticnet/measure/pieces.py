"""The greedy sweeps of `bound`: the same code runs as plain Python over lists and compiled over arrays."""

import math
from typing import Any

from hapticnet.arrays import FloatArray, IntArray


def sweep_holds(low: Any, high: Any, starts: IntArray) -> int:
    """Write the first sample of each of the longest holds to `starts`; return their number.

    A piece continues while the intervals of its samples have a point in common.
    """
    count = 0
    bottom, top = math.inf, -math.inf
    for i in range(len(low)):
        a, b = low[i], high[i]
        if a > top or b < bottom:
            starts[count] = i
            count += 1
            bottom, top = a, b
        else:
            if a > bottom:
                bottom = a
            if b < top:
                top = b
    return count


def sweep_holds_of_columns(low: Any, high: Any, starts: IntArray) -> int:
    """Do the same as `sweep_holds` with several intervals per sample; a piece ends where any column's would."""
    if len(low) == 0:
        return 0
    count = 1
    starts[0] = 0
    bottom, top = low[0].copy(), high[0].copy()
    columns = range(len(bottom))
    for i in range(1, len(low)):
        a, b = low[i], high[i]
        for k in columns:
            if a[k] > top[k] or b[k] < bottom[k]:
                starts[count] = i
                count += 1
                bottom, top = a.copy(), b.copy()
                break
            if a[k] > bottom[k]:
                bottom[k] = a[k]
            if b[k] < top[k]:
                top[k] = b[k]
    return count


def sweep_lines(
    times: Any, low: Any, high: Any, floor: Any, roof: Any, starts: IntArray, values: FloatArray, slopes: FloatArray
) -> int:
    """Write the longest straight pieces; return their number. O(n) amortised.

    O'Rourke, "An on-line algorithm for fitting straight lines between data ranges", CACM 24 (1981), here in the plane
    of the data. Of all lines through the ranges so far, the steepest and the flattest bound what can be reached later:
    one of the lines meets a new range unless the range is entirely above the steepest or below the flattest. The
    steepest goes through a low end and a later high end; a new high end below it turns it about the upper hull of the
    low ends (`floor`), along which its pivot only moves forward; likewise the flattest about `roof`. A hull is a run
    of indices that begins with the pivot. Lines are compared by cross products, which are exact for small whole numbers
    and otherwise as exact as the largest end in a piece.
    """
    n, count, i = len(times), 0, 0
    while i < n:
        begin = i
        steep_at = flat_at = i
        i += 1
        while i < n and times[i] == times[begin] and low[i] <= high[flat_at] and high[i] >= low[steep_at]:
            if low[i] > low[steep_at]:
                steep_at = i
            if high[i] < high[flat_at]:
                flat_at = i
            i += 1
        starts[count] = begin
        if i == n or times[i] == times[begin]:
            values[count], slopes[count] = 0.5 * (low[steep_at] + high[flat_at]), 0.0
            count += 1
            continue
        steep_dt = flat_dt = times[i] - times[begin]
        steep_dy, flat_dy = high[i] - low[steep_at], low[i] - high[flat_at]
        floor[0], floor[1], floor_head, floor_end = steep_at, i, 0, 2
        roof[0], roof[1], roof_head, roof_end = flat_at, i, 0, 2
        i += 1
        while i < n:
            t, a, b = times[i], low[i], high[i]
            steep_t, flat_t = t - times[steep_at], t - times[flat_at]
            if (a - low[steep_at]) * steep_dt > steep_dy * steep_t or (b - high[flat_at]) * flat_dt < flat_dy * flat_t:
                break
            if (b - low[steep_at]) * steep_dt < steep_dy * steep_t:
                while floor_end - floor_head > 1:
                    j = floor[floor_head + 1]
                    if times[j] == t or (b - low[j]) * steep_t >= (b - low[steep_at]) * (t - times[j]):
                        break
                    steep_at = j
                    steep_t = t - times[j]
                    floor_head += 1
                steep_dt, steep_dy = steep_t, b - low[steep_at]
            if (a - high[flat_at]) * flat_dt > flat_dy * flat_t:
                while roof_end - roof_head > 1:
                    j = roof[roof_head + 1]
                    if times[j] == t or (a - high[j]) * flat_t <= (a - high[flat_at]) * (t - times[j]):
                        break
                    flat_at = j
                    flat_t = t - times[j]
                    roof_head += 1
                flat_dt, flat_dy = flat_t, a - high[flat_at]
            while floor_end - floor_head > 1:
                j, k = floor[floor_end - 2], floor[floor_end - 1]
                if (times[k] - times[j]) * (a - low[j]) < (low[k] - low[j]) * (t - times[j]):
                    break
                floor_end -= 1
            floor[floor_end] = i
            floor_end += 1
            while roof_end - roof_head > 1:
                j, k = roof[roof_end - 2], roof[roof_end - 1]
                if (times[k] - times[j]) * (b - high[j]) > (high[k] - high[j]) * (t - times[j]):
                    break
                roof_end -= 1
            roof[roof_end] = i
            roof_end += 1
            i += 1
        steep, flat = steep_dy / steep_dt, flat_dy / flat_dt
        steep_value = low[steep_at] + steep * (times[begin] - times[steep_at])
        flat_value = high[flat_at] + flat * (times[begin] - times[flat_at])
        # The mean of two lines through the ranges also goes through them.
        values[count], slopes[count] = 0.5 * (steep_value + flat_value), 0.5 * (steep + flat)
        count += 1
    return count
