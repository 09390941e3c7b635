"""A whole recording through a streaming pair: what every codec can do, sample for sample."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hapticnet.codec.arrays import as_recording
from hapticnet.codec.base import Codec, Encoding, FloatArray
from hapticnet.errors import SampleError

if TYPE_CHECKING:
    from hapticnet.samples import Vector


def encode_streamed(
    codec: Codec, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
) -> Encoding:
    """Encode and decode a recording as slave and master would if nothing were lost; see `Codec.encode_array`."""
    stimuli = as_recording(stimuli)
    samples, axes = stimuli.shape
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
    where: list[Vector | None] = [None] * samples
    if positions is not None:
        where = list(zip(*as_recording(positions).T.tolist(), strict=True))
    sent: list[int] = []
    sizes: list[int] = []
    decoded: list[Vector] = []
    for index, (at_us, stimulus, position) in enumerate(
        zip(t_us.tolist(), zip(*stimuli.T.tolist(), strict=True), where, strict=True)
    ):
        try:
            payload = encode(at_us, stimulus, position)
        except SampleError as error:
            raise SampleError(f"sample {index}: {error}") from error
        if payload is not None:
            decode(at_us, payload)
            sent.append(index)
            sizes.append(len(payload))
        decoded.append(reconstruct(at_us, position))
    return Encoding(
        sent=np.array(sent, dtype=np.int64),
        decoded=np.array(decoded, dtype=np.float64).reshape(samples, axes),
        payload_bytes=np.array(sizes, dtype=np.uint16),
    )
