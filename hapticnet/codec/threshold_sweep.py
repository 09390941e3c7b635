"""The deadband over one recording with many laws at once: packets and error as functions of the threshold."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.payload.values import law_numbers
from hapticnet.codec.recording import encode_array
from hapticnet.codec.schemes.deadband import EMPTY, Deadband
from hapticnet.compiled import compiled, fast_extra_installed
from hapticnet.measure.metrics import error_report
from hapticnet.perception import WeberLaw
from hapticnet.rounding import as_single
from hapticnet.samples import LARGEST_COMPONENT

COMPILE_ABOVE_SAMPLES = 2_000_000
"""Samples times laws above which laws are swept side by side."""

State: TypeAlias = tuple[float, float, float, float, float, float]


class ThresholdSweep(NamedTuple):
    """Packets and error of the deadband on a recording with each of m laws.

    Attributes
    ----------
    packets
        Transmitted stimuli, shape (m,), int64; exactly as `encode_array` sends.
    rmse_n
        Root mean square error of the held stimulus [N], shape (m,).
    max_error_n
        Largest error [N], shape (m,).
    exceed_jnd_fraction
        Fraction of samples further than one JND from the held stimulus, as in `ErrorReport`, shape (m,).
    """

    packets: npt.NDArray[np.int64]
    rmse_n: FloatArray
    max_error_n: FloatArray
    exceed_jnd_fraction: FloatArray


def sweep_deadband(stimuli: FloatArray, laws: Sequence[WeberLaw]) -> ThresholdSweep:
    """Return packets and error of the deadband with float32 payloads over stimuli of shape (n, a), for each law.

    With the ``fast`` extra and one axis all laws whose floor is above what float32 rounds away are swept side by side,
    the others one after the other.

    Raises
    ------
    SampleError
        When a stimulus is not finite or out of range, and there are laws to try.
    """
    stimuli = as_recording(stimuli)
    table = np.zeros((4, len(laws)))
    together = np.zeros(len(laws), dtype=np.bool_)
    if stimuli.shape[1] == 1 and len(stimuli) * len(laws) > COMPILE_ABOVE_SAMPLES and fast_extra_installed():
        # If no float32 is further than the floor from its stimulus, no payload has to be float64. A stimulus that is
        # out of range is left to the codec to refuse.
        rounding = compiled(largest_rounding)(stimuli[:, 0])
        together[:] = [rounding <= law.multiplier * law.floor_n for law in laws]
        chosen = [law for law, holds in zip(laws, together, strict=True) if holds]
        table[:, together] = _side_by_side(chosen, stimuli[:, 0])
    for index in np.flatnonzero(~together).tolist():
        encoding = encode_array(Deadband(law=laws[index]), np.arange(len(stimuli)), stimuli)
        report = error_report(laws[index], stimuli, encoding.decoded)
        table[:, index] = len(encoding.sent), report.rmse_n, report.max_error_n, report.exceed_jnd_fraction
    return ThresholdSweep(table[0].astype(np.int64), *table[1:])


def _side_by_side(laws: Sequence[WeberLaw], stimuli: FloatArray) -> FloatArray:
    """Return packets, rmse [N], largest error [N] and exceed-JND fraction of stimuli of shape (n,), shape (4, m)."""
    numbers = np.array([(*law_numbers(law), law.weber_fraction, law.floor_n) for law in laws]).reshape(-1, 4).T.copy()
    # Reference, threshold (negative: no stimulus is within it), packets, squares, largest, exceeded.
    state = np.zeros((6, len(laws)))
    state[1] = EMPTY
    compiled(sweep)(stimuli, *numbers, *state)
    samples = max(len(stimuli), 1)
    return np.stack([state[2], np.sqrt(state[3] / samples), state[4], state[5] / samples])


def largest_rounding(stimuli: FloatArray) -> float:
    """Return by how much float32 moves a stimulus at most; infinity where one is not finite or out of range."""
    largest = 0.0
    for i in range(stimuli.shape[0]):
        x = stimuli[i]
        if not abs(x) <= LARGEST_COMPONENT:
            return math.inf
        largest = max(largest, abs(x - as_single(x)))
    return largest


def sweep(
    stimuli: FloatArray,
    weber: FloatArray,
    floor: FloatArray,
    jnd_weber: FloatArray,
    jnd_floor: FloatArray,
    reference: FloatArray,
    threshold: FloatArray,
    packets: FloatArray,
    squares: FloatArray,
    largest: FloatArray,
    exceeded: FloatArray,
) -> None:
    """Sweep all laws over the stimuli.

    Without branches, which would be mispredicted: every law computes a transmission at every sample, and keeps the
    result only if it applies.
    """
    samples, laws = stimuli.shape[0], weber.shape[0]
    # Two samples at a time: the state of a law is loaded and stored half as often. Four at a time are slower.
    for i in range(1, samples, 2):
        x, y = stimuli[i - 1], stimuli[i]
        x_single, y_single = as_single(x), as_single(y)
        for k in range(laws):
            law = weber[k], floor[k], jnd_weber[k], jnd_floor[k]
            state = reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k]
            state = step(y, y_single, law, step(x, x_single, law, state))
            reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k] = state
    if samples % 2:
        x = stimuli[samples - 1]
        x_single = as_single(x)
        for k in range(laws):
            law = weber[k], floor[k], jnd_weber[k], jnd_floor[k]
            state = reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k]
            state = step(x, x_single, law, state)
            reference[k], threshold[k], packets[k], squares[k], largest[k], exceeded[k] = state


def step(x: float, single: float, law: tuple[float, float, float, float], state: State) -> State:
    """Return the state of one law after a sample."""
    weber, floor, jnd_weber, jnd_floor = law
    reference, threshold, packets, squares, largest, exceeded = state
    holds = abs(x - reference) <= threshold
    around = weber * abs(single)
    around = around if around > floor else floor
    reference = reference if holds else single
    threshold = threshold if holds else around
    packets += 0.0 if holds else 1.0
    error = abs(x - reference)
    jnd = jnd_weber * abs(reference)
    jnd = jnd if jnd > jnd_floor else jnd_floor
    squares += error * error
    largest = error if error > largest else largest
    exceeded += 1.0 if error > jnd else 0.0
    return reference, threshold, packets, squares, largest, exceeded
