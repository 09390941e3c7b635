"""Every sample is transmitted: the uncompressed condition that all others are measured against."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording, refuse_out_of_range
from hapticnet.codec.base import Encoding
from hapticnet.codec.payload import COUNT_BYTES, LARGEST_COUNT, SINGLE_BYTES, HoldDecoder, PayloadFormat, check_step
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Raw:
    """Transmit every stimulus; the person's perception plays no part.

    Rule: always send. Payload: float32 an axis. The paper's condition "none".

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N] where all components are within ±32 767 of them, so that each is
        moved by half a step at most; 0: float32 always.
    """

    name: ClassVar[str] = "raw"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_step(self.step_n)

    def encoder(self, axes: int) -> "RawEncoder":
        """Return a new encoder."""
        return RawEncoder(PayloadFormat(axes, step_n=self.step_n, wide=False))

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder: a zero-order hold, for the samples that get lost."""
        return HoldDecoder(PayloadFormat(axes, step_n=self.step_n, wide=False), axes)

    def encode_array(
        self,
        t_us: npt.NDArray[np.int64],  # noqa: ARG002 - the time decides nothing
        stimuli: FloatArray,
        positions: FloatArray | None = None,  # noqa: ARG002 - nor does motion
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        samples, axes = stimuli.shape
        sent = np.arange(samples, dtype=np.int64)
        refuse_out_of_range(stimuli, sent)
        decoded = stimuli.astype(np.float32).astype(np.float64)
        sizes = np.full(samples, SINGLE_BYTES * axes, dtype=np.uint16)
        if self.step_n:
            counts = np.rint(stimuli / self.step_n)
            counted = (np.abs(counts) <= LARGEST_COUNT).all(axis=1)
            decoded[counted] = counts[counted] * self.step_n + 0.0  # no count is a negative zero
            sizes[counted] = COUNT_BYTES * axes
        return Encoding(sent=sent, decoded=decoded, payload_bytes=sizes)


class RawEncoder:
    """Packs every stimulus. Satisfies `Encoder`."""

    __slots__ = ("_format",)

    def __init__(self, payload_format: PayloadFormat) -> None:
        self._format = payload_format

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes:  # noqa: ARG002
        """Return the payload of every stimulus."""
        return self._format.pack_rounded(stimulus)

    def refresh(self) -> None:
        """Do nothing: the next stimulus is sent anyway."""
