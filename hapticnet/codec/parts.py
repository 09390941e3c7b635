"""A codec of several parts: one codec of the same name for each, with the threshold of that part.

A stimulus is sent whole as soon as one part is to be sent. So an update carries the whole stimulus, as it does without
parts, and every later one repairs a loss. The other parts cost bytes but no packets, and their dead zones start again.
Payload: the parts' payloads in order, each but the last after a byte with its length (docs/refer/payloads.md).
"""

from collections.abc import Sequence
from typing import Any, cast

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec, Decoder, Delayed, Encoder, Predictive
from hapticnet.codec.schemes.raw import Raw
from hapticnet.errors import PeerError, SampleError
from hapticnet.parts import PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector, checked_vector


class PartsCodec:
    """A codec for each part. Satisfies `Codec`; its name and its negotiable parameters are those of each."""

    def __init__(self, law: PartsLaw, codecs: Sequence[Codec]) -> None:
        self.law = law
        self.codecs = tuple(codecs)
        self.name: Any = codecs[0].name
        self.needs_position: Any = codecs[0].needs_position
        self.builds_on_earlier: bool = getattr(codecs[0], "builds_on_earlier", True)
        self.__dataclass_fields__: Any = codecs[0].__dataclass_fields__

    def __getattr__(self, parameter: str) -> Any:
        if parameter == "codecs":  # before __init__, when the object is copied or unpickled
            raise AttributeError(parameter)
        return getattr(self.codecs[0], parameter)

    def encoder(self, axes: int) -> "PartsEncoder":
        """Return a new encoder; SampleError if the parts have other axes."""
        self._check(axes)
        each = zip(self.codecs, self.law.parts, strict=True)
        return PartsEncoder(self.law, [codec.encoder(part.axes) for codec, part in each])

    def decoder(self, axes: int) -> "PartsDecoder":
        """Return a new decoder; SampleError if the parts have other axes."""
        self._check(axes)
        each = zip(self.codecs, self.law.parts, strict=True)
        return decoder_of_parts(self.law, [codec.decoder(part.axes) for codec, part in each])

    def _check(self, axes: int) -> None:
        if axes != self.law.axes:
            raise SampleError(f"{axes_of(axes)}; the parts {' '.join(map(str, self.law.parts))} have {self.law.axes}")


class PartsEncoder:
    """The sending half for every part. Satisfies `Encoder` and `Delayed`."""

    def __init__(self, law: PartsLaw, encoders: Sequence[Encoder]) -> None:
        self._axes = law.axes
        self._parts = tuple(zip(law.slices(), encoders, strict=True))

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit, or None. See `Encoder.encode`."""
        # All parts are checked before the first changes its state.
        x = self._checked(stimulus, "stimulus")
        place = None if position is None else self._checked(position, "position")
        payloads = [
            encoder.encode(t_us, x[part], None if place is None else place[part]) for part, encoder in self._parts
        ]
        if not any(payload is not None for payload in payloads):
            return None
        for index, (part, encoder) in enumerate(self._parts):
            if payloads[index] is None:
                encoder.refresh()
                payloads[index] = encoder.encode(t_us, x[part], None if place is None else place[part])
        *before, last = [payload or b"" for payload in payloads]
        return b"".join(bytes([len(payload)]) + payload for payload in before) + last

    def refresh(self) -> None:
        """Force the next stimulus to be transmitted."""
        for _, encoder in self._parts:
            encoder.refresh()

    def set_round_trip(self, round_trip_us: int) -> None:
        """Tell how old a position is when the answer to it is applied [µs]; 0 if that is not known."""
        for _, encoder in self._parts:
            if isinstance(encoder, Delayed):
                encoder.set_round_trip(round_trip_us)

    def _checked(self, values: Vector, what: str) -> Vector:
        if len(values) != self._axes:
            raise SampleError(f"{what} has {axes_of(len(values))}; it must have {self._axes}")
        return checked_vector(values, what)


class PartsDecoder:
    """The receiving half for every part. Satisfies `Decoder`.

    A payload that is malformed in a part is refused there; the parts before it are then already decoded.
    """

    def __init__(self, law: PartsLaw, decoders: Sequence[Decoder]) -> None:
        self._axes = law.axes
        self._parts = tuple(zip(law.slices(), decoders, strict=True))

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload. See `Decoder.decode`."""
        pieces = []
        rest = payload
        for _ in self._parts[1:]:
            length = rest[0] + 1 if rest else 1
            if len(rest) < length:
                raise PeerError(f"payload of {len(payload)} bytes ends within a part")
            pieces.append(rest[1:length])
            rest = rest[length:]
        for (_, decoder), piece in zip(self._parts, [*pieces, rest], strict=True):
            decoder.decode(t_us, piece)

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply. See `Decoder.reconstruct`."""
        if position is not None and len(position) != self._axes:
            raise SampleError(f"position has {axes_of(len(position))}; it must have {self._axes}")
        x: list[float] = []
        for part, decoder in self._parts:
            x += decoder.reconstruct(t_us, None if position is None else position[part], position_us)
        return tuple(x)


class PredictingPartsDecoder(PartsDecoder):
    """Decoders that can all predict. Satisfies `Predictive`."""

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus at a future time and position. See `Predictive`."""
        x: list[float] = []
        for part, decoder in self._parts:
            x += cast("Predictive", decoder).predict(t_us, position[part], position_us)
        return tuple(x)


def decoder_of_parts(law: PartsLaw, decoders: Sequence[Decoder]) -> PartsDecoder:
    """Return the decoder of all parts, which predicts if each does."""
    predict = all(isinstance(decoder, Predictive) for decoder in decoders)
    return (PredictingPartsDecoder if predict else PartsDecoder)(law, decoders)


def codec_of_parts(law: PartsLaw, codecs: Sequence[Codec]) -> Codec:
    """Return one codec of parts."""
    return cast("Codec", PartsCodec(law, codecs))  # its name and fields are those of an object, not of a class


def positions_codec(law: WeberLaw) -> Codec:
    """Return the codec of positions that are all sent, of the parts of a law if it has them."""
    return codec_of_parts(law, [Raw() for _ in law.parts]) if isinstance(law, PartsLaw) else Raw()
