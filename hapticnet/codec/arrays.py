"""Whole recordings: the check at their door, and the choice between plain Python and compiled kernels."""

from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.compiled import fast_extra_installed

COMPILE_ABOVE_SAMPLES = 2_000_000
"""Recordings longer than this go to the compiled kernels where the ``fast`` extra is installed.

Loading a cached kernel costs about 0.6 s, in which plain Python encodes some ten million samples; compiling it for
the first time costs two to three times that.
"""

COMPILE_STREAM_ABOVE_SAMPLES = 300_000
"""The same for codecs that have no plain Python but the streaming pair's, which takes some 2 µs a sample."""

MARGIN: Final = 2.0**-50
"""By how much, of reference and threshold, a shortcut is narrower than its dead zone: more than they round."""


def worth_compiling(stimuli: FloatArray, *others: npt.NDArray[np.generic]) -> bool:
    """Tell whether a recording of one axis is long enough for a compiled kernel, and whether there can be one.

    There is none where the times or positions that belong to it are not as many.
    """
    samples = len(stimuli)
    fitting = stimuli.shape[1] == 1 and all(other.size == samples for other in others)
    return fitting and samples > COMPILE_STREAM_ABOVE_SAMPLES and fast_extra_installed()
