"""Repeated needle insertions with tremor, generated from a seed."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from hapticnet.checks import check_parameter
from hapticnet.samples import PositionSample

TREMOR_BAND_HZ = (8.0, 12.0)
"""Band of the peak of physiological tremor, from the title of Novak and Newell, Neuroscience Letters (2017)."""

TYPICAL_TREMOR_RMS_M: Final = 50e-6
"""Lower end of the 50–200 µm rms reported for the hand in microsurgery.

PMC3989364, on the tremor of two microsurgeons in pointing tasks, quotes this range and the 8–12 Hz band. Riviere, Rader
and Khosla, "Characteristics of hand motion of eye surgeons" (1997), measured 49 µm rms, slow drift included, in
surgeons who held an instrument still.
"""

TREMOR_SINUSOIDS: Final = 8
"""Number of sinusoids: enough for an irregular envelope, few enough for a 1 kHz loop. An assumption."""

LARGEST_POSITION_M: Final = 10.0
LONGEST_PHASE_S: Final = 3600.0
MOST_INSERTIONS: Final = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class InsertionSettings:
    """Motion of the insertions. Positions [m] increase into the tissue; times are in seconds.

    The hand approaches, pushes in equal steps with a pause after each, withdraws and rests. The defaults fit the
    paper's scene, whose surfaces at 20, 40 and 60 mm breach at an indentation of 10 mm: the steps end at 29 mm
    (pressing on the first tissue), 44 mm (first breached, pressing on the second), 59 mm (second breached) and 74 mm
    (all breached). The durations are an assumption, because the paper does not state its motion.

    Attributes
    ----------
    start_m
        Rest position of the hand, in front of the first surface.
    approach_m
        End of the approach and start of pushing, also in front of the first surface.
    depth_m
        End of the last push.
    approach_s
        Duration of the approach.
    push_s
        Total duration of pushing, without pauses.
    push_steps
        Number of equal pushing steps.
    pause_s
        Duration of the pause after each step.
    withdraw_s
        Duration of the withdrawal to the start.
    rest_s
        Duration of the rest before the next insertion.
    insertions
        Number of insertions.
    variation
        Variation between insertions: the speed of each insertion and the length of each pause and rest are scaled by a
        factor drawn uniformly from 1 ± variation. An assumption.
    tremor_rms_m
        Root mean square of the tremor added to the motion.

    Raises
    ------
    SettingsError
        If a value is out of range or the positions are not in order.
    """

    start_m: float = 0.0
    approach_m: float = 0.014
    depth_m: float = 0.074
    approach_s: float = 0.5
    push_s: float = 2.8
    push_steps: int = 4
    pause_s: float = 0.2
    withdraw_s: float = 0.7
    rest_s: float = 0.4
    insertions: int = 5
    variation: float = 0.1
    tremor_rms_m: float = TYPICAL_TREMOR_RMS_M

    def __post_init__(self) -> None:
        check_parameter("insertion start_m", self.start_m, -LARGEST_POSITION_M, LARGEST_POSITION_M)
        check_parameter("insertion approach_m", self.approach_m, self.start_m, LARGEST_POSITION_M)
        check_parameter("insertion depth_m", self.depth_m, self.approach_m, LARGEST_POSITION_M)
        check_parameter("insertion approach_s", self.approach_s, 0.001, LONGEST_PHASE_S)
        check_parameter("insertion push_s", self.push_s, 0.001, LONGEST_PHASE_S)
        check_parameter("insertion push_steps", self.push_steps, 1, 100)
        check_parameter("insertion pause_s", self.pause_s, 0.0, LONGEST_PHASE_S)
        check_parameter("insertion withdraw_s", self.withdraw_s, 0.001, LONGEST_PHASE_S)
        check_parameter("insertion rest_s", self.rest_s, 0.0, LONGEST_PHASE_S)
        check_parameter("number of insertions", self.insertions, 1, MOST_INSERTIONS)
        check_parameter("insertion variation", self.variation, 0.0, 0.5)
        check_parameter("insertion tremor_rms_m", self.tremor_rms_m, 0.0, 0.01)


class ScriptedOperator:
    """Scripted insertions: minimum-jerk movements, pauses and tremor.

    A movement follows the minimum-jerk polynomial (Flash and Hogan, "The coordination of arm movements", Journal of
    Neuroscience 5, 1985): ``x₀ + (x₁ − x₀)(10τ³ − 15τ⁴ + 6τ⁵)``, with τ the elapsed share of its duration. Tremor is a
    sum of sinusoids of equal amplitude, each with a random phase and a random frequency in its own part of the band, so
    the position is a function of time alone, the same at any sampling rate.

    Parameters
    ----------
    settings
        Motion of the insertions.
    rng
        Source of the variation between insertions and of the tremor.

    Attributes
    ----------
    axes
        1: the needle's axis.
    duration_us
        Duration of the script [µs]; before and after it the hand rests at the start, without tremor.
    """

    __slots__ = ("_amplitude_m", "_ends_us", "_phases", "_rest", "_waves", "axes", "duration_us")

    def __init__(self, settings: InsertionSettings, rng: np.random.Generator) -> None:
        self.axes = 1
        self._rest = (settings.start_m,)
        # Drawn first and always: a longer script starts like a shorter one, and tremor changes nothing else.
        waves = tremor_waves(rng)
        self._waves = waves if settings.tremor_rms_m else ()
        self._amplitude_m = settings.tremor_rms_m * math.sqrt(2.0 / TREMOR_SINUSOIDS)
        # A phase is (start [µs], 1/duration [1/µs], from [m], by [m]).
        self._phases: list[tuple[int, float, float, float]] = []
        self._ends_us: list[int] = []
        t_us = 0
        for _ in range(settings.insertions):
            for duration_s, from_m, to_m in _insertion(settings, rng):
                duration_us = round(duration_s * 1e6)
                if duration_us:
                    self._phases.append((t_us, 1.0 / duration_us, from_m, to_m - from_m))
                    t_us += duration_us
                    self._ends_us.append(t_us)
        self.duration_us = t_us

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the needle at `t_us` [µs] from the start of the script."""
        if not 0 <= t_us < self.duration_us:
            return PositionSample(t_us, self._rest)
        start_us, per_us, from_m, by_m = self._phases[bisect_right(self._ends_us, t_us)]
        tremor, sin = 0.0, math.sin
        for rad_per_us, phase_rad in self._waves:
            tremor += sin(rad_per_us * t_us + phase_rad)
        position_m = from_m + self._amplitude_m * tremor
        if by_m:
            tau = (t_us - start_us) * per_us
            position_m += by_m * tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))
        return PositionSample(t_us, (position_m,))


def _insertion(settings: InsertionSettings, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Return the phases of one insertion as (duration [s], from [m], to [m])."""
    steps = settings.push_steps
    least, most = 1.0 - settings.variation, 1.0 + settings.variation
    slowness = 1.0 / rng.uniform(least, most)
    *pauses_s, rest_s = (
        rng.uniform(least, most, steps + 1) * ([settings.pause_s] * steps + [settings.rest_s])
    ).tolist()
    stops_m = [
        settings.approach_m + (settings.depth_m - settings.approach_m) * step / steps for step in range(steps + 1)
    ]
    phases = [(settings.approach_s * slowness, settings.start_m, settings.approach_m)]
    for (from_m, to_m), pause_s in zip(pairwise(stops_m), pauses_s, strict=True):
        phases += [(settings.push_s / steps * slowness, from_m, to_m), (pause_s, to_m, to_m)]
    phases += [
        (settings.withdraw_s * slowness, settings.depth_m, settings.start_m),
        (rest_s, settings.start_m, settings.start_m),
    ]
    return phases


def tremor_waves(rng: np.random.Generator) -> tuple[tuple[float, float], ...]:
    """Return the angular frequency [rad/µs] and phase [rad] of each sinusoid."""
    low_hz, high_hz = TREMOR_BAND_HZ
    part_hz = (high_hz - low_hz) / TREMOR_SINUSOIDS
    frequencies_hz = low_hz + part_hz * (np.arange(TREMOR_SINUSOIDS) + rng.random(TREMOR_SINUSOIDS))
    phases_rad = rng.uniform(0.0, 2.0 * math.pi, TREMOR_SINUSOIDS)
    return tuple(zip((frequencies_hz * (2e-6 * math.pi)).tolist(), phases_rad.tolist(), strict=True))
