"""The deadband over one recording with many laws at once: how packets and error follow from the threshold."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import COMPILE_ABOVE_SAMPLES
from hapticnet.codec.deadband import Deadband
from hapticnet.compiled import fast_extra_installed
from hapticnet.measure.metrics import error_report
from hapticnet.perception import WeberLaw


class ThresholdSweep(NamedTuple):
    """What the deadband makes of a recording with each of m laws.

    Attributes
    ----------
    packets
        Transmitted stimuli, shape (m,), int64: as many as `Deadband.encode_array` sends, to the packet.
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
        from hapticnet.codec import kernels_thresholds

        # Where no float32 is further than the floor from its stimulus, no payload has to be float64. What is out of
        # range is left to the codec to refuse.
        rounding = kernels_thresholds.largest_rounding(stimuli[:, 0])
        together[:] = [rounding <= law.multiplier * law.floor_n for law in laws]
        chosen = [law for law, holds in zip(laws, together, strict=True) if holds]
        table[:, together] = kernels_thresholds.sweep(chosen, stimuli[:, 0])
    for index in np.flatnonzero(~together).tolist():
        encoding = Deadband(law=laws[index]).encode_array(np.empty(0, dtype=np.int64), stimuli)
        report = error_report(laws[index], stimuli, encoding.decoded)
        table[:, index] = len(encoding.sent), report.rmse_n, report.max_error_n, report.exceed_jnd_fraction
    return ThresholdSweep(table[0].astype(np.int64), *table[1:])
