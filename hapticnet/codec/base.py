"""The interface of codecs: a frozen description that makes encoders and decoders."""

from typing import Any, ClassVar, Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector


class Encoder(Protocol):
    """The sending half. Its state follows the values on the wire, never the unrounded input."""

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit for the stimulus of time `t_us` [µs], or None to send nothing.

        Parameters
        ----------
        stimulus
            The force to render, one number per axis.
        position
            Where the tool was at that time [m], for the codecs whose rule depends on motion; None: at rest.

        Raises
        ------
        SampleError
            If the stimulus, or a position that the rule uses, is not finite, has other axes, or is out of range (a
            stimulus: if it would be sent). The encoder then continues as if the sample had not come.
        """

    def refresh(self) -> None:
        """Force the next stimulus to be transmitted, because the last update is believed lost."""


@runtime_checkable
class Delayed(Protocol):
    """An encoder that can be told the round trip. Optional."""

    def set_round_trip(self, round_trip_us: int) -> None:
        """Tell how old a position is when the answer to it is applied [µs]; 0 if that is not known."""


class Decoder(Protocol):
    """The receiving half, bit-identical in state to the encoder wherever nothing was lost."""

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload that belongs to time `t_us`.

        Raises
        ------
        PeerError
            If the payload is not valid for this codec, or its values are not finite or out of range. The state
            is then unchanged.
        """

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply at time `t_us` [µs], finite; zeros before the first payload.

        Called at every sample, with the tool's position [m] where it is known. Over a network, `position_us` is later
        than `t_us`: the position is current, while the newest payload that can have arrived belongs to an earlier
        one.

        Raises
        ------
        SampleError
            If a position that the rule uses is not finite, out of range or has other axes.
        """


@runtime_checkable
class Predictive(Protocol):
    """A decoder that can predict. Optional: without it, the force ahead is estimated from updates."""

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return what `reconstruct` would return at a future time and position [m], without changing the state."""


CLASS_VARIABLES: Final = frozenset(
    ("name", "needs_position", "builds_on_earlier", "receiver_has_tables", "renders_model", "steps")
)


class Description(type):
    """Class of the descriptions of codecs. mypyc leaves a class with a metaclass plain Python, so users can extend it.

    Compiled code forgets which of their variables are class variables, so that they would become fields of a dataclass.
    It also accepts as `self` only the subclasses it has seen, unless `self` is annotated as Any.
    """

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> "Description":
        """Return a class whose class variables are annotated as such."""
        annotations = namespace.get("__annotations__", {})
        annotations.update({each: ClassVar[Any] for each in CLASS_VARIABLES if each in annotations})
        return super().__new__(cls, name, bases, namespace)


class Encoding(NamedTuple):
    """What a codec does to a whole recording of n stimuli with a axes."""

    sent: npt.NDArray[np.int64]  # indices of the transmitted stimuli, shape (m,), int64
    decoded: FloatArray  # stimulus that the receiver applies at every sample, in the unit of the input, shape (n, a)
    payload_bytes: npt.NDArray[np.uint16]  # size of each transmitted payload [B], shape (m,), uint16


class Codec(Protocol):
    """A compression scheme with its parameters. Fields other than `law` are its negotiable parameters.

    Optional: ``renders_model``, whether the receiver renders a model of what is touched. Such a codec reproduces only
    the forces that its model can make, so its error has no threshold.
    """

    name: ClassVar[str]
    needs_position: ClassVar[bool]
    """Whether its rule depends on the tool's motion; without positions it behaves as at rest."""
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def law(self) -> WeberLaw:
        """The perceptual law of the person at the master."""

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder for stimuli of 1 to 3 axes."""

    def decoder(self, axes: int) -> Decoder:
        """Return a new decoder for stimuli of 1 to 3 axes."""
