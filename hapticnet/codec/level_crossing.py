"""The level-crossing sampler: what is transmitted is which of a fixed set of levels the stimulus is at.

After Bhardwaj, Chaudhuri, Dabeer, "Design and analysis of predictive sampling of haptic signals", ACM Transactions on
Applied Perception 11(4), 2014: level crossings predict what users notice a little better than Weber's law, and at 10
samples/s their mean square error is about 3 dB less. Levels that Weber's law spaces, and the hysteresis, are ours.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoder, Encoding
from hapticnet.codec.deadband import hold_encoder
from hapticnet.codec.payload import COUNT, HoldDecoder, PayloadFormat, check_axes, check_parameter, distance
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector, checked_vector, magnitude

MOST_LEVELS: Final = 4096
"""Levels on either side of zero. With 5 % and 25 mN they reach beyond all range after 360."""

WIDEST: Final = 0.5
"""Half width of a cell as a fraction of its level, at most: at 1 a cell would reach down to zero."""

ROUNDING: Final = 2.0**-36
"""By how much cells are narrower than dead zones: more than `MOST_LEVELS` roundings on the way to a level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelCrossing:
    """Transmit the index of the level a stimulus has come to when it leaves the cell of the level being held.

    Rule: the deadband's, with `ref` the level held: send when ``|x - ref| > threshold(|ref|)``, strictly. What is sent
    is, on each axis, the level in whose cell x lies. The levels: ``r₀ = 0``, and rᵢ₊₁ such that its cell begins where
    the one of rᵢ ends, ``rᵢ₊₁ - w(rᵢ₊₁) = rᵢ + w(rᵢ)``; the same below zero. The half width of a cell is
    ``w(r) = max(κ·r, φ)`` with ``κ = s·multiplier·weber_fraction`` (at most ½), ``φ = s·multiplier·floor_n`` and
    ``s = (1 - hysteresis) / √axes``. Hence levels 2φ apart below φ/κ, and from there on in the ratio
    ``(1 + κ) / (1 - κ)``.

    So ``|x - ref| ≤ w(ref) ≤ threshold`` anywhere in a cell, and with a axes ``|x - ref|² ≤ Σ w(refₐ)² ≤
    a·w(|ref|)² ≤ threshold(|ref|)²``: the held stimulus is within the threshold of the true one at every sample. On
    one axis without hysteresis dead zone and cell are the same, and this is level crossing with those levels; with
    more axes the dead zone is the ball around the box of cells.

    Noise: a stimulus that rests near a crossing is sent whenever noise, however small, takes it across, where a
    deadband, which centres itself on each stimulus it sends, is silent up to a threshold. A hysteresis of h makes it
    cost a swing of 2h thresholds.

    Payload: int16 level indices, 2 bytes an axis; negative ones below zero. A stimulus beyond the last level, or any
    but zero where `floor_n` is zero, is sent as the deadband sends it.

    Attributes
    ----------
    hysteresis
        How much cells are narrower than the dead zone, as a fraction of it, 0 to 0.5. At 0.5 the levels are one
        threshold apart.
    """

    name: ClassVar[str] = "level-crossing"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("hysteresis", self.hysteresis, 0.0, 0.5)

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder."""
        return hold_encoder(self.law, LevelFormat(self, check_axes(axes)), axes)

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder."""
        return HoldDecoder(LevelFormat(self, check_axes(axes)), axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        if worth_compiling(stimuli):
            from hapticnet.codec import kernels_scalar

            return kernels_scalar.level_crossing(self.law, stimuli, *self.cells(axes=1))
        return encode_streamed(self, t_us, stimuli, positions)

    def cells(self, axes: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the levels from zero on, on each of so many axes, and the ends of their cells."""
        share = (1.0 - self.hysteresis) / math.sqrt(axes) * self.law.multiplier
        return levels(min(share * self.law.weber_fraction, WIDEST), share * self.law.floor_n)


class LevelFormat:
    """Stimuli as indices of levels, where there is one that is near enough. Satisfies `payload.Form`."""

    __slots__ = ("_edges", "_indices", "_levels", "_plain")

    def __init__(self, codec: LevelCrossing, axes: int) -> None:
        self._levels, self._edges = codec.cells(axes)
        self._indices = COUNT[axes]
        self._plain = PayloadFormat(axes)

    def pack(self, stimulus: Vector, law: WeberLaw) -> tuple[bytes, Vector, float]:
        """Return the payload of a stimulus, what the receiver makes of it, and the threshold [N] around that.

        Raises
        ------
        SampleError
            When the stimulus is not finite or out of range.
        """
        stimulus = checked_vector(stimulus, "stimulus")
        indices = [bisect_left(self._edges, abs(component)) for component in stimulus]
        if max(indices) < len(self._levels):
            signed = [-index if x < 0.0 else index for index, x in zip(indices, stimulus, strict=True)]
            reference = self._at(signed)
            threshold = law.threshold_n(magnitude(reference))
            if distance(stimulus, reference) <= threshold:
                return self._indices.pack(*signed), reference, threshold
        return self._plain.pack(stimulus, law)

    def unpack(self, payload: bytes) -> Vector:
        """Return the stimulus in a payload.

        Raises
        ------
        PeerError
            When the length fits no form, there is no such level, or a component is not finite or out of range.
        """
        if len(payload) != self._indices.size:
            return self._plain.unpack(payload)
        signed = self._indices.unpack(payload)
        if max(map(abs, signed)) >= len(self._levels):
            raise PeerError(f"payload holds levels {signed}; there are {len(self._levels) - 1} on either side of zero")
        return self._at(signed)

    def _at(self, signed: "list[int] | tuple[int, ...]") -> Vector:
        return tuple([-self._levels[-index] if index < 0 else self._levels[index] for index in signed])


@lru_cache(maxsize=32)
def levels(weber: float, floor_n: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the levels from zero on whose cells have half widths ``max(weber·level, floor_n)``, and the cells' ends.

    Found step by step, with sums and quotients alone: every machine gets the same bits, which powers do not promise.
    """
    weber, floor_n = max(weber - ROUNDING * 2.0**-10, 0.0), floor_n * (1.0 - ROUNDING)
    found, ends = [0.0], [floor_n]
    while len(found) <= MOST_LEVELS and ends[-1] < LARGEST_COMPONENT:
        # r - max(weber·r, floor) = end is solved by the larger of the two.
        level = max(ends[-1] + floor_n, ends[-1] / (1.0 - weber))
        if not found[-1] < level <= LARGEST_COMPONENT:
            break
        found.append(level)
        ends.append(level + max(weber * level, floor_n))
    return tuple(found), tuple(ends)
