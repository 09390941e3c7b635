"""Decoders of a master beside the codec's own: models of the contact ahead, the slave's view, and a bound on forces.

The payload of a FORCE in a session with announcements is a byte, and after it a payload of the codec or a model of the
contact ahead. That of a POSITION is a byte that says which layers of the model are pierced, and the position. A model
is the number of its layers in a byte, and for each layer a byte of flags and the values that it has as float32,
big-endian, in the order of `_FIELDS`.
"""

import math
import struct
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final, cast

from hapticnet.codec.base import Codec, Decoder, Predictive
from hapticnet.codec.parts import PartsCodec, decoder_of_parts
from hapticnet.errors import PeerError, SampleError
from hapticnet.node.hand_predictor import LONGEST_AHEAD_US
from hapticnet.samples import Vector
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead, check_layers
from hapticnet.vectors import magnitude, minus, times

OF_CODEC: Final = b"\x00"
OF_MODEL: Final = b"\x01"

PIERCED: Final = 1
BREACHES: Final = 2
VISCOUS: Final = 4
STIFFENS: Final = 8
RUBS: Final = 16
RECOVERS: Final = 32

_FIELDS: Final = (
    (0, ("surface_m", "stiffness_n_per_m")),
    (BREACHES, ("breach_force_n",)),
    (VISCOUS, ("viscosity_n_s_per_m",)),
    (STIFFENS, ("stiffening_per_m",)),
    (RUBS, ("friction_n", "presliding_m", "shaft_n")),
    (RECOVERS, ("recovery_s", "raised_m")),
)
"""The flag of each group of values, and their names. The normal follows, unless there is one axis."""


def pack_model(layers: Sequence[LayerAhead], axes: int) -> bytes:
    """Return the payload that announces `layers`. Raise SampleError if a value does not fit a float32."""
    parts = [OF_MODEL, bytes([len(layers)])]
    for layer in layers:
        flags = (
            PIERCED * layer.pierced
            | BREACHES * (layer.breach_force_n < math.inf)
            | VISCOUS * (layer.viscosity_n_s_per_m > 0.0)
            | STIFFENS * (layer.stiffening_per_m > 0.0)
            | RUBS * (layer.friction_n > 0.0)
            | RECOVERS * (layer.recovery_s > 0.0)
        )
        values = [getattr(layer, name) for flag, names in _FIELDS if flag & flags == flag for name in names]
        if axes > 1:
            values += layer.normal
        try:
            parts.append(struct.pack(f">B{len(values)}f", flags, *values))
        except OverflowError as error:
            raise SampleError(f"a layer ahead does not fit a float32: {layer}") from error
    return b"".join(parts)


def unpack_model(payload: bytes, axes: int, stiffest_n_per_m: float) -> tuple[LayerAhead, ...]:
    """Return the layers that a payload announces. Raise PeerError if it is malformed, or contains forbidden values."""
    try:
        if payload[:1] != OF_MODEL or payload[1] > MOST_LAYERS:
            raise PeerError(f"payload {payload[:2].hex()}…: not a model of at most {MOST_LAYERS} layers")
        layers, at = [], 2
        for _ in range(payload[1]):
            layer, at = _unpack_layer(payload, at, axes)
            layers.append(layer)
        if at != len(payload):
            raise PeerError(f"a model of {at} bytes in a payload of {len(payload)}")
        check_layers(layers, axes, stiffest_n_per_m)
    except (IndexError, struct.error) as error:
        raise PeerError(f"a model that ends after {len(payload)} bytes") from error
    except SampleError as error:
        raise PeerError(str(error)) from error
    return tuple(layers)


def _unpack_layer(payload: bytes, at: int, axes: int) -> tuple[LayerAhead, int]:
    flags = payload[at]
    if flags >= 2 * RECOVERS:
        raise PeerError(f"a layer with unknown flags {flags:#x}")
    names = [name for flag, names in _FIELDS if flag & flags == flag for name in names]
    count = len(names) + (axes if axes > 1 else 0)
    values = struct.unpack_from(f">{count}f", payload, at + 1)
    normal = values[len(names) :] or (1.0,)
    layer = LayerAhead(**dict(zip(names, values, strict=False)), normal=normal, pierced=bool(flags & PIERCED))
    return layer, at + 1 + 4 * count


def with_state(state: int, payload: bytes) -> bytes:
    """Return the payload of a POSITION after the byte of the model's pierced layers."""
    return bytes([state]) + payload


def read_state(payload: bytes) -> tuple[int, bytes]:
    """Return the pierced layers and the payload of the position; PeerError if it is empty."""
    if not payload:
        raise PeerError("a position without a state")
    return payload[0], payload[1:]


MOST_REMEMBERED: Final = 1024
"""Positions that are remembered: those of a second at 1 kHz. The oldest applied force has this age."""

MOST_PLAYED: Final = 256
"""Largest cost of replaying past positions to models between two positions: up to 0.35 ms of CPU time, the cost of 64
positions for three layers: at 1 kHz, a model that is a round trip of 100 ms old is applied one position late."""

COST_OF_BEGINNING: Final = 5  # starting a model costs as much as this many steps


class Allowance:
    """Budget for replay before the next position. Each replayed position costs 1, and 1 for each layer."""

    def __init__(self) -> None:
        self.left = MOST_PLAYED
        self._t_us: int | None = None

    def renew(self, t_us: int) -> None:
        """Renew the allowance at the position of a time; without effect for the same time."""
        if t_us != self._t_us:
            self._t_us, self.left = t_us, MOST_PLAYED


@dataclass(slots=True)
class _Late:
    """A model that still needs past positions, and its number."""

    number: int
    model: ContactModel
    cost: int
    to_play: deque[tuple[int, Vector]]


class AnnouncedDecoder:
    """A codec's decoder, and the model that replaces it while it is the newest update. Satisfies `Decoder`.

    A model belongs to a position that is a round trip old. Later positions are replayed to it before it is applied,
    so that it includes breaches since then. If they cost more than the allowance, the rest is replayed at the
    next positions, and the previous force continues. A model that arrives meanwhile waits, and replaces one that
    waits already.

    `allowance`: shared with other decoders that move at the same times; None: its own.
    """

    def __init__(self, inner: Decoder, axes: int, stiffest_n_per_m: float, allowance: Allowance | None = None) -> None:
        # number of the newest model that was applied or replaced by a payload of the codec
        self.taken = self.settled = 0  # count of received models, which gives each its number
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
        """The source of the applied force: this decoder on a model, else the codec's."""
        return self._inner if self._model is None else self

    @property
    def state(self) -> int:
        """Which layers of the model are pierced (`ContactModel.state`); 0 without a model."""
        return 0 if self._model is None else self._model.state

    def move(self, t_us: int, position: Vector, state: int | None = None) -> None:
        """Move the tool, in order of time; `state`: the pierced layers there, if known."""
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
        """Process a payload. See `Decoder.decode`."""
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
        """Replay past positions to received models within the allowance; apply a model that has caught up."""
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
        """Return the force of the model at a future position and time. See `Predictive`; asked only on a model."""
        return self.reconstruct(t_us) if self._model is None else self._model.predict(position_us, position)


class LineDecoder:
    """A second decoder of a session, at the tool's position as the slave assumes it, on the promised line.

    The slave judges the force there, which differs from the force at the tool if the decoder follows the position.

    `allowance`: shared with the master's own decoder, which may therefore apply a model some positions earlier.
    """

    def __init__(self, codec: Codec, axes: int, stiffest_n_per_m: float | None, allowance: Allowance) -> None:
        self._announced: AnnouncedDecoder | None = None
        # A decoder that does not use the position applies the same force everywhere.
        self._decoder: Decoder | None = codec.decoder(axes) if codec.needs_position else None
        if stiffest_n_per_m is not None:
            inner = self._decoder or codec.decoder(axes)
            self._decoder = self._announced = AnnouncedDecoder(inner, axes, stiffest_n_per_m, allowance)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload after the master's own decoder."""
        if self._decoder is None:
            return
        try:
            self._decoder.decode(t_us, payload)
        except PeerError:  # a model, but this decoder has no position yet
            return

    def move(self, t_us: int, place_m: Vector, place_us: int) -> None:
        """Note the tool's position as the slave assumes it; call this at each tick."""
        if self._announced is not None:
            self._announced.move(place_us, place_m)
        if self._decoder is not None:
            self._decoder.reconstruct(t_us, place_m, place_us)

    def difference(self, here_n: Vector, t_us: int, place_m: Vector, place_us: int) -> Vector | None:
        """Return the difference of `here_n` from the force at a place [N]; None if there can be none."""
        decoder = self._decoder if self._announced is None else self._announced.rendering
        if not isinstance(decoder, Predictive):
            return None
        return minus(here_n, decoder.predict(t_us, place_m, place_us))


GROWTH: Final = 1.3
MARGIN_N: Final = 0.5
"""The bound is this factor times the largest force answered recently, plus this force [N], which a hand can add
within a round trip. bench/measure/felt.py compares values."""

LATELY_US: Final = 1_000_000  # how far back [µs] answered forces count, and positions are remembered
WAY: Final = 50  # positions from which a velocity follows: ten time constants at 1 kHz


class BoundedDecoder:
    """A decoder whose forces stay near those of positions that the slave has answered. Satisfies `Decoder`.

    Over a network with a delay, a decoder that follows the receiver's own position draws a force for positions that the
    slave has not answered yet, with a stiffness and viscosity that were learned a round trip ago. At a first touch or
    in rigid contact these can be wrong by far: 25 N were applied on a spring that never pressed with more than 7.5 N.
    The force of the same updates at positions that are a round trip old is known to be right: the slave would have
    contradicted it. What is applied stays near the largest of these forces.

    A second decoder gets the same updates, and is at the newest answered position, at the time for which the
    first is asked (`Decoder.reconstruct`).

    `free_us`: nothing is bounded while the newest answered position is at most so old [µs].
    """

    def __init__(self, codec: Codec, axes: int, free_us: int = -1) -> None:
        self._free_us, self._is_free = free_us, False
        self.inner, self._behind = codec.decoder(axes), codec.decoder(axes)
        self._answered_us: int | None = None
        self._times_us: list[int] = []  # of positions of the last second
        self._positions_m: list[Vector] = []
        self._forces: deque[tuple[int, float]] = deque()  # answered ones; each is larger than those after it
        self._bound_n = MARGIN_N  # largest magnitude allowed now

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload. See `Decoder.decode`."""
        self.inner.decode(t_us, payload)
        if self._answered_us is None:
            end = bisect_right(self._times_us, t_us)
            for index in range(max(end - WAY, 0), end):  # the velocity there
                self._behind.reconstruct(self._times_us[index], self._positions_m[index], self._times_us[index])
            self._answered_us = t_us
        self._behind.decode(t_us, payload)

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply. See `Decoder.reconstruct`."""
        force_n = self.inner.reconstruct(t_us, position, position_us)
        if position is None:
            return force_n
        now_us = t_us if position_us is None else position_us
        self._move(now_us, position)
        self._is_free = now_us - t_us <= self._free_us
        if self._answered_us is not None and t_us >= self._answered_us:  # jitter may move the time back
            self._answered_us = t_us
            answered_m = self._positions_m[max(bisect_right(self._times_us, t_us) - 1, 0)]
            self._note(self._behind.reconstruct(t_us, answered_m, t_us), now_us)
        return self._limited(force_n)

    def _move(self, t_us: int, position_m: Vector) -> None:
        """Note the position of the tool."""
        if self._times_us and t_us <= self._times_us[-1]:
            return
        self._times_us.append(t_us)
        self._positions_m.append(position_m)
        if self._times_us[0] < t_us - 2 * LATELY_US:
            old = bisect_right(self._times_us, t_us - LATELY_US)
            del self._times_us[:old], self._positions_m[:old]

    def _note(self, force_n: Vector, now_us: int) -> None:
        """Note the force [N] at an answered position."""
        size_n, forces = magnitude(force_n), self._forces
        while forces and forces[-1][1] <= size_n:
            forces.pop()
        forces.append((now_us, size_n))
        while forces[0][0] < now_us - LATELY_US:
            forces.popleft()
        self._bound_n = GROWTH * forces[0][1] + MARGIN_N

    def _limited(self, force_n: Vector) -> Vector:
        size_n = magnitude(force_n)
        return force_n if self._is_free or size_n <= self._bound_n else times(force_n, self._bound_n / size_n)


class BoundedPredictingDecoder(BoundedDecoder):
    """A bounded decoder that can predict. Satisfies `Predictive`."""

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus at a future time. See `Predictive`."""
        return self._limited(cast("Predictive", self.inner).predict(t_us, position, position_us))


def receiver(codec: Codec, axes: int, *, predicted: bool = False, period_us: int = 0) -> Decoder:
    """Return the decoder to apply: a bounded one if the codec follows the receiver's own position.

    `predicted`: whether the slave judges the force at the hand's expected position instead of its last one. It
    expects no further than `LONGEST_AHEAD_US`, and answers hold until the next position, a `period_us` later.
    """
    if isinstance(codec, PartsCodec):
        each = zip(codec.codecs, codec.law.parts, strict=True)
        return decoder_of_parts(
            codec.law, [receiver(own, part.axes, predicted=predicted, period_us=period_us) for own, part in each]
        )
    if not codec.needs_position:
        return codec.decoder(axes)
    bounded = BoundedPredictingDecoder if isinstance(codec.decoder(axes), Predictive) else BoundedDecoder
    return bounded(codec, axes, LONGEST_AHEAD_US + period_us) if predicted else bounded(codec, axes)
