"""The forces of one session on their way back: encoder, a mirror of the master's decoder, repair and keepalives.

Where the contact ahead is announced, the encoder sends models of it, or the codec's payloads. The master applies what
arrived last. While that is a model, the slave steps the same one, and is silent as long as its force is within
the threshold of the true one. Otherwise, or if other layers are ahead, the slave sends another model, or a payload
of the codec if the scene has no correct model.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from hapticnet.codec.base import Codec, Decoder, Delayed, Encoder
from hapticnet.codec.plugins import LARGEST_PAYLOAD
from hapticnet.errors import HapticnetError, in_words
from hapticnet.node.decoders import OF_CODEC, AnnouncedDecoder, pack_model, unpack_model
from hapticnet.parts import size_function
from hapticnet.perception import WeberLaw
from hapticnet.protocol.settings import slave_idle_below_n
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.ahead import MOST_LAYERS, ContactModel, LayerAhead, LookAhead, stiffest_at, too_stiff
from hapticnet.scene.base import Touchable, look_ahead_of
from hapticnet.vectors import distance, magnitude

LOOK_EVERY_US: Final = 5_000  # interval of asking the scene for the contact ahead while the model is right [µs]
AGREEMENT: Final = 0.5  # largest error of a model that is sent, at its first position, as a share of the threshold
FAR: Final = 0.1
"""Change of an announced surface's place after which it is announced again, as a share of the
distance: a curved surface is a plane that turns."""

FIRST_DOUBT_US: Final = 20_000
LONGEST_DOUBT_US: Final = 6_400_000
"""How long [µs] the codec is used after a model was wrong and the scene had no other: twice as long each time."""

SHORTEST_LIFE_US: Final = 10_000
"""A model that is wrong sooner than this [µs] is not replaced by another one, but by the codec."""

TRUSTED_AFTER: Final = 50
"""Correct samples in contact after which earlier wrong models are forgotten."""


@dataclass(slots=True)
class AnnouncingAccount:
    """Counters of the announcements."""

    models: int = 0  # models sent
    corrections: int = 0  # updates sent because a model was wrong: other models, or payloads of the codec
    unusable: int = 0  # announcements of the scene that break the limits
    left_out: int = 0  # layers omitted, because they are too stiff together with those before them
    on_model: int = 0  # samples at which a model was applied
    fault: str | None = None  # fault of the newest announcement that was not fully usable


class AnnouncingEncoder:
    """A codec's encoder, and the models of a scene. Satisfies `Encoder`."""

    def __init__(
        self, inner: Encoder, law: WeberLaw, axes: int, look_ahead: LookAhead, stiffest_n_per_m: float
    ) -> None:
        self.account = AnnouncingAccount()
        self._inner = inner
        self._law = law
        self._axes = axes
        self._look_ahead = look_ahead
        self._stiffest = stiffest_n_per_m
        self._model: ContactModel | None = None  # the model that the master applies; None: the codec's payload
        self._now: tuple[int, Vector] | None = None
        self._before: tuple[int, Vector] | None = None
        self.predicted: tuple[Vector, Vector] | None = None
        """Position [m] and force [N] that the codec encodes instead of the present ones; None: the present ones."""
        self._refresh = True
        self._repeats = self._was_right = self._renews = False
        self._right = 0
        self._looked_us: int | None = None
        self._doubt_us = FIRST_DOUBT_US
        self._doubted_until_us = -(1 << 62)
        self._sent_us = 0

    @property
    def newest(self) -> tuple[bool, bool]:
        """Whether the newest payload only repeats the previous model, and that update is right."""
        return self._repeats, self._was_right

    @property
    def on_model(self) -> bool:
        """Whether the newest update is a model, which decodes on its own."""
        return self._model is not None

    def refresh(self) -> None:
        """Force the next stimulus to be transmitted."""
        self._refresh = True

    def step(self, t_us: int, position: Vector, state: int | None = None) -> None:
        """Step the model; `state` gives the layers pierced at a master that has the newest update."""
        self._before, self._now = self._now, (t_us, position)
        if self._model is not None:
            self._model.step(t_us, position)
            if state is not None:
                self._model.adopt(state)

    @property
    def rubs(self) -> bool:
        """Whether the force of the model depends on the tool's path, through friction on its shaft."""
        return self._model is not None and any(layer.pierced and layer.friction_n for layer in self._model.layers())

    def renew(self) -> None:
        """Force the next update to be a model, even if the master has the previous one."""
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
            if self._layers() is not None:  # the scene is wrong, unless it currently announces nothing
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
        """Return whether the scene announces layers that the model lacks or has in a different state."""
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
        """Return the scene's announcement as the master decodes it; None if it cannot be announced."""
        try:
            layers = self._look_ahead()
            if layers is None:
                return None
            return unpack_model(pack_model(self._allowed(layers), self._axes), self._axes, self._stiffest)
        except Exception as error:  # a user's scene may raise anything; its forces are still served
            self.account.unusable += 1
            self.account.fault = in_words(error)
            return None

    def _allowed(self, layers: Sequence[LayerAhead]) -> list[LayerAhead]:
        """Omit layers that are too stiff together with those before them, and the last ones if there are too many."""
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
        """Return the payload of the scene's announcement, if that is correct at present."""
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
        """Return the codec's payload; after a model, one that decodes on its own."""
        if self._refresh or self._model is not None:
            self._inner.refresh()
        if self.predicted is not None:
            position, stimulus = self.predicted
        payload = self._inner.encode(t_us, stimulus, position)
        self._refresh = False
        return None if payload is None else OF_CODEC + payload


def _covers(held: LayerAhead, layer: LayerAhead, position: Vector, tolerance_n: float) -> bool:
    """Return whether a layer is already known exactly enough; the place of a far surface may differ."""
    placed = held._replace(
        surface_m=layer.surface_m, normal=layer.normal, raised_m=layer.raised_m, shaft_n=layer.shaft_n
    )
    if placed != layer:
        return False
    depth_m = layer.depth_m(position)
    allowed_m = max(tolerance_n / layer.stiffness_n_per_m, -FAR * depth_m)
    return abs(held.depth_m(position) - depth_m) <= allowed_m


RENEW_US: Final = 100_000  # shortest time [µs] between two models that are sent because positions were missed


class SceneFailedError(HapticnetError):
    """The scene or the codec raised an exception, so there is no force to send."""


class Feedback:
    """The answer to each force, and the stimulus that the master then holds."""

    def __init__(
        self, session: SlaveSession, codec: Codec, scene: Touchable, *, announced: bool, rate_hz: float
    ) -> None:
        self.encoder: Encoder = codec.encoder(scene.axes)  # with a mirror decoder of the sent payloads
        self._delayed = self.encoder if isinstance(self.encoder, Delayed) else None
        self.mirror: Decoder = codec.decoder(scene.axes)
        self.held_n: Vector = (0.0,) * scene.axes  # that force [N] at the newest position that was accounted for
        self._session = session
        self._codec = codec
        self._idle_below_n = slave_idle_below_n(codec.law)
        self._size = size_function(codec.law)
        self.data = b""  # data of a coupling before the next payload
        self._predicted: tuple[Vector, Vector] | None = None
        self._missed = False
        self._longest_us = round(1.5e6 / rate_hz)  # longest time between two positions if none is missing
        self._t_us: int | None = None
        self._renewed_us: int | None = None
        self._announcing: AnnouncingEncoder | None = None
        self._models: AnnouncedDecoder | None = None  # the mirror, where the contact ahead is announced
        if announced:
            stiffest_n_per_m, look_ahead = stiffest_at(rate_hz), look_ahead_of(scene) or (lambda: None)
            self.encoder = self._announcing = AnnouncingEncoder(
                self.encoder, codec.law, scene.axes, look_ahead, stiffest_n_per_m
            )
            self.mirror = self._models = AnnouncedDecoder(self.mirror, scene.axes, stiffest_n_per_m)
        # A user's codec may lack this; completing a complete update does no harm.
        self._builds_on_earlier: bool = getattr(codec, "builds_on_earlier", True)

    @property
    def on_model(self) -> bool:
        """Whether the newest update is a model of the contact ahead."""
        return self._announcing is not None and self._announcing.on_model

    def step(self, sample: PositionSample, state: int | None) -> None:
        """Step the models as the scene was stepped; `state` is the state of the master's model, if it was reported."""
        if self._announcing is not None and self._models is not None:
            self._announcing.step(sample.t_us, sample.position_m, state)
            self._models.move(sample.t_us, sample.position_m, state)

    def answer(
        self, sample: PositionSample, force_n: Vector, now_us: int, predicted: tuple[Vector, Vector] | None
    ) -> tuple[bytes | None, bytes | None]:
        """Return payload and datagram that answer a force, None where there is none; SceneFailedError if that fails.

        `predicted`: position [m] and force [N] that the codec encodes instead. Models continue from the present.
        """
        session = self._session
        self._predicted = predicted
        if predicted is not None and self._announcing is None:
            sample, force_n = PositionSample(sample.t_us, predicted[0]), predicted[1]
        try:
            if self._delayed is not None:  # a force that was predicted is that of the time at which it is applied
                self._delayed.set_round_trip(session.round_trip.us if predicted is None else 0)
            due = session.repair.is_due(now_us, force_n)
            if self._announcing is None:
                if due:
                    self.encoder.refresh()
            else:
                if self.on_model:
                    # A model is repeated until it has arrived. It then runs at the master and is only confirmed.
                    due = due or session.repair.keepalive_is_due(now_us)
                if due and not (self.on_model and session.in_step):
                    self.encoder.refresh()
                self._renew(self._announcing, sample.t_us, now_us)
                self._announcing.predicted = predicted
            payload = self._encode(sample, force_n)
        except Exception as error:
            raise SceneFailedError(f"the force cannot be encoded: {in_words(error)}") from error
        if payload is not None:
            repeated, right = (False, False) if self._announcing is None else self._announcing.newest
            before = None if right else self.held_n
            whole = self.data + payload
            return payload, session.force(sample.t_us, whole, now_us, before=before, repeated=repeated)
        if due or session.has_news or self._keepalive_is_due(force_n, now_us):
            return None, session.keepalive(sample.t_us, now_us, held=None if self.on_model else self.held_n)
        return None, None

    def account_sent(self, sample: PositionSample, payload: bytes | None) -> None:
        """Let the mirror decode the payload sent for a position; SceneFailedError if the codec cannot."""
        position_m = sample.position_m if self._predicted is None else self._predicted[0]
        try:
            if payload is not None:
                self.mirror.decode(sample.t_us, payload)
            self.held_n = self.mirror.reconstruct(sample.t_us, position_m)
        except Exception as error:  # a user's codec
            raise SceneFailedError(f"the force cannot be decoded: {in_words(error)}") from error

    def report(self) -> dict[str, Any] | None:
        """Return the counters of the announcements, for JSON; None if nothing is announced."""
        return None if self._announcing is None else asdict(self._announcing.account)

    def _renew(self, announcing: AnnouncingEncoder, t_us: int, now_us: int) -> None:
        """Send the model again after positions were missed, if its force depends on the tool's path.

        The master's model followed that path and this one did not: at rest, nothing else would reconcile them.
        """
        before_us, self._t_us = self._t_us, t_us
        self._missed = self._missed or (before_us is not None and t_us - before_us > self._longest_us)
        if not self._missed:
            return
        if not announcing.rubs:
            self._missed = False
        elif self._renewed_us is None or not 0 <= now_us - self._renewed_us < RENEW_US:
            self._missed, self._renewed_us = False, now_us
            announcing.renew()

    def _encode(self, sample: PositionSample, force_n: Vector) -> bytes | None:
        payload = self.encoder.encode(sample.t_us, force_n, sample.position_m)
        if payload is not None and self._builds_on_earlier and self._session.repair.complete and not self.on_model:
            self.encoder.refresh()  # so that this payload decodes on its own
            payload = self.encoder.encode(sample.t_us, force_n, sample.position_m)
        if payload is not None and len(payload) > LARGEST_PAYLOAD:
            raise ValueError(f"a payload of {len(payload)} bytes; at most {LARGEST_PAYLOAD} fit into a datagram")
        return payload

    def _keepalive_is_due(self, force_n: Vector, now_us: int) -> bool:
        if self._session.repair.spoke_lately(now_us):
            return False
        # A position-following decoder may produce a force before the next answer: also confirm it at zero force.
        follows = self.on_model or self._codec.needs_position
        felt_n = math.inf if follows else max(self._size(force_n), self._size(self.held_n))
        return self._session.repair.keepalive_is_due(now_us, idle=felt_n < self._idle_below_n)
