"""Every sample is transmitted, as float32: the uncompressed condition that all others are measured against."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hapticnet.codec.arrays import as_recording, refuse_out_of_range
from hapticnet.codec.base import Encoding, FloatArray
from hapticnet.codec.payload import SINGLE_BYTES, HoldDecoder, check_axes, pack_single
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Raw:
    """Transmit every stimulus; the person's perception plays no part.

    Rule: always send. Payload: float32 an axis. The paper's condition "none".
    """

    name: ClassVar[str] = "raw"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)

    def encoder(self, axes: int) -> "RawEncoder":
        """Return a new encoder."""
        check_axes(axes)
        return RawEncoder()

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder: a zero-order hold, for the samples that get lost."""
        return HoldDecoder(check_axes(axes), may_be_wide=False)

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
        return Encoding(
            sent=sent,
            decoded=stimuli.astype(np.float32).astype(np.float64),
            payload_bytes=np.full(samples, SINGLE_BYTES * axes, dtype=np.uint16),
        )


class RawEncoder:
    """Packs every stimulus. Satisfies `Encoder`."""

    __slots__ = ()

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes:  # noqa: ARG002
        """Return the payload of every stimulus."""
        return pack_single(stimulus)

    def refresh(self) -> None:
        """Do nothing: the next stimulus is sent anyway."""
