"""The forces of one session on their way back: encoder, a mirror of the master's decoder, repair and keepalives."""

import math
from typing import Any, Final

from hapticnet.codec.base import Codec, Decoder, Encoder
from hapticnet.codec.plugins import LARGEST_PAYLOAD
from hapticnet.errors import HapticnetError, in_words
from hapticnet.node.announcing import Announcing, announcing
from hapticnet.node.idle import slave_idle_below_n
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.base import Touchable
from hapticnet.vectors import magnitude

RENEW_US: Final = 100_000
"""Shortest time [µs] between two models that are sent because positions were missed."""


class SceneFailedError(HapticnetError):
    """The scene or the codec raised an exception, so there is no force to send."""


class Feedback:
    """What is sent for each force, and what the master holds then.

    Parameters
    ----------
    announced, rate_hz
        Whether the contact ahead is announced, and the rate that was granted.

    Attributes
    ----------
    encoder, mirror
        The encoder, and a decoder of what is sent: it holds what the master holds if nothing is lost.
    held_n
        That force [N] at the newest position that was settled.
    """

    __slots__ = (
        "_announcing",
        "_builds_on_earlier",
        "_codec",
        "_idle_below_n",
        "_longest_us",
        "_missed",
        "_renewed_us",
        "_session",
        "_t_us",
        "encoder",
        "held_n",
        "mirror",
    )

    def __init__(
        self, session: SlaveSession, codec: Codec, scene: Touchable, *, announced: bool, rate_hz: float
    ) -> None:
        self.encoder: Encoder = codec.encoder(scene.axes)
        self.mirror: Decoder = codec.decoder(scene.axes)
        self.held_n: Vector = (0.0,) * scene.axes
        self._session = session
        self._codec = codec
        self._idle_below_n = slave_idle_below_n(codec.law)
        self._missed = False
        self._longest_us = round(1.5e6 / rate_hz)  # longest time between two positions if none is missing
        self._t_us: int | None = None
        self._renewed_us: int | None = None
        self._announcing: Announcing | None = None
        if announced:
            self._announcing = announcing(self.encoder, self.mirror, codec.law, scene, rate_hz)
            self.encoder, self.mirror = self._announcing
        # A user's codec need not say so; completing an update that is complete does no harm.
        self._builds_on_earlier: bool = getattr(codec, "builds_on_earlier", True)

    @property
    def announced(self) -> bool:
        """Whether the contact ahead is announced."""
        return self._announcing is not None

    @property
    def on_model(self) -> bool:
        """Whether the newest update is a model of the contact ahead."""
        return self._announcing is not None and self._announcing.encoder.on_model

    def step(self, sample: PositionSample, told: int | None) -> None:
        """Step the models as the scene was; `told` is the state that the master reports of its own, if it does."""
        if self._announcing is not None:
            self._announcing.step(sample.t_us, sample.position_m, told)

    def answer(self, sample: PositionSample, force_n: Vector, now_us: int) -> tuple[bytes | None, bytes | None]:
        """Return the payload of the update that a force takes, and the datagram to send; None where there is none.

        Raises
        ------
        SceneFailedError
            If the force is not finite, or a user's codec fails.
        """
        session = self._session
        try:
            due = session.repair_is_due(now_us, force_n)
            if self._announcing is None:
                if due:
                    self.encoder.refresh()
            else:
                if self.on_model:
                    # A model is repeated until it has arrived. It then goes on by itself, and is only confirmed.
                    due = due or session.keepalive_is_due(now_us)
                if due and not (self.on_model and session.in_step):
                    self.encoder.refresh()
                self._renew(self._announcing, sample.t_us, now_us)
            payload = self._encode(sample, force_n)
        except Exception as error:
            raise SceneFailedError(f"the force cannot be encoded: {in_words(error)}") from error
        if payload is not None:
            repeated, right = (False, False) if self._announcing is None else self._announcing.encoder.newest
            before = None if right else self.held_n
            return payload, session.force(sample.t_us, payload, now_us, before=before, repeated=repeated)
        if due or session.has_news or self._keepalive_is_due(force_n, now_us):
            return None, session.keepalive(sample.t_us, now_us, held=None if self.on_model else self.held_n)
        return None, None

    def account_sent(self, sample: PositionSample, payload: bytes | None) -> None:
        """Let the mirror take in what was sent for a position.

        Raises
        ------
        SceneFailedError
            If the codec cannot read what it wrote.
        """
        try:
            if payload is not None:
                self.mirror.decode(sample.t_us, payload)
            self.held_n = self.mirror.reconstruct(sample.t_us, sample.position_m)
        except Exception as error:  # a user's codec
            raise SceneFailedError(f"the force cannot be decoded: {in_words(error)}") from error

    def report(self) -> dict[str, Any] | None:
        """Return what became of the announcements, for JSON; None if nothing is announced."""
        return None if self._announcing is None else self._announcing.encoder.account.report()

    def _renew(self, announcing: Announcing, t_us: int, now_us: int) -> None:
        """Send the model again after positions were missed, if its force depends on the way of the tool.

        The master's model has gone that way, this one has not: at rest, nothing else would bring them together.
        """
        before_us, self._t_us = self._t_us, t_us
        self._missed = self._missed or (before_us is not None and t_us - before_us > self._longest_us)
        if not self._missed:
            return
        if not announcing.encoder.rubs:
            self._missed = False
        elif self._renewed_us is None or not 0 <= now_us - self._renewed_us < RENEW_US:
            self._missed, self._renewed_us = False, now_us
            announcing.encoder.renew()

    def _encode(self, sample: PositionSample, force_n: Vector) -> bytes | None:
        payload = self.encoder.encode(sample.t_us, force_n, sample.position_m)
        if payload is not None and self._builds_on_earlier and self._session.complete and not self.on_model:
            self.encoder.refresh()  # so that this payload builds on no earlier one
            payload = self.encoder.encode(sample.t_us, force_n, sample.position_m)
        if payload is not None and len(payload) > LARGEST_PAYLOAD:
            raise ValueError(f"a payload of {len(payload)} bytes; at most {LARGEST_PAYLOAD} fit into a datagram")
        return payload

    def _keepalive_is_due(self, force_n: Vector, now_us: int) -> bool:
        if self._session.spoke_lately(now_us):
            return False
        # What follows the position may make a force before the next answer: confirm it while there is none, too.
        follows = self.on_model or self._codec.needs_position
        felt_n = math.inf if follows else max(magnitude(force_n), magnitude(self.held_n))
        return self._session.keepalive_is_due(now_us, idle=felt_n < self._idle_below_n)
