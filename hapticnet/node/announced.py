"""The master's half of announcements: a decoder that renders models of the contact ahead at the tool's own position."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Final

from hapticnet.codec.base import Decoder
from hapticnet.errors import PeerError
from hapticnet.node.model_wire import OF_CODEC, unpack_model
from hapticnet.samples import Vector
from hapticnet.scene.ahead import ContactModel, LayerAhead

MOST_REMEMBERED: Final = 1024
"""Positions that are remembered: those of a second at 1 kHz. The oldest force that is applied is as old."""

MOST_PLAYED: Final = 256
"""Largest cost of the past that is played to models between two positions: up to 0.35 ms of CPU time. It is that of 64
positions for three layers: at 1 kHz, a model that is a round trip of 100 ms old is applied one position late."""

COST_OF_BEGINNING: Final = 5
"""To begin a model costs as much as to step it through so many positions."""


class Allowance:
    """What may still be played of the past before the next position. The decoders of a master share one.

    A position costs 1, and 1 for each layer.
    """

    __slots__ = ("_t_us", "left")

    def __init__(self) -> None:
        self.left = MOST_PLAYED
        self._t_us: int | None = None

    def renew(self, t_us: int) -> None:
        """Allow as much again from the position of a time on; without effect for the same time."""
        if t_us != self._t_us:
            self._t_us, self.left = t_us, MOST_PLAYED


@dataclass(slots=True)
class _Late:
    """A model that is still to be played positions of the past, and its number."""

    number: int
    model: ContactModel
    cost: int
    to_play: deque[tuple[int, Vector]]


class AnnouncedDecoder:
    """A codec's decoder, and the model that replaces it while it is the newest update. Satisfies `Decoder`.

    A model belongs to a position that is a round trip old. The positions since are played to it before it is applied,
    so that a surface that was breached meanwhile is. If they cost more than the allowance, the rest is played at the
    next positions, and what was applied before goes on. A model that arrives meanwhile waits, and replaces one that
    waits already.

    Parameters
    ----------
    inner
        The codec's decoder.
    stiffest_n_per_m
        Limit of `check_layers`.
    allowance
        One that is shared with other decoders, which are moved at the same times; None: its own.

    Attributes
    ----------
    taken
        Models taken in. Each has the number that this was then.
    settled
        Number of the newest model that was applied or replaced by a payload of the codec.
    """

    __slots__ = (
        "_allowance", "_axes", "_inner", "_late", "_model", "_stiffest", "_trail", "_waiting", "settled", "taken",
    )  # fmt: skip

    def __init__(self, inner: Decoder, axes: int, stiffest_n_per_m: float, allowance: Allowance | None = None) -> None:
        self.taken = self.settled = 0
        self._inner = inner
        self._axes = axes
        self._stiffest = stiffest_n_per_m
        self._allowance = allowance or Allowance()
        self._model: ContactModel | None = None
        self._late: _Late | None = None
        self._waiting: tuple[int, tuple[LayerAhead, ...]] | None = None  # the newest model, not begun yet
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
        self._allowance.renew(t_us)
        if self._model is not None:
            self._model.step(t_us, position)
            if state is not None:
                self._model.adopt(state)
        if self._late is not None:
            self._late.to_play.append((t_us, position))
        if self.settled != self.taken:
            self._catch_up()

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload. See `Decoder.decode`."""
        if payload[:1] == OF_CODEC:
            self._inner.decode(t_us, payload[1:])
            self._model = self._late = self._waiting = None
            self.settled = self.taken
            return
        layers = unpack_model(payload, self._axes, self._stiffest)
        if not self._trail:
            raise PeerError("a model before any position")
        self.taken += 1
        self._waiting = t_us, layers
        self._catch_up()

    def _catch_up(self) -> None:
        """Play the past to what was taken in, as far as it is allowed; apply a model that has caught up."""
        allowance = self._allowance
        while allowance.left > 0:
            late = self._late
            if late is None:
                if self._waiting is None:
                    return
                late = self._late = self._begin(*self._waiting)
                self._waiting = None
            while late.to_play and allowance.left > 0:
                late.model.step(*late.to_play.popleft())
                allowance.left -= late.cost
            if not late.to_play:
                self._model, self.settled, self._late = late.model, late.number, None

    def _begin(self, t_us: int, layers: tuple[LayerAhead, ...]) -> _Late:
        """Return a model at the remembered position of a time, with the one before for the speed."""
        trail, cost = self._trail, 1 + len(layers)
        first = max(bisect_right(trail, t_us, key=lambda remembered: remembered[0]) - 1, 0)
        model = ContactModel(layers, *trail[first], trail[first - 1] if first else None)
        self._allowance.left -= COST_OF_BEGINNING * cost
        return _Late(self.taken, model, cost, deque(islice(trail, first + 1, None)))

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply: the model's at the newest position, else the codec's at `t_us`."""
        if self._model is not None:
            return self._model.force_n
        return self._inner.reconstruct(t_us, position, position_us)

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the force of the model at a position and time to come. See `Predictive`; asked only on a model."""
        return self.reconstruct(t_us) if self._model is None else self._model.predict(position_us, position)
