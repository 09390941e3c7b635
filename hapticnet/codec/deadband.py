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

from hapticnet.arrays import FloatArray, as_recording, refuse_out_of_range
from hapticnet.codec.arrays import COMPILE_ABOVE_SAMPLES, MARGIN
from hapticnet.codec.base import Encoder, Encoding
from hapticnet.codec.payload import (
    COUNT_BYTES,
    DOUBLE_BYTES,
    LARGEST_COUNT,
    SINGLE_BYTES,
    Form,
    HoldDecoder,
    PayloadFormat,
    check_axes,
    check_step,
    distance,
)
from hapticnet.compiled import fast_extra_installed
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector

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

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "deadband"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_step(self.step_n)

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder."""
        return hold_encoder(self.law, PayloadFormat(axes, step_n=self.step_n), axes)

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder."""
        return HoldDecoder(PayloadFormat(axes, step_n=self.step_n), axes)

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

            return kernels.deadband(self.law, stimuli, self.step_n)
        if stimuli.shape[1] == 1:
            return _encode_scalars(self.law, stimuli, self.step_n)
        return _encode_vectors(self.law, stimuli, self.step_n)


def hold_encoder(law: WeberLaw, form: Form, axes: int) -> Encoder:
    """Return an encoder for a receiver that holds: it sends, in any form, what leaves the dead zone of what is held."""
    return ScalarDeadband(law, form) if check_axes(axes) == 1 else VectorDeadband(law, form)


def shortcut(reference: float, threshold: float) -> tuple[float, float]:
    """Return an interval that lies within the dead zone and all but fills it; empty when that is a point.

    What is in it needs no further look. It decides nothing: what is outside is held against the rule itself.
    """
    half = threshold - MARGIN * (abs(reference) + threshold)
    return reference - half, reference + half


class ScalarDeadband:
    """One axis: silence costs two comparisons. Satisfies `Encoder`."""

    __slots__ = ("_high", "_law", "_low", "_pack", "_reference", "_threshold")

    def __init__(self, law: WeberLaw, form: Form) -> None:
        self._law = law
        self._pack = form.pack
        self._reference = 0.0
        self._low, self._high, self._threshold = EMPTY

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None inside the dead zone."""
        # NaN compares false with everything, and so falls through to the check in `pack`.
        x = stimulus[0]
        if self._low <= x <= self._high or abs(x - self._reference) <= self._threshold:
            return None
        payload, (self._reference,), self._threshold = self._pack(stimulus, self._law)
        self._low, self._high = shortcut(self._reference, self._threshold)
        return payload

    def refresh(self) -> None:
        """Empty the dead zone, so that the next stimulus is sent."""
        self._low, self._high, self._threshold = EMPTY


class VectorDeadband:
    """Two or three axes: the dead zone is a ball. Satisfies `Encoder`."""

    __slots__ = ("_law", "_pack", "_reference", "_threshold")

    def __init__(self, law: WeberLaw, form: Form) -> None:
        self._law = law
        self._pack = form.pack
        self._reference: Vector = ()
        self._threshold = -1.0

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None inside the dead zone."""
        if self._threshold >= 0.0 and distance(stimulus, self._reference) <= self._threshold:
            return None
        payload, self._reference, self._threshold = self._pack(stimulus, self._law)
        return payload

    def refresh(self) -> None:
        """Empty the dead zone, so that the next stimulus is sent."""
        self._threshold = -1.0


def _encode_scalars(law: WeberLaw, stimuli: FloatArray, step_n: float) -> Encoding:
    """Walk the recording in Python, carrying nothing but the dead zone.

    All that depends on a stimulus alone (its rounding, its threshold, its shortcut) is computed for a block at once.
    """
    sent: list[int] = []
    held: list[FloatArray] = [np.empty(0)]
    sizes: list[npt.NDArray[np.uint16]] = [np.empty(0, dtype=np.uint16)]
    reference = 0.0
    low, high, threshold = EMPTY
    for start in range(0, len(stimuli), BLOCK_SAMPLES):
        block = stimuli[start : start + BLOCK_SAMPLES, 0]
        references, thresholds, halves, block_sizes = _dead_zones(law, block, step_n)
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
        sizes.append(block_sizes[chosen])
    return held_between(
        np.array(sent, dtype=np.int64),
        np.concatenate(held)[:, np.newaxis],
        np.concatenate(sizes),
        samples=len(stimuli),
    )


def _dead_zones(
    law: WeberLaw, stimuli: FloatArray, step_n: float
) -> tuple[FloatArray, FloatArray, FloatArray, npt.NDArray[np.uint16]]:
    """Return, were each stimulus sent: reference, threshold, half the shortcut's width, and bytes of payload."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is out of range is refused by the caller
        references = stimuli.astype(np.float32).astype(np.float64)
        thresholds = law.thresholds_n(np.abs(references))
        sizes = np.full(len(stimuli), SINGLE_BYTES, dtype=np.uint16)
        wide = ~(np.abs(stimuli - references) <= thresholds)
        if wide.any():
            references[wide] = stimuli[wide]
            thresholds[wide] = law.thresholds_n(np.abs(references[wide]))
            sizes[wide] = DOUBLE_BYTES
        if step_n:
            counts = np.rint(stimuli / step_n)
            counted = counts * step_n + 0.0  # no count is a negative zero
            around = law.thresholds_n(np.abs(counted))
            true_enough = (np.abs(counts) <= LARGEST_COUNT) & (np.abs(stimuli - counted) <= around)
            references = np.where(true_enough, counted, references)
            thresholds = np.where(true_enough, around, thresholds)
            sizes[true_enough] = COUNT_BYTES
        halves = thresholds - MARGIN * (np.abs(references) + thresholds)
    return references, thresholds, halves, sizes


def _encode_vectors(law: WeberLaw, stimuli: FloatArray, step_n: float) -> Encoding:
    payload_format = PayloadFormat(stimuli.shape[1], step_n=step_n)
    encoder = VectorDeadband(law, payload_format)
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
            held.append(payload_format.unpack(payload))
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
