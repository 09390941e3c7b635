"""A whole recording through a streaming pair: what every codec can do, sample for sample, with and without loss."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.base import Codec, Encoding
from hapticnet.errors import PeerError, SampleError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hapticnet.samples import Vector


def encode_array(
    codec: Codec, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
) -> Encoding:
    """Encode and decode a recording without loss; see `Codec.encode_array`."""
    if "encode_array" not in vars(type(codec)):  # a codec of a user, which may inherit one that is not its own
        return encode_streamed(codec, t_us, stimuli, positions)
    return codec.encode_array(t_us, stimuli, positions)


def encode_streamed(
    codec: Codec, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
) -> Encoding:
    """Encode and decode a recording as slave and master would if nothing were lost; see `Codec.encode_array`."""
    stimuli = as_recording(stimuli)
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
    sent: list[int] = []
    sizes: list[int] = []
    decoded: list[Vector] = []
    for index, at_us, stimulus, position in _samples(t_us, stimuli, positions):
        try:
            payload = encode(at_us, stimulus, position)
        except SampleError as error:
            raise SampleError(f"sample {index}: {error}") from error
        if payload is not None:
            decode(at_us, payload)
            sent.append(index)
            sizes.append(len(payload))
        decoded.append(reconstruct(at_us, position))
    return _encoding(stimuli, sent, sizes, decoded)


def encode_lossy(
    codec: Codec,
    t_us: npt.NDArray[np.int64],
    stimuli: FloatArray,
    positions: FloatArray | None = None,
    *,
    loss: float,
    repair_us: int | None,
    rng: np.random.Generator,
) -> tuple[Encoding, npt.NDArray[np.int64]]:
    """Do the same over a channel that loses updates; return also which of the sent ones arrived.

    Parameters
    ----------
    loss
        Share of updates lost, each at random (0 to 1).
    repair_us
        A lost update, or one the decoder refuses, is replaced by the first stimulus that comes so much later [µs],
        unless a later update has arrived: what the session does about a round trip after. None: never.
    rng
        Which are lost.
    """
    stimuli = as_recording(stimuli)
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    sent: list[int] = []
    sizes: list[int] = []
    decoded: list[Vector] = []
    received: list[int] = []
    missing_since_us: int | None = None
    for index, at_us, stimulus, position in _samples(t_us, stimuli, positions):
        if missing_since_us is not None and repair_us is not None and at_us - missing_since_us >= repair_us:
            encoder.refresh()
            missing_since_us = None
        try:
            payload = encoder.encode(at_us, stimulus, position)
        except SampleError as error:
            raise SampleError(f"sample {index}: {error}") from error
        if payload is not None:
            sent.append(index)
            sizes.append(len(payload))
            arrives = rng.random() >= loss
            if arrives:
                try:
                    decoder.decode(at_us, payload)
                except PeerError:  # it builds on one that was lost
                    arrives = False
            if arrives:
                received.append(index)
                missing_since_us = None
            elif missing_since_us is None:
                missing_since_us = at_us
        decoded.append(decoder.reconstruct(at_us, position))
    return _encoding(stimuli, sent, sizes, decoded), np.array(received, dtype=np.int64)


def _samples(
    t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None
) -> "Iterator[tuple[int, int, Vector, Vector | None]]":
    where: list[Vector | None] = [None] * len(stimuli)
    if positions is not None:
        where = list(zip(*as_recording(positions).T.tolist(), strict=True))
    return zip(range(len(stimuli)), t_us.tolist(), zip(*stimuli.T.tolist(), strict=True), where, strict=True)


def _encoding(stimuli: FloatArray, sent: list[int], sizes: list[int], decoded: "list[Vector]") -> Encoding:
    return Encoding(
        sent=np.array(sent, dtype=np.int64),
        decoded=np.array(decoded, dtype=np.float64).reshape(stimuli.shape),
        payload_bytes=np.array(sizes, dtype=np.uint16),
    )
