"""One master's place at the slave: session, scene, codec and account."""

from collections.abc import Hashable
from dataclasses import asdict
from typing import Any

from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters
from hapticnet.codec.schemes.raw import Raw
from hapticnet.errors import HapticnetError, PeerError, SampleError, in_words
from hapticnet.measure.metrics import RunningError
from hapticnet.node.recording import SLAVE_COLUMNS, Recording
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import Datagram, Kind
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene


class SceneFailedError(HapticnetError):
    """The scene or the codec raised an exception, so there is no force to send."""


class Station:
    """Pass a position through decoder, scene and encoder as soon as it arrives."""

    def __init__(
        self, session: SlaveSession, address: Hashable, scene: Scene, codec: Codec, *, record: bool, now_us: int
    ) -> None:
        self.session = session
        self.address = address
        self.scene = scene
        self.codec = codec
        self.steps = 0
        self.recording = Recording(SLAVE_COLUMNS) if record else None
        self._opened_us = now_us
        self._stepped_us = now_us
        self._positions = Raw().decoder(scene.axes)
        self._encoder = codec.encoder(scene.axes)
        # A decoder of what is sent: it holds what the master holds if nothing is lost.
        self._mirror = codec.decoder(scene.axes)
        self._error = RunningError(codec.law)

    def receive(self, datagram: Datagram, size: int, now_us: int) -> bytes | None:
        """Process a datagram of this session and return the answer, if any.

        Raises
        ------
        PeerError
            If its body is malformed; the caller counts it.
        SceneFailedError
            If the scene or the codec raises.
        """
        position = self.session.receive(datagram, size, now_us)
        if position is None:
            return None
        t_us = position.t_us
        try:
            self._positions.decode(t_us, position.payload)
            sample = PositionSample(t_us, self._positions.reconstruct(t_us))
            force = self.scene.step(sample)
        except (PeerError, SampleError):  # counted as a datagram already, so not by `add_malformed`
            self.session.received.malformed += 1
            return None
        except Exception as error:  # a user's scene may raise anything
            self.steps += 1
            raise SceneFailedError(f"the scene failed: {in_words(error)}") from error
        answer = None
        if self.session.expire_update(now_us):
            self._encoder.refresh()
        try:
            payload = self._encoder.encode(t_us, force.force_n, sample.position_m)
            if payload is not None and self.session.recovering:
                self._encoder.refresh()  # so that this payload builds on no earlier one
                payload = self._encoder.encode(t_us, force.force_n, sample.position_m)
            if payload is not None:
                self._mirror.decode(t_us, payload)
            held_n = self._mirror.reconstruct(t_us, sample.position_m)
        except Exception as error:  # a force that is not finite, or a user's codec
            self.steps += 1
            raise SceneFailedError(f"the force cannot be encoded: {in_words(error)}") from error
        if payload is not None:
            answer = self.session.force(t_us, payload, now_us)
        self._error.add(force.force_n, held_n)
        self.steps += 1
        self._stepped_us = now_us
        if answer is None and self.session.keepalive_is_due(now_us):
            answer = self.session.keepalive(t_us, now_us)
        if self.recording is not None:
            first_axis = sample.position_m[0], force.force_n[0], held_n[0]
            self.recording.add((t_us, *first_axis, payload is not None, len(answer or b""), self.scene.breaches))
        return answer

    def report(self) -> dict[str, Any]:
        """Return the account of this session for JSON."""
        forces = self.session.sent.by_kind[Kind.FORCE]
        return {
            "session": self.session.number,
            "master": self.session.hello.name,
            "scene": self.scene.name,
            "codec": self.codec.name,
            "parameters": codec_parameters(self.codec),
            **asdict(self.codec.law),
            "state": self.session.state.value,
            "end_reason": self.session.end_reason,
            "duration_s": (self._stepped_us - self._opened_us) / 1e6,
            "steps": self.steps,
            "breaches": self.scene.breaches,
            "packet_rate_reduction": 1.0 - forces / self.steps if self.steps else None,
            **asdict(self._error.report()),
            "sent": self.session.sent.report(),
            "received": self.session.received.report(),
        }
