"""The fewest packets that any encoder needs: optimal piecewise reconstructions of a whole recording.

No real-time encoder can achieve this, because it requires knowing the future. It shows how far a codec is from the
optimum.

The deadband's rule is that the applied stimulus r satisfies ``|x − r| ≤ threshold(|r|)`` at every sample. The rule
concerns each sample separately, so each stimulus x admits a set of r (`tube`). Making each piece as long as possible
gives the fewest pieces: every part of a valid piece is valid, so by induction the k-th of the longest pieces ends no
earlier than the k-th piece of any other division.
"""

import math
from collections.abc import Callable
from itertools import product
from typing import Any, Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray, as_recording, refuse_out_of_range
from hapticnet.compiled import compiled, fast_extra_installed
from hapticnet.errors import SampleError
from hapticnet.measure.metrics import norms
from hapticnet.perception import WeberLaw

COMPILE_HOLDS_ABOVE = 5_000_000
COMPILE_LINES_ABOVE = 500_000  # intervals above which loading numba (about 0.6 s, extra ``fast``) pays
WIDER: Final = 1.0 + 2.0**-51
"""Factor by which a threshold is widened, so that it admits everything that a codec's rounded arithmetic admits.

With u = 2⁻⁵³, a rounded ``|x − r| ≤ max(κ·|r|, φ)`` implies ``|x − r| ≤ max(κ·|r|, φ)·(1 + u)/(1 − u)`` (unless κ·|r|
is a denormal number), which is less than a threshold 1 + 4u times as large.
"""

ROUNDINGS: Final = 2.0**-48  # bound of the relative error of a norm and of derived values: ten roundings
UNSEEN_N: Final = 1e-150  # differences [N] in one of several axes whose squares may be rounded to zero in a norm


def fewest_holds(law: WeberLaw, stimuli: FloatArray) -> int:
    """Return the fewest stimuli with which a zero-order hold keeps the rule at every sample of shape (n, a). O(n).

    One axis: the optimum. Two or three: a lower bound. As ``||X| − |R|| ≤ |X − R|``, the norm of a held R must stay in
    the tube of |X|, and its component along any direction in that `direction_tube`. The bound is the optimum under
    these conditions for the axes and the diagonals between them. SampleError if a stimulus is out of range.
    """
    stimuli = _checked(stimuli)
    if stimuli.shape[1] == 1:
        return len(hold_starts(law, stimuli))
    magnitudes = norms(stimuli)
    low, high = tube(law, magnitudes)
    slack = ROUNDINGS * magnitudes + UNSEEN_N
    tubes = [(low - slack, high + slack), *(direction_tube(law, stimuli, along) for along in _directions(stimuli))]
    lows, highs = zip(*tubes, strict=True)
    return len(_starts(_sweep_holds_of_columns, np.column_stack(lows), np.column_stack(highs)))


def fewest_lines(law: WeberLaw, t_us: IntArray, stimuli: FloatArray) -> int:
    """Return the fewest straight lines, joined or not, that keep the rule at every sample of shape (n, a).

    One axis: the optimum. Two or three: a lower bound, the largest optimum of a component: a line in space is a line
    in each component, and stays in the `direction_tube` of that axis. SampleError if a stimulus is out of range, or
    time runs backwards.
    """
    stimuli = _checked(stimuli)
    if stimuli.shape[1] == 1:
        return len(line_starts(law, t_us, stimuli))
    tubes = (direction_tube(law, stimuli, axis) for axis in np.eye(stimuli.shape[1]))
    return max(len(_line_starts(_elapsed(t_us), low, high)) for low, high in tubes)


def hold_starts(law: WeberLaw, stimuli: FloatArray) -> IntArray:
    """Return the first samples of the fewest holds of a recording of one axis, shape (m,). O(n)."""
    return _starts(_sweep_holds, *tube(law, _one_axis(stimuli)))


def line_starts(law: WeberLaw, t_us: IntArray, stimuli: FloatArray) -> IntArray:
    """Return the first samples of the fewest straight lines in the `tube` of one axis, shape (m,). O(n)."""
    return _line_starts(_elapsed(t_us), *tube(law, _one_axis(stimuli)))


def tube(law: WeberLaw, stimuli: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest r that satisfy ``|x − r| ≤ max(κ·|r|, φ)``, for stimuli x of shape (n,).

    κ is multiplier · Weber fraction and φ is multiplier · floor. Let x ≥ 0; for x < 0 all signs change.

    - ``|x − r| ≤ φ`` is ``x − φ ≤ r ≤ x + φ``.
    - ``|x − r| ≤ κ·|r|`` with r ≥ 0 and κ < 1: below x it is ``x ≤ (1 + κ)·r``, above it ``(1 − κ)·r ≤ x``, so
      ``x/(1 + κ) ≤ r ≤ x/(1 − κ)``.
    - The same with r < 0 is ``x + |r| ≤ κ·|r|``, impossible as κ < 1.

    Both intervals contain x, so their union is one interval, from the lesser of their lower ends to the greater of
    their upper ends. With x < 0 the Weber interval is ``x/(1 − κ)`` to ``x/(1 + κ)``; the code takes the lesser and the
    greater of both quotients, which covers both signs.

    For κ ≥ 1 a large enough r satisfies every x, as ``|x − r| ≤ |x| + |r|``, which rounds to |r|. Then only such an r
    is returned, for all x.

    Ends are rounded outwards: they include every double that a codec's arithmetic admits; see `WIDER`.
    """
    weber = law.multiplier * law.weber_fraction * WIDER
    floor = law.multiplier * law.floor_n * WIDER
    if weber >= 1.0:
        everything = np.full(len(stimuli), math.ldexp(float(np.abs(stimuli).max(initial=0.0)), 60))
        return everything, everything
    # The divisors are rounded outwards, and rounding of quotients and sums is monotonic, so no admitted double is lost.
    below = math.nextafter(1.0 + weber, 2.0) if weber else 1.0
    above = math.nextafter(1.0 - weber, 0.0) if weber else 1.0
    inner, outer = stimuli / below, stimuli / above
    low = np.minimum(stimuli - floor, np.minimum(inner, outer))
    high = np.maximum(stimuli + floor, np.maximum(inner, outer))
    return low, high


def direction_tube(law: WeberLaw, stimuli: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the range of the components of R along a unit vector, for stimuli X of shape (n, a).

    Where the floor applies, ``|X − R| ≤ φ``. Elsewhere ``|X − R| ≤ κ·|R| ≤ κ·(|X| + |X − R|)``, so for κ < 1
    ``|X − R| ≤ κ·|X|/(1 − κ)``. A component of X − R is at most its norm.
    """
    weber = law.multiplier * law.weber_fraction * WIDER
    floor = law.multiplier * law.floor_n * WIDER
    if weber >= 1.0:
        nothing_known = np.zeros(len(stimuli))
        return nothing_known, nothing_known
    magnitudes = norms(stimuli)
    radius = np.maximum(weber / (1.0 - weber) * magnitudes, floor) * (1.0 + ROUNDINGS) + UNSEEN_N
    if np.count_nonzero(direction) > 1:  # along an axis nothing is rounded
        radius += ROUNDINGS * magnitudes
    along = stimuli @ direction
    return along - radius, along + radius


def _checked(stimuli: FloatArray) -> FloatArray:
    stimuli = as_recording(stimuli)
    refuse_out_of_range(stimuli)
    return stimuli


def _one_axis(stimuli: FloatArray) -> FloatArray:
    stimuli = _checked(stimuli)
    if stimuli.shape[1] != 1:
        raise SampleError(f"recording of {stimuli.shape[1]} axes; it must have one axis")
    return stimuli[:, 0]


def _elapsed(t_us: IntArray) -> FloatArray:
    backwards = np.diff(t_us) < 0
    if backwards.any():
        at = int(np.argmax(backwards)) + 1
        raise SampleError(f"sample {at} is at {t_us[at]} µs, after {t_us[at - 1]} µs; time must not run backwards")
    return (t_us - t_us[:1]).astype(np.float64)


def _directions(stimuli: FloatArray) -> list[FloatArray]:
    """Return unit vectors along the axes and the diagonals between them, one of each pair of opposites."""
    axes = stimuli.shape[1]
    # The second half of the products are the opposites of the first.
    return [np.array(signs) / math.hypot(*signs) for signs in list(product((-1, 0, 1), repeat=axes))[: 3**axes // 2]]


def _starts(sweep: Callable[..., int], low: FloatArray, high: FloatArray) -> IntArray:
    starts = np.empty(len(low), dtype=np.int64)
    if low.size > COMPILE_HOLDS_ABOVE and fast_extra_installed():
        count = compiled(sweep, makes_arrays=True)(low, high, starts)
    else:
        count = sweep(low.tolist(), high.tolist(), starts)
    return starts[:count]


def _line_starts(times: FloatArray, low: FloatArray, high: FloatArray) -> IntArray:
    n = len(times)
    starts = np.empty(n, dtype=np.int64)
    if n > COMPILE_LINES_ABOVE and fast_extra_installed():
        hulls = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
        count = compiled(_sweep_lines)(times, low, high, *hulls, starts)
    else:
        count = _sweep_lines(times.tolist(), low.tolist(), high.tolist(), [0] * n, [0] * n, starts)
    return starts[:count]


# The greedy sweeps: the same code runs as plain Python over lists, and compiled over arrays.


def _sweep_holds(low: Any, high: Any, starts: IntArray) -> int:
    """Write the first sample of each of the longest pieces whose intervals meet to `starts`; return their number."""
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


def _sweep_holds_of_columns(low: Any, high: Any, starts: IntArray) -> int:
    """Do the same as `_sweep_holds` with several intervals per sample; a piece ends where any column's would."""
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


def _sweep_lines(times: Any, low: Any, high: Any, floor: Any, roof: Any, starts: IntArray) -> int:
    """Write the first sample of each of the longest straight pieces to `starts`; return their number. O(n) amortised.

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
        count += 1
        if i == n or times[i] == times[begin]:
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
    return count
