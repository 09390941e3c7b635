"""Scripted hands, generated from a seed: needle insertions on one axis, palpation on two or three, with tremor."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_integer, check_parameter
from hapticnet.samples import PositionSample, Vector, new_tuple

T = TypeVar("T")

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
    """

    start_m: float = 0.0  # rest position of the hand, in front of the first surface
    approach_m: float = 0.014  # end of the approach and start of pushing, also in front of the first surface
    depth_m: float = 0.074  # end of the last push
    approach_s: float = 0.5  # duration of the approach
    push_s: float = 2.8  # total duration of pushing, without pauses
    push_steps: int = 4  # number of equal pushing steps
    pause_s: float = 0.2  # duration of the pause after each step
    withdraw_s: float = 0.7  # duration of the withdrawal to the start
    rest_s: float = 0.4  # duration of the rest before the next insertion
    insertions: int = 5
    # Variation between insertions: the speed of each insertion and the length of each pause and rest are scaled by a
    # factor drawn uniformly from 1 ± variation. An assumption.
    variation: float = 0.1
    tremor_rms_m: float = TYPICAL_TREMOR_RMS_M  # root mean square of the tremor added to the motion

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
    """

    __slots__ = ("_amplitude_m", "_ends_us", "_phases", "_rest", "_waves", "axes", "duration_us")

    def __init__(self, settings: InsertionSettings, rng: np.random.Generator) -> None:
        self.axes = 1  # 1: the needle's axis
        self._rest = (settings.start_m,)
        # Drawn first and always: a longer script starts like a shorter one, and tremor changes nothing else.
        waves = tremor_waves(rng)
        self._waves = waves if settings.tremor_rms_m else ()
        self._amplitude_m = settings.tremor_rms_m * math.sqrt(2.0 / TREMOR_SINUSOIDS)
        moves = [
            (duration_s, from_m, to_m - from_m)
            for _ in range(settings.insertions)
            for duration_s, from_m, to_m in _insertion(settings, rng)
        ]
        self._phases, self._ends_us = _timeline(moves)
        # Duration of the script [µs]; before and after it the hand rests at the start, without tremor
        self.duration_us = self._ends_us[-1]

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the needle at `t_us` [µs] from the start of the script."""
        if not 0 <= t_us < self.duration_us:
            return new_tuple(PositionSample, (t_us, self._rest))
        start_us, per_us, from_m, by_m = self._phases[bisect_right(self._ends_us, t_us)]
        tremor, sin = 0.0, math.sin
        for rad_per_us, phase_rad in self._waves:
            tremor += sin(rad_per_us * t_us + phase_rad)
        position_m = from_m + self._amplitude_m * tremor
        if by_m:
            tau = (t_us - start_us) * per_us
            position_m += by_m * tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))
        return new_tuple(PositionSample, (t_us, (position_m,)))


def _timeline(moves: list[tuple[float, T, T]]) -> tuple[list[tuple[int, float, T, T]], list[int]]:
    """Return phases (start [µs], 1/duration [1/µs], from [m], by [m]), and their ends [µs], of moves that take time."""
    phases: list[tuple[int, float, T, T]] = []
    ends_us = [0]
    for duration_s, from_m, by_m in moves:
        duration_us = round(duration_s * 1e6)
        if duration_us:
            phases.append((ends_us[-1], 1.0 / duration_us, from_m, by_m))
            ends_us.append(ends_us[-1] + duration_us)
    return phases, ends_us[1:]


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


PHANTOM_SURFACE_M = (0.020, 0.0, 0.0)
PHANTOM_INWARD = (0.95, 0.25, -0.15)  # the surface of the scene ``phantom``, for which the default motion is made


@dataclass(frozen=True, slots=True, kw_only=True)
class PalpationSettings:
    """Motion of the palpations. Lengths are in m, times in seconds.

    The finger comes from outside to a point above the surface, presses, slides along the surface in several strokes,
    with a pause at each turn, and lifts. Press, strokes and directions differ from palpation to palpation. On two axes
    only the first two coordinates count. The durations are assumptions.
    """

    axes: int = 3  # 2 or 3
    surface_m: Vector = PHANTOM_SURFACE_M  # A point of the surface; the palpations are around it
    inward: Vector = PHANTOM_INWARD  # direction into the body; any length
    hover_m: float = 0.006  # height above the surface at which the finger starts and ends
    press_m: float = 0.006  # depth of the press
    stroke_m: float = 0.024  # length of a stroke along the surface; its middle is above `surface_m`
    strokes: int = 3  # number of strokes of a palpation, each in another direction
    # Duration of a press or a lift, of a stroke, of a pause after each, and of the rest before the next palpation
    press_s: float = 0.5
    stroke_s: float = 0.8
    pause_s: float = 0.2
    rest_s: float = 0.4
    palpations: int = 2
    # Depth, speed and pauses of each palpation are scaled by factors drawn uniformly from 1 ± variation
    variation: float = 0.2
    tremor_rms_m: float = TYPICAL_TREMOR_RMS_M  # root mean square of the tremor added on each axis

    def __post_init__(self) -> None:
        check_integer("axes of the palpation", self.axes, 2, 3)
        for name, values in (("surface_m", self.surface_m), ("inward", self.inward)):
            check_integer(f"coordinates of palpation {name}", len(values), self.axes, 3)
            for value in values:
                check_parameter(f"palpation {name}", value, -LARGEST_POSITION_M, LARGEST_POSITION_M)
        check_parameter("length of palpation inward", math.hypot(*self.inward[: self.axes]), 1e-9, 100.0)
        for name in ("hover_m", "press_m", "stroke_m"):
            check_parameter(f"palpation {name}", getattr(self, name), 0.0, LARGEST_POSITION_M)
        for name in ("press_s", "stroke_s"):
            check_parameter(f"palpation {name}", getattr(self, name), 0.001, LONGEST_PHASE_S)
        for name in ("pause_s", "rest_s"):
            check_parameter(f"palpation {name}", getattr(self, name), 0.0, LONGEST_PHASE_S)
        check_integer("palpation strokes", self.strokes, 1, 100)
        check_integer("number of palpations", self.palpations, 1, MOST_INSERTIONS)
        check_parameter("palpation variation", self.variation, 0.0, 0.5)
        check_parameter("palpation tremor_rms_m", self.tremor_rms_m, 0.0, 0.01)


class PalpatingOperator:
    """Scripted palpation: minimum-jerk movements, pauses and tremor, like `operator.scripted.ScriptedOperator`."""

    __slots__ = ("_amplitude_m", "_ends_us", "_phases", "_rest", "_waves", "axes", "duration_us")

    def __init__(self, settings: PalpationSettings, rng: np.random.Generator) -> None:
        self.axes = settings.axes  # 2 or 3
        waves = [tremor_waves(rng) for _ in range(self.axes)]
        self._waves = waves if settings.tremor_rms_m else []
        self._amplitude_m = settings.tremor_rms_m * math.sqrt(2.0 / TREMOR_SINUSOIDS)
        inward = np.array(settings.inward[: self.axes]) / math.hypot(*settings.inward[: self.axes])
        at_m = start_m = np.array(settings.surface_m[: self.axes]) - settings.hover_m * inward
        self._rest: Vector = tuple(start_m.tolist())
        moves: list[tuple[float, Vector, Vector]] = []
        for _ in range(settings.palpations):
            for duration_s, to_m in _palpation(settings, inward, start_m, rng):
                moves.append((duration_s, tuple(at_m.tolist()), tuple((to_m - at_m).tolist())))
                at_m = to_m
        self._phases, self._ends_us = _timeline(moves)
        # Duration of the script [µs]; before and after it the hand rests at the start, without tremor
        self.duration_us = self._ends_us[-1]

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the finger at `t_us` [µs] from the start of the script."""
        if not 0 <= t_us < self.duration_us:
            return new_tuple(PositionSample, (t_us, self._rest))
        start_us, per_us, from_m, by_m = self._phases[bisect_right(self._ends_us, t_us)]
        tau = (t_us - start_us) * per_us
        share = tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))
        position_m = [a + share * b for a, b in zip(from_m, by_m, strict=True)]
        for axis, waves in enumerate(self._waves):
            tremor = 0.0
            for rad_per_us, phase_rad in waves:
                tremor += math.sin(rad_per_us * t_us + phase_rad)
            position_m[axis] += self._amplitude_m * tremor
        return PositionSample(t_us, tuple(position_m))


def _palpation(
    settings: PalpationSettings, inward: FloatArray, start_m: FloatArray, rng: np.random.Generator
) -> list[tuple[float, FloatArray]]:
    """Return the phases of one palpation as (duration [s], to [m])."""
    least, most = 1.0 - settings.variation, 1.0 + settings.variation
    slowness, deep, *pauses = rng.uniform(least, most, settings.strokes + 4).tolist()
    ways = [_along_surface(inward, rng) * 0.5 * settings.stroke_m for _ in range(settings.strokes)]
    below_m = (settings.hover_m + settings.press_m * deep) * inward
    down_m = start_m - ways[0]
    phases = [(settings.press_s * slowness, down_m), (settings.press_s * slowness, down_m + below_m)]
    phases.append((settings.pause_s * pauses[0], phases[-1][1]))
    for way, pause in zip(ways, pauses[1:], strict=False):
        # To the beginning of the stroke if not there yet, and through it.
        for stop_m in (start_m - way + below_m, start_m + way + below_m):
            if not np.array_equal(stop_m, phases[-1][1]):
                phases.append((settings.stroke_s * slowness, stop_m))
        phases.append((settings.pause_s * pause, phases[-1][1]))
    lifted_m = phases[-1][1] - below_m
    phases += [(settings.press_s * slowness, lifted_m), (settings.press_s * slowness, start_m)]
    return [*phases, (settings.rest_s * pauses[-1], start_m)]


def _along_surface(inward: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a random unit vector along the surface."""
    drawn = rng.normal(size=len(inward))
    along: FloatArray = drawn - (drawn @ inward) * inward
    return along / np.linalg.norm(along)


def scripted_hand(axes: int, times: int, rng: np.random.Generator) -> ScriptedOperator | PalpatingOperator:
    """Return a hand with the default motion that inserts or palpates this many times."""
    if axes == 1:
        return ScriptedOperator(InsertionSettings(insertions=times), rng)
    return PalpatingOperator(PalpationSettings(axes=axes, palpations=times), rng)
