"""What a scene makes vibrate: a tool that strikes a surface, breaks through it, or slides over a texture.

A strike rings as a decaying sinusoid, a(t) = A·exp(-d·t)·sin(2π·f·t), whose amplitude grows with the speed: A. M.
Okamura, M. R. Cutkosky and J. T. Dennerlein, "Reality-based models for vibration feedback in virtual environments",
2001. A breach rings alike, with an amplitude of its own: the tip is freed by the tissue, whatever the speed.

A texture repeats along the way of the tool. Its fundamental follows from wavelength and speed, and its harmonics fall
with a power of their number, as M. Wiertlewski, C. Hudin and V. Hayward found for gratings ("On the 1/f noise and
non-integer harmonic decay of the interaction of a finger sliding on flat and sinusoidal surfaces", 2011). The power of
1.5 and an amplitude in proportion to the speed are assumptions.
"""

import math
from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.scene.settings import LARGEST_RING_M_S2, LARGEST_SPEED_M_PER_S

if TYPE_CHECKING:
    from hapticnet.scene.settings import Body, Tissue

LONGEST_STROKE_US: Final = 100_000  # the speed of a tool is not known after a longer time without a position
MOST_RINGS: Final = 32  # most strikes that ring at once: the newest
SILENT_M_S2: Final = 1e-3  # amplitude at which a ring has ended
HARMONICS: Final = 4
HARMONIC_POWER: Final = 1.5
BANDWIDTH_HZ: Final = 1000.0  # harmonics above it are left out
KEPT_STEPS: Final = 1024  # steps of a tool on a texture that are remembered


class Texture:
    """A texture under a tool: `wavelength_m`, and the amplitude [m/s²] per speed [m/s], `gain_per_s`."""

    def __init__(self, wavelength_m: float, gain_per_s: float) -> None:
        self._wavelength_m = wavelength_m
        self._gain_per_s = gain_per_s
        self._travel_m = 0.0
        self._steps: deque[tuple[float, float]] = deque(maxlen=KEPT_STEPS)  # time [µs] and travel [m], oldest first

    def slide(self, t_us: int, way_m: float) -> None:
        """Move the tool on along the texture by `way_m`; 0 while it does not touch it."""
        self._travel_m += way_m
        self._steps.append((float(t_us), self._travel_m))

    def samples(self, start_us: int, count: int, rate_hz: float) -> FloatArray | None:
        """Return accelerations [m/s²], shape (count,), from a time on; None if the tool did not slide."""
        steps = self._steps
        while len(steps) > 2 and steps[1][0] < start_us:
            steps.popleft()
        if len(steps) < 2 or steps[-1][1] == steps[0][1]:
            return None
        known_us, known_m = np.array(steps).T
        times_us = start_us + np.arange(count + 1) * (1e6 / rate_hz)
        travel_m = np.interp(times_us, known_us, known_m)
        speed = np.diff(travel_m) * rate_hz
        total = np.zeros(count)
        for number in range(1, HARMONICS + 1):
            wave = np.sin(2.0 * math.pi * number / self._wavelength_m * travel_m[:-1]) / number**HARMONIC_POWER
            total += np.where(number * speed < BANDWIDTH_HZ * self._wavelength_m, wave, 0.0)
        made: FloatArray = self._gain_per_s * speed * total
        return made


class Vibrations:
    """The strikes that still ring, and the textures under the tool."""

    def __init__(self) -> None:
        self.textures: list[Texture] = []
        self._rings: deque[tuple[int, float, float, float]] = deque(maxlen=MOST_RINGS)

    def strike(self, t_us: int, amplitude_m_s2: float, hz: float, decay_per_s: float) -> None:
        """Begin to ring at a time [µs]."""
        if amplitude_m_s2 > SILENT_M_S2:
            self._rings.append((t_us, amplitude_m_s2, hz, decay_per_s))

    def touch(self, t_us: int, elapsed_us: int, way_m: float, of: "Tissue | Body") -> None:
        """Ring, because a step of the tool by `way_m` into a surface touched it."""
        if way_m > 0.0 and 0 < elapsed_us < LONGEST_STROKE_US:
            speed = min(1e6 * way_m / elapsed_us, LARGEST_SPEED_M_PER_S)
            self.strike(t_us, min(of.touch_per_s * speed, LARGEST_RING_M_S2), of.ring_hz, of.ring_decay_per_s)

    def samples(self, start_us: int, count: int, rate_hz: float) -> list[float] | None:
        """Return `count` accelerations [m/s²] from a time on; None if nothing vibrates."""
        parts = [part for each in self.textures if (part := each.samples(start_us, count, rate_hz)) is not None]
        rings = self._rings
        for _ in range(len(rings)):
            t_us, amplitude, hz, decay = ring = rings.popleft()
            since_s = 1e-6 * (start_us - t_us)
            if amplitude * math.exp(-decay * max(since_s, 0.0)) > SILENT_M_S2:
                rings.append(ring)
                times_s = np.maximum(since_s + np.arange(count) / rate_hz, 0.0)
                parts.append(amplitude * np.exp(-decay * times_s) * np.sin(2.0 * math.pi * hz * times_s))
        if not parts:
            return None
        made: list[float] = np.sum(parts, axis=0).tolist()
        return made
