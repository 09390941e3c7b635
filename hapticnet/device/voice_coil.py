"""A simulated voice coil: what a hand feels of the vibration that is asked of it."""

import math
from collections.abc import Sequence
from typing import Final

from hapticnet.oscillator import Step, exact_step

MASS_KG: Final = 0.005  # of the magnet that moves
RESONANCE_HZ: Final = 60.0
DAMPING_RATIO: Final = 0.5
LARGEST_M_S2: Final = 30.0  # largest acceleration that the current makes
"""The data are assumptions: those of a small voice coil for the hand, which resonates below 100 Hz and makes 3 g."""


class VoiceCoil:
    """A magnet on a spring and a damper, driven by a current in proportion to the acceleration that is asked for.

    Below its resonance it gives less than that, above it follows. A step is exact for a current that is constant
    between two samples.
    """

    def __init__(self) -> None:
        self.moved_m_s2: list[float] = []  # accelerations of the newest `vibrate`
        self._x_m = self._v_m_per_s = 0.0
        self._rate_hz = 0.0
        self._step = Step(1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        self._spring = MASS_KG * (2.0 * math.pi * RESONANCE_HZ) ** 2
        self._damper = 2.0 * DAMPING_RATIO * math.sqrt(self._spring * MASS_KG)

    def vibrate(self, samples: Sequence[float], rate_hz: float) -> None:
        """Play accelerations [m/s²] at a rate [Hz]; what is beyond `LARGEST_M_S2` is cut off."""
        if rate_hz != self._rate_hz:
            self._rate_hz = rate_hz
            self._step = exact_step(MASS_KG, self._damper, self._spring, 1.0 / rate_hz)
        step, x, v = self._step, self._x_m, self._v_m_per_s
        self.moved_m_s2 = moved = []
        for sample in samples:
            force_n = MASS_KG * min(max(sample, -LARGEST_M_S2), LARGEST_M_S2)
            moved.append((force_n - self._damper * v - self._spring * x) / MASS_KG)
            x, v = step.xx * x + step.xv * v + step.xf * force_n, step.vx * x + step.vv * v + step.vf * force_n
        self._x_m, self._v_m_per_s = x, v
