"""The perceptual deadband with zero-order hold: the codec of the paper.

Hinterseer et al. 2005 for one axis; Hinterseer & Steinbach 2006 for several, where the dead zone is a ball whose
radius follows the norm of the last transmitted stimulus (isotropic dead zone).
"""

import math
from array import array
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.codec.arrays import (
    COMPILE_ABOVE_SAMPLES,
    MARGIN,
    as_recording,
    fast_extra_installed,
    refuse_out_of_range,
)
from hapticnet.codec.base import Encoder, Encoding, FloatArray
from hapticnet.codec.payload import (
    DOUBLE,
    DOUBLE_BYTES,
    SINGLE,
    SINGLE_BYTES,
    HoldDecoder,
    check_axes,
    unpack_stimulus,
)
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector, checked_vector, magnitude

EMPTY: Final = (math.inf, -math.inf, -1.0)
"""Ends of the shortcut and threshold that let nothing pass in silence."""

BLOCK_SAMPLES = 16_384
"""Samples per block of the whole-array encoder: 128 KiB an array, which stays in the cache."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadband:
    """Transmit a stimulus only when it can be told apart from the one being held.

    Rule: send when ``|x - ref| > multiplier · max(weber_fraction · |ref|, floor_n)``, strictly, with `ref` the last
    transmitted stimulus as it was rounded for the wire. The first stimulus is always sent.
    Payload: float32 an axis, or float64 where rounding to float32 would move the stimulus by more than the
    threshold, so that the held stimulus is within the threshold of the true one at every sample, whatever the input.
    """

    name: ClassVar[str] = "deadband"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder."""
        return ScalarDeadband(self.law) if check_axes(axes) == 1 else VectorDeadband(self.law)

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder."""
        return HoldDecoder(check_axes(axes), may_be_wide=True)

    def encode_array(
        self,
        t_us: npt.NDArray[np.int64],  # noqa: ARG002 - the time decides nothing
        stimuli: FloatArray,
        positions: FloatArray | None = None,  # noqa: ARG002 - nor does motion
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        if len(stimuli) > COMPILE_ABOVE_SAMPLES and fast_extra_installed():
            from hapticnet.codec import kernels

            return kernels.deadband(self.law, stimuli)
        return _encode_scalars(self.law, stimuli) if stimuli.shape[1] == 1 else _encode_vectors(self.law, stimuli)


def transmitted(stimulus: Vector, law: WeberLaw) -> tuple[bytes, Vector, float]:
    """Return the payload of a stimulus, what the receiver makes of it, and the threshold around that.

    Raises
    ------
    SampleError
        When the stimulus is not finite or out of range.
    """
    stimulus = checked_vector(stimulus, "stimulus")
    single = SINGLE[len(stimulus)]
    payload = single.pack(*stimulus)
    reference: Vector = single.unpack(payload)
    threshold = law.threshold_n(magnitude(reference))
    if _distance(stimulus, reference) <= threshold:
        return payload, reference, threshold
    return DOUBLE[len(stimulus)].pack(*stimulus), stimulus, law.threshold_n(magnitude(stimulus))


def shortcut(reference: float, threshold: float) -> tuple[float, float]:
    """Return an interval that lies within the dead zone and all but fills it; empty when that is a point.

    What is in it needs no further look. It decides nothing: what is outside is held against the rule itself.
    """
    half = threshold - MARGIN * (abs(reference) + threshold)
    return reference - half, reference + half


def _distance(stimulus: Vector, reference: Vector) -> float:
    return magnitude(tuple(x - r for x, r in zip(stimulus, reference, strict=True)))


class ScalarDeadband:
    """One axis: silence costs two comparisons. Satisfies `Encoder`."""

    __slots__ = ("_high", "_law", "_low", "_reference", "_threshold")

    def __init__(self, law: WeberLaw) -> None:
        self._law = law
        self._reference = 0.0
        self._low, self._high, self._threshold = EMPTY

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None inside the dead zone."""
        # NaN compares false with everything, and so falls through to the check in `transmitted`.
        x = stimulus[0]
        if self._low <= x <= self._high or abs(x - self._reference) <= self._threshold:
            return None
        payload, (self._reference,), self._threshold = transmitted(stimulus, self._law)
        self._low, self._high = shortcut(self._reference, self._threshold)
        return payload

    def refresh(self) -> None:
        """Empty the dead zone, so that the next stimulus is sent."""
        self._low, self._high, self._threshold = EMPTY


class VectorDeadband:
    """Two or three axes: the dead zone is a ball. Satisfies `Encoder`."""

    __slots__ = ("_law", "_reference", "_threshold")

    def __init__(self, law: WeberLaw) -> None:
        self._law = law
        self._reference: Vector = ()
        self._threshold = -1.0

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None inside the dead zone."""
        if self._threshold >= 0.0 and _distance(stimulus, self._reference) <= self._threshold:
            return None
        payload, self._reference, self._threshold = transmitted(stimulus, self._law)
        return payload

    def refresh(self) -> None:
        """Empty the dead zone, so that the next stimulus is sent."""
        self._threshold = -1.0


def _encode_scalars(law: WeberLaw, stimuli: FloatArray) -> Encoding:
    """Walk the recording in Python, carrying nothing but the dead zone.

    All that depends on a stimulus alone (its rounding, its threshold, its shortcut) is computed for a block at once.
    """
    sent: list[int] = []
    held: list[FloatArray] = []
    wide: list[npt.NDArray[np.bool_]] = []
    reference = 0.0
    low, high, threshold = EMPTY
    for start in range(0, len(stimuli), BLOCK_SAMPLES):
        block = stimuli[start : start + BLOCK_SAMPLES, 0]
        references, thresholds, halves, is_wide = _dead_zones(law, block)
        reference_of, threshold_of, half_of = references.item, thresholds.item, halves.item
        block_start = len(sent)
        # An `array` makes one float at a time and reuses it: twice as fast as a list, ten times a numpy array.
        for index, x in enumerate(array("d", block.tobytes())):
            if low <= x <= high or abs(x - reference) <= threshold:
                continue
            reference, threshold, half = reference_of(index), threshold_of(index), half_of(index)
            low, high = reference - half, reference + half
            sent.append(start + index)
        chosen = np.array(sent[block_start:], dtype=np.int64) - start
        refuse_out_of_range(stimuli, chosen + start)
        held.append(references[chosen])
        wide.append(is_wide[chosen])
    sizes = np.where(np.concatenate([np.empty(0, dtype=np.bool_), *wide]), DOUBLE_BYTES, SINGLE_BYTES)
    return held_between(
        np.array(sent, dtype=np.int64),
        np.concatenate([np.empty(0), *held])[:, np.newaxis],
        sizes.astype(np.uint16),
        samples=len(stimuli),
    )


def _dead_zones(law: WeberLaw, stimuli: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return, were each stimulus sent: reference, threshold, half the shortcut's width, and whether as float64."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is out of range is refused by the caller
        references = stimuli.astype(np.float32).astype(np.float64)
        thresholds = law.thresholds_n(np.abs(references))
        wide = ~(np.abs(stimuli - references) <= thresholds)
        if wide.any():
            references[wide] = stimuli[wide]
            thresholds[wide] = law.thresholds_n(np.abs(references[wide]))
        halves = thresholds - MARGIN * (np.abs(references) + thresholds)
    return references, thresholds, halves, wide


def _encode_vectors(law: WeberLaw, stimuli: FloatArray) -> Encoding:
    encoder = VectorDeadband(law)
    sent: list[int] = []
    held: list[Vector] = []
    sizes: list[int] = []
    for index, stimulus in enumerate(zip(*stimuli.T.tolist(), strict=True)):
        try:
            payload = encoder.encode(0, stimulus)
        except SampleError as error:
            raise SampleError(f"sample {index}: {error}") from error
        if payload is not None:
            sent.append(index)
            held.append(unpack_stimulus(payload, len(stimulus)))
            sizes.append(len(payload))
    return held_between(
        np.array(sent, dtype=np.int64),
        np.array(held).reshape(-1, stimuli.shape[1]),
        np.array(sizes, dtype=np.uint16),
        samples=len(stimuli),
    )


def held_between(
    sent: npt.NDArray[np.int64], held: FloatArray, sizes: npt.NDArray[np.uint16], *, samples: int
) -> Encoding:
    """Return the encoding whose `sent` stimuli are held until the next one, for `samples` samples in all."""
    return Encoding(sent=sent, decoded=np.repeat(held, np.diff(sent, append=samples), axis=0), payload_bytes=sizes)
