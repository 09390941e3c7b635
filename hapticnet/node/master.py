"""The master: streams the operator's position, holds the last force, and drives the fingertip device with it."""

from collections import deque
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.codec.registry import codec_parameters, make_codec
from hapticnet.codec.schemes.raw import Raw
from hapticnet.control.force import ForceControlSettings
from hapticnet.control.hold import Hold, HoldSettings
from hapticnet.control.limits import LimitSettings
from hapticnet.device.base import Device
from hapticnet.errors import PeerError, in_words
from hapticnet.measure.metrics import RunningError
from hapticnet.node.fingertip import Fingertip, FingertipEvent
from hapticnet.node.recording import MASTER_COLUMNS, Recording
from hapticnet.operator.base import Operator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.events import (
    Connected,
    Ended,
    ForceArrived,
    Hinted,
    HoldConfirmed,
    LinkRecovered,
    LinkStale,
    MasterEvent,
    Refused,
    SessionLost,
)
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import NAME_BYTES, Code, Request, clipped
from hapticnet.protocol.settings import Entropy, SessionSettings
from hapticnet.protocol.stats import Distribution

if TYPE_CHECKING:
    from hapticnet.samples import Vector

FASTEST_HZ: Final = 100_000.0


@dataclass(frozen=True, slots=True)
class Failed:
    """Operator, codec or device raised an exception: the force goes to zero and the session is closed."""

    reason: str


NodeEvent: TypeAlias = (
    Connected | LinkStale | LinkRecovered | SessionLost | Refused | Hinted | Failed | Ended | FingertipEvent
)
"""Events that a master reports; forces and confirmations stay inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterSettings:
    """What a master asks for, and how it applies the forces it receives.

    Attributes
    ----------
    codec, parameters, law
        The feedback codec, its own parameters, and the JND of the person at this master.
    rate_hz
        Positions per second to ask for; the slave may grant less.
    name
        Name of this master in the slave's report.
    key
        This master's key and the slave's public key; None for an open session.
    record
        Whether every tick is recorded.
    """

    codec: str = "deadband"
    parameters: dict[str, float] = field(default_factory=dict)
    law: WeberLaw = field(default_factory=WeberLaw)
    rate_hz: float = 1000.0
    name: str = "master"
    key: MasterKey | None = None
    record: bool = False
    session: SessionSettings = field(default_factory=SessionSettings)
    hold: HoldSettings = field(default_factory=HoldSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    control: ForceControlSettings = field(default_factory=ForceControlSettings)

    def __post_init__(self) -> None:
        check_parameter("rate", self.rate_hz, self.session.slowest_hz, FASTEST_HZ, "Hz")


class MasterNode:
    """One operator, one session, one device.

    Parameters
    ----------
    device
        The fingertip device, or None to run without one.
    rng
        Source of nonces.
    """

    def __init__(self, operator: Operator, device: Device | None, settings: MasterSettings, rng: Entropy) -> None:
        self.settings = settings
        self.period_us = round(1e6 / settings.rate_hz)
        self.ticks = 0
        self.end_reason: str | None = None
        self.refused = False
        self.failure: str | None = None
        self.recording = Recording(MASTER_COLUMNS) if settings.record else None
        self._operator = operator
        self._codec = make_codec(settings.codec, settings.law, settings.parameters)
        request = Request(
            codec=settings.codec,
            parameters=codec_parameters(self._codec),
            **asdict(settings.law),
            rate_hz=settings.rate_hz,
            axes=operator.axes,
            name=clipped(settings.name, NAME_BYTES),
        )
        self.session = MasterSession(request, settings.session, rng, settings.key)
        self._positions = Raw().encoder(operator.axes)
        self._decoder = self._codec.decoder(operator.axes)
        self._hold = Hold(settings.hold, axes=operator.axes)
        self._fingertip = Fingertip(device, settings.limits, settings.control) if device is not None else None
        self._script_start_us: int | None = None
        self._at_m: Vector | None = None
        self._heard_us: int | None = None  # when the newest force arrived, on the master's clock
        self._heard_t_us = 0  # and its time stamp
        self._valid_t_us = 0  # time of the newest position for which what is applied is known to be right
        self._age = Distribution()
        self._felt = (0.0, 0.0, 0.0, 0.0)
        self._connections = 0
        self._tracking = RunningError(settings.law)
        self._scene: str | None = None
        self._events: deque[NodeEvent] = deque()

    @property
    def connected(self) -> bool:
        """Whether there has been a session."""
        return self._connections > 0

    @property
    def finished(self) -> bool:
        """Whether the session is over; `end_reason` gives the reason, `refused` whether it never began."""
        return self.end_reason is not None

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Process a datagram from the slave. Never raises."""
        self.session.receive_datagram(data, now_us)
        self._digest_events(now_us)

    def tick(self, now_us: int) -> None:
        """Send the operator's position. Call `drive` before it in the same tick, so that nothing delays the answer."""
        self.ticks += 1
        self.session.tick(now_us)
        self._digest_events(now_us)
        if self._script_start_us is not None and self.session.streaming:
            try:
                sample = self._operator.sample(now_us - self._script_start_us)
                payload = self._positions.encode(now_us, sample.position_m)
            except Exception as error:  # a user's operator may raise anything
                self._fail(f"the operator failed: {in_words(error)}", now_us)
                return
            self._at_m = sample.position_m
            if payload is not None:
                self.session.send_position(now_us, payload)
        if self.recording is not None:
            self.recording.add((now_us, self._at_m[0] if self._at_m else 0.0, *self._felt))

    def drive(self, now_us: int) -> None:
        """Move the device one step toward the held force."""
        if self._heard_us is not None and self.failure is None:
            # The time of the newest position whose answer could have arrived by now. A prediction for that time is
            # not contradicted; the answer to the next position comes within this period.
            at_us = self._heard_t_us + max(0, now_us - self._heard_us - self.period_us)
            try:
                self._hold.follow(self._decoder.reconstruct(at_us, self._at_m))
            except Exception as error:  # a user's codec may raise anything
                self._fail(f"the codec failed: {in_words(error)}", now_us)
            if not self._hold.is_released(now_us):
                self._age.add(now_us - self._valid_t_us)
        held_n = self.held_force_n(now_us)
        fingertip = self._fingertip
        if fingertip is None:
            if self.recording is not None:
                self._felt = held_n, 0.0, 0.0, 0.0
            return
        try:
            fingertip.press(held_n, now_us)
        except Exception as error:  # what drives a device may raise anything; it is asked for no force from now on
            self._fail(f"the device failed: {in_words(error)}", now_us)
            return
        if self.connected and fingertip.reading is not None:
            self._tracking.add((fingertip.target_n,), (fingertip.sensed_n,))
        if self.recording is not None:
            self._felt = held_n, fingertip.target_n, fingertip.sensed_n, fingertip.displacement_m

    def close(self, reason: str, now_us: int) -> None:
        """End the session; `finished` turns true once the slave has answered or the tries are used up."""
        self.session.close(reason, now_us)
        self._digest_events(now_us)

    def held_force_n(self, now_us: int) -> float:
        """Return the force being held [N]: decayed where the link is stale, 0 after a failure."""
        return 0.0 if self.failure is not None else self._hold.value(now_us)[0]

    def datagrams_to_send(self) -> list[bytes]:
        """Return the datagrams to send to the slave now."""
        return self.session.datagrams_to_send()

    def next_event(self) -> NodeEvent | None:
        """Return the next event, or None."""
        if self._fingertip is not None and (event := self._fingertip.next_event()) is not None:
            return event
        return self._events.popleft() if self._events else None

    def report(self) -> dict[str, Any]:
        """Return the account of this master for JSON."""
        tracking = self._tracking.report() if self._tracking.samples else None
        return {
            "master": self.settings.name,
            "scene": self._scene,
            "codec": self._codec.name,
            "parameters": codec_parameters(self._codec),
            **asdict(self.settings.law),
            "rate_hz": 1e6 / self.period_us,
            "ticks": self.ticks,
            "sealed": self.session.sealed,
            "connections": self._connections,
            "device": self._fingertip.report() if self._fingertip else None,
            "tracking_rmse_n": tracking.rmse_n if tracking else None,
            "tracking_max_n": tracking.max_error_n if tracking else None,
            "round_trip": self.session.round_trip.report(),
            "age_of_applied_force": self._age.report(),
            "sent": self.session.sent.report(),
            "received": self.session.received.report(),
        }

    def _fail(self, reason: str, now_us: int) -> None:
        if self.failure is None:
            self.failure = reason
            self._events.append(Failed(reason))
            self.close(reason, now_us)

    def _digest_events(self, now_us: int) -> None:
        while (event := self.session.next_event()) is not None:
            self._digest(event, now_us)

    def _digest(self, event: MasterEvent, now_us: int) -> None:
        if isinstance(event, ForceArrived):
            try:
                self._decoder.decode(event.t_us, event.payload)
                force_n = self._decoder.reconstruct(event.t_us, self._at_m)
                self._hold.receive(force_n, now_us)
            except PeerError:
                self.session.payload_was_malformed()
            except Exception as error:  # a user's codec may raise anything
                self._fail(f"the codec failed: {in_words(error)}", now_us)
            else:
                self.session.applied(event)
                self._heard_us, self._heard_t_us = now_us, event.t_us
                self._valid_t_us = event.t_us
            return
        if isinstance(event, HoldConfirmed):
            if self._heard_us is None:  # what is held is of an earlier session, and nobody confirms that
                return
            self._hold.confirm(now_us)
            self._valid_t_us = event.t_us
            return
        if isinstance(event, Connected):
            self._connections += 1
            self._scene = event.grant.scene
            rate_hz = max(self.settings.session.slowest_hz, min(self.settings.rate_hz, event.grant.rate_hz))
            self.period_us = round(1e6 / rate_hz)
            self._decoder = self._codec.decoder(self._operator.axes)
            self._heard_us = None
            self._hold.restart()
            if self._script_start_us is None:
                self._script_start_us = now_us
        elif isinstance(event, Ended):
            self.end_reason, self.refused = event.reason, event.refused
            if event.code is Code.FAILED and not event.refused:
                self.failure = event.reason
        self._events.append(event)
