"""The slave's half of announcements: an encoder that sends models of the contact ahead, or what the codec sends.

What arrived last is what the master applies. While that is a model, the slave steps the same one, and is silent as long
as its force is within the threshold of the true one. If it is not, or if other layers are ahead, the slave sends
another model, or a payload of the codec where the scene has no model that is right now.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

from hapticnet.codec.base import Decoder, Encoder
from hapticnet.errors import in_words
from hapticnet.node.announced import AnnouncedDecoder
from hapticnet.node.model_wire import OF_CODEC, pack_model, unpack_model
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead, LookAhead, stiffest_at, too_stiff
from hapticnet.scene.base import Touchable, look_ahead_of
from hapticnet.vectors import distance, magnitude

LOOK_EVERY_US: Final = 5_000
"""How often the scene is asked what is ahead while the model is right [µs]."""

AGREEMENT: Final = 0.5
"""Largest error of a model that is sent, at its first position, as a share of the threshold."""

FAR: Final = 0.1
"""By how much the place of a surface that is announced may change before it is announced again, as a share of the
distance: a curved surface is a plane that turns."""

FIRST_DOUBT_US: Final = 20_000
LONGEST_DOUBT_US: Final = 6_400_000
"""How long [µs] the codec is used after a model was wrong and the scene had no other: twice as long each time."""

SHORTEST_LIFE_US: Final = 10_000
"""A model that is wrong sooner than this [µs] is not replaced by another one, but by the codec."""

TRUSTED_AFTER: Final = 50
"""Samples in contact for which a model must be right before the doubts about earlier ones are forgotten."""


@dataclass(slots=True)
class AnnouncingAccount:
    """What became of the announcements.

    Attributes
    ----------
    models
        Models sent.
    corrections
        Updates sent because a model was wrong: other models, or payloads of the codec.
    unusable
        Announcements of the scene that break the limits.
    left_out
        Layers that were left out of announcements because they are too stiff together with those before them.
    on_model
        Samples at which a model was applied.
    fault
        What was wrong with the newest announcement that was not usable as a whole.
    """

    models: int = 0
    corrections: int = 0
    unusable: int = 0
    left_out: int = 0
    on_model: int = 0
    fault: str | None = None

    def report(self) -> dict[str, Any]:
        """Return the account for JSON."""
        return asdict(self)


class AnnouncingEncoder:
    """A codec's encoder, and the models of a scene. Satisfies `Encoder`.

    Parameters
    ----------
    inner
        The codec's encoder.
    law
        The threshold of the person at the master.
    look_ahead
        Asked for the layers ahead after each step of the scene.
    stiffest_n_per_m
        Limit of `check_layers`.
    """

    __slots__ = (
        "_axes", "_before", "_doubt_us", "_doubted_until_us", "_inner", "_law", "_look_ahead", "_looked_us", "_model",
        "_now", "_refresh", "_renews", "_repeats", "_right", "_sent_us", "_stiffest", "_was_right", "account",
    )  # fmt: skip

    def __init__(
        self, inner: Encoder, law: WeberLaw, axes: int, look_ahead: LookAhead, stiffest_n_per_m: float
    ) -> None:
        self.account = AnnouncingAccount()
        self._inner = inner
        self._law = law
        self._axes = axes
        self._look_ahead = look_ahead
        self._stiffest = stiffest_n_per_m
        self._model: ContactModel | None = None  # what the master applies; None: what the codec says
        self._now: tuple[int, Vector] | None = None
        self._before: tuple[int, Vector] | None = None
        self._refresh = True
        self._repeats = self._was_right = self._renews = False
        self._right = 0
        self._looked_us: int | None = None
        self._doubt_us = FIRST_DOUBT_US
        self._doubted_until_us = -(1 << 62)
        self._sent_us = 0

    @property
    def newest(self) -> tuple[bool, bool]:
        """Whether the newest payload only repeats the model before it, and whether the update before it is right."""
        return self._repeats, self._was_right

    @property
    def on_model(self) -> bool:
        """Whether the newest update is a model. It needs no earlier one."""
        return self._model is not None

    def refresh(self) -> None:
        """Make the next stimulus a transmitted one."""
        self._refresh = True

    def step(self, t_us: int, position: Vector, state: int | None = None) -> None:
        """Step the model to a position; `encode` does so unless it was done for the position.

        `state` tells which layers are pierced there at a master that has the newest update.
        """
        self._before, self._now = self._now, (t_us, position)
        if self._model is not None:
            self._model.step(t_us, position)
            if state is not None:
                self._model.adopt(state)

    @property
    def rubs(self) -> bool:
        """Whether the force of the model depends on the way that the tool has gone: friction on its shaft."""
        return self._model is not None and any(layer.pierced and layer.friction_n for layer in self._model.layers())

    def renew(self) -> None:
        """Make the next update a model that the master needs although it has the one before."""
        self._refresh = self._renews = True

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit, or None. See `Encoder.encode`."""
        if position is None:
            return self._send_codec(t_us, stimulus, position)
        if self._now != (t_us, position):
            self.step(t_us, position)
        self._repeats = self._was_right = False
        model = self._model
        if model is None:
            payload = None
            if t_us >= self._doubted_until_us and (self._refresh or self._may_look(t_us)):
                payload = self._send_model(t_us, stimulus, position)
            return payload or self._send_codec(t_us, stimulus, position)
        if self._agrees(model.force_n, stimulus, 1.0):
            self.account.on_model += 1
            self._note_right(stimulus)
            news = self._has_news(model, t_us, position)
            if not self._refresh and not news:
                return None
            self._was_right = True
            payload = self._send_model(t_us, stimulus, position) if news else None
            if payload is None and self._refresh:
                payload = self._sent_model(pack_model(model.layers(), self._axes), t_us, position)
                self._repeats = not self._renews
            self._renews = False
            return payload
        payload = None
        if t_us - self._sent_us >= SHORTEST_LIFE_US:
            payload = self._send_model(t_us, stimulus, position)
        if payload is None:
            payload = self._send_codec(t_us, stimulus, position)
            self._model = None
            if self._layers() is not None:  # the scene errs; one that cannot tell now does not
                self._doubted_until_us = t_us + self._doubt_us
                self._doubt_us = min(2 * self._doubt_us, LONGEST_DOUBT_US)
                self._right = 0
        self.account.corrections += 1
        return payload

    def _agrees(self, applied_n: Vector, stimulus: Vector, share: float) -> bool:
        return distance(stimulus, applied_n) <= share * self._law.threshold_n(magnitude(applied_n))

    def _note_right(self, stimulus: Vector) -> None:
        if magnitude(stimulus) > self._law.threshold_n(0.0):
            self._right += 1
            if self._right == TRUSTED_AFTER:
                self._doubt_us = FIRST_DOUBT_US

    def _has_news(self, model: ContactModel, t_us: int, position: Vector) -> bool:
        """Return whether the scene announces layers that the model does not have, or has in another state."""
        layers = self._layers() if self._may_look(t_us) else None
        if layers is None:
            return False
        announced = ContactModel(layers, t_us, position, self._before).layers()
        held, tolerance_n = model.layers(), AGREEMENT * self._law.threshold_n(0.0)
        return not all(any(_covers(has, layer, position, tolerance_n) for has in held) for layer in announced)

    def _may_look(self, t_us: int) -> bool:
        if self._looked_us is not None and 0 <= t_us - self._looked_us < LOOK_EVERY_US:
            return False
        self._looked_us = t_us
        return True

    def _layers(self) -> tuple[LayerAhead, ...] | None:
        """Return what the scene announces, as the master reads it; None if it is not to be announced."""
        try:
            layers = self._look_ahead()
            if layers is None:
                return None
            return unpack_model(pack_model(self._allowed(layers), self._axes), self._axes, self._stiffest)
        except Exception as error:  # a user's scene may raise anything; its forces are served all the same
            self.account.unusable += 1
            self.account.fault = in_words(error)
            return None

    def _allowed(self, layers: Sequence[LayerAhead]) -> list[LayerAhead]:
        """Leave out what would be too stiff together with the layers before it, and the last if there are many."""
        allowed: list[LayerAhead] = []
        total = 0.0
        for layer in layers:
            if total + layer.stiffest_n_per_m > self._stiffest:  # NaN is refused later
                self.account.left_out += 1
                self.account.fault = "left out: " + too_stiff([*allowed, layer], self._stiffest)
            elif len(allowed) < MOST_LAYERS:
                total += layer.stiffest_n_per_m
                allowed.append(layer)
        return allowed

    def _send_model(self, t_us: int, stimulus: Vector, position: Vector) -> bytes | None:
        """Return the payload of what the scene announces, if that is right now."""
        layers = self._layers()
        if layers is None:
            return None
        if not self._agrees(ContactModel(layers, t_us, position, self._before).force_n, stimulus, AGREEMENT):
            return None
        return self._sent_model(pack_model(layers, self._axes), t_us, position)

    def _sent_model(self, payload: bytes, t_us: int, position: Vector) -> bytes:
        layers = unpack_model(payload, self._axes, self._stiffest)
        self._model = ContactModel(layers, t_us, position, self._before)
        self._sent_us = t_us
        self._refresh = False
        self.account.models += 1
        return payload

    def _send_codec(self, t_us: int, stimulus: Vector, position: Vector | None) -> bytes | None:
        """Return what the codec sends; after a model, an update that needs no earlier one."""
        if self._refresh or self._model is not None:
            self._inner.refresh()
        payload = self._inner.encode(t_us, stimulus, position)
        self._refresh = False
        return None if payload is None else OF_CODEC + payload


class Announcing(NamedTuple):
    """What the slave of a session with announcements uses: the encoder, and a mirror of the master's decoder."""

    encoder: AnnouncingEncoder
    mirror: AnnouncedDecoder

    def step(self, t_us: int, position: Vector, state: int | None) -> None:
        """Step the model as the scene was; `state` is what the master says of its own at this position, if it does."""
        self.encoder.step(t_us, position, state)
        self.mirror.move(t_us, position, state)


def announcing(encoder: Encoder, decoder: Decoder, law: WeberLaw, scene: Touchable, rate_hz: float) -> Announcing:
    """Return encoder and decoder of a session whose scene announces what is ahead of it."""
    stiffest_n_per_m = stiffest_at(rate_hz)
    look_ahead = look_ahead_of(scene) or (lambda: None)
    return Announcing(
        AnnouncingEncoder(encoder, law, scene.axes, look_ahead, stiffest_n_per_m),
        AnnouncedDecoder(decoder, scene.axes, stiffest_n_per_m),
    )


def _covers(held: LayerAhead, layer: LayerAhead, position: Vector, tolerance_n: float) -> bool:
    """Return whether a layer is held already, as exactly as it matters: a far surface may be somewhere else."""
    placed = held._replace(
        surface_m=layer.surface_m, normal=layer.normal, raised_m=layer.raised_m, shaft_n=layer.shaft_n
    )
    if placed != layer:
        return False
    depth_m = layer.depth_m(position)
    allowed_m = max(tolerance_n / layer.stiffness_n_per_m, -FAR * depth_m)
    return abs(held.depth_m(position) - depth_m) <= allowed_m
