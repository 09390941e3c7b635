"""The master's half of announcements: a decoder that renders models of the contact ahead at the tool's own position."""

from collections import deque
from typing import Final

from hapticnet.codec.base import Decoder
from hapticnet.errors import PeerError
from hapticnet.node.model_wire import OF_CODEC, unpack_model
from hapticnet.samples import Vector
from hapticnet.scene.contact_model import ContactModel

MOST_REMEMBERED: Final = 1024
"""Positions that are remembered: those of a second at 1 kHz. The oldest force that is applied is as old."""


MOST_PER_POSITION: Final = 4
"""Models that are taken in between two positions. To play a second to one takes 3 to 11 ms; a flood must not stop the
master."""


class AnnouncedDecoder:
    """A codec's decoder, and the model that replaces it while it is the newest update. Satisfies `Decoder`.

    A model belongs to a position that is a round trip old. The positions since are played to it when it arrives, so
    that a surface that was breached meanwhile is.

    Parameters
    ----------
    inner
        The codec's decoder.
    stiffest_n_per_m
        Limit of `check_layers`.

    Attributes
    ----------
    models
        Models taken in.
    """

    __slots__ = ("_axes", "_inner", "_model", "_stiffest", "_taken", "_trail", "models")

    def __init__(self, inner: Decoder, axes: int, stiffest_n_per_m: float) -> None:
        self.models = 0
        self._inner = inner
        self._axes = axes
        self._stiffest = stiffest_n_per_m
        self._model: ContactModel | None = None
        self._taken = 0  # models since the newest position
        self._trail: deque[tuple[int, Vector]] = deque(maxlen=MOST_REMEMBERED)

    @property
    def on_model(self) -> bool:
        """Whether a model is applied."""
        return self._model is not None

    @property
    def rendering(self) -> Decoder:
        """What the applied force comes from: this decoder on a model, else that of the codec."""
        return self._inner if self._model is None else self

    @property
    def state(self) -> int:
        """Which layers of the model are pierced (`ContactModel.state`); 0 without a model."""
        return 0 if self._model is None else self._model.state

    def move(self, t_us: int, position: Vector, state: int | None = None) -> None:
        """Move the tool: to be called for each position, in order of time.

        `state` tells which layers are pierced there, where somebody knows better.
        """
        if self._trail and (t_us < self._trail[-1][0] or self._trail[-1] == (t_us, position)):
            return
        self._trail.append((t_us, position))
        self._taken = 0
        if self._model is not None:
            self._model.step(t_us, position)
            if state is not None:
                self._model.adopt(state)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload. See `Decoder.decode`."""
        if payload[:1] == OF_CODEC:
            self._inner.decode(t_us, payload[1:])
            self._model = None
            return
        layers = unpack_model(payload, self._axes, self._stiffest)
        trail = list(self._trail)
        if not trail or self._taken == MOST_PER_POSITION:
            raise PeerError("a model before any position" if not trail else "more models than are taken in at once")
        self._taken += 1
        first = max((index for index, (at_us, _) in enumerate(trail) if at_us <= t_us), default=0)
        model = ContactModel(layers, *trail[first], trail[first - 1] if first else None)
        for at_us, position in trail[first + 1 :]:
            model.step(at_us, position)
        self._model = model
        self.models += 1

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply: the model's at the newest position, else the codec's at `t_us`."""
        if self._model is not None:
            return self._model.force_n
        return self._inner.reconstruct(t_us, position, position_us)

    def foretell(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the force of the model at a position and time to come. See `Foretelling`; asked only on a model."""
        return self.reconstruct(t_us) if self._model is None else self._model.foretell(position_us, position)
