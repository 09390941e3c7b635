"""The master: streams the operator's position, holds the last force, and drives the fingertip device with it."""

from collections import deque
from typing import Any

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec
from hapticnet.device.base import Device
from hapticnet.device.user import UserActuator, UserDevice
from hapticnet.device.voice_coil import VoiceCoil
from hapticnet.errors import PeerError, SampleError, in_words
from hapticnet.node.applied import Applied, AppliedForce
from hapticnet.node.coupled import CouplingFailedError, MasterCoupling
from hapticnet.node.events import Failed, InForce, NodeEvent, Paused, Resumed, SettingsInForce
from hapticnet.node.fingertip import Fingertip, Rendering
from hapticnet.node.positions import Forward
from hapticnet.node.procedures import FirstTouch
from hapticnet.node.recording import DATAGRAM_COLUMNS, IN, OUT, Recording, frame_kind, master_columns
from hapticnet.node.settings import MasterSettings
from hapticnet.node.step_times import NOT_TIMED, Clock, StepTimes, no_wait
from hapticnet.node.vibration import VibrationPlayer
from hapticnet.operator.base import Operator, operator_parts
from hapticnet.operator.mapping import Mapped, mapped
from hapticnet.parts import PartsLaw, law_numbers, with_numbers
from hapticnet.perception import WeberLaw
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Code, Grant, Request
from hapticnet.protocol.settings import Entropy
from hapticnet.protocol.states import (
    BoundArrived,
    ChangeRefused,
    Connected,
    Ended,
    ForceArrived,
    HoldConfirmed,
    MasterEvent,
    MasterState,
    Noticed,
    VibrationArrived,
)
from hapticnet.samples import Vector, checked_vector
from hapticnet.scene.shapes import Shape, unpack_shapes


class MasterNode:
    """One operator, one session, one device.

    `device`: the fingertip device, or None to run without one. A `Fingertip` keeps its knowledge of the finger;
    it is only passed on.
    `clock`: times the steps of operator, device and a user's codec; None: they are not timed.
    """

    def __init__(
        self,
        operator: Operator,
        device: Device | UserActuator | Fingertip | None,
        settings: MasterSettings,
        rng: Entropy,
        clock: Clock | None = None,
    ) -> None:
        self.settings = settings
        operator = mapped(operator, settings.mapping)
        self.mapped = operator if isinstance(operator, Mapped) else None  # what maps the hand, if anything does
        self.axes = operator.axes
        self._operator = operator
        self.times = StepTimes(clock)  # the times of steps of operator, device and a user's codec
        self.shapes: dict[int, Shape] = {}  # how the scene looks, as far as it is known, by place
        self.notices: dict[Code, str] = {}  # notices of slaves about the sessions, the newest of each code
        # time [µs] between two positions, as the slave has granted it; each is sent in the tick nearest to its time
        self.position_period_us = round(1e6 / settings.rate_hz)
        self.ticks = 0
        self.positions_due = 0  # number of ticks so far in which a position was due
        self.end_reason: str | None = None
        self.refused = False
        self.failure: str | None = None
        self.paused: str | None = None  # why the operator is paused; None if it is not
        self.parts = operator_parts(operator)
        columns = master_columns(operator.axes, self.parts)
        self.recording = Recording(columns) if settings.record else None  # rows of ticks
        self.datagrams = Recording(DATAGRAM_COLUMNS) if settings.record_datagrams else None
        self._feel: Any = getattr(operator, "feel", None)
        law = settings.mapping.asked(settings.law)
        law = PartsLaw.of(self.parts, law, settings.part_laws) if self.parts else law
        self._codec = self._next_codec = make_codec(settings.codec, law, settings.parameters)
        # of the first part, which is what a device renders and a page shows
        self.first_axes = self.parts[0].axes if self.parts else operator.axes
        self._rendering = Rendering(device, settings, self.first_axes)
        self.vibration: VibrationPlayer | None = None  # what is played; None if it is not asked for
        if settings.vibration:
            shaker = device if isinstance(device, UserDevice | UserActuator) and device.shakes else VoiceCoil()
            self.vibration = VibrationPlayer(shaker, settings.vibration_threshold, record=settings.record)
        # time [µs] between two ticks. No slave may slow the force loop down: its limits hold for the device's rate.
        self.period_us = round(1e6 / max(settings.rate_hz, self._rendering.least_rate_hz))
        device_n = self._rendering.largest_n / settings.mapping.force_scale
        self._coupling = MasterCoupling(settings, law, operator, self.period_us, device_n)
        self.session = MasterSession(self._request(self._codec), settings.session, rng, settings.key)
        self._forward = Forward(self.session, law, operator.axes)
        self._applied = AppliedForce(self._codec, settings.hold, operator.axes)
        self.age = self._applied.age  # age [µs] of the force that is applied, in each tick
        self._operator_time = self.times.of(getattr(operator, "what", "the operator"))
        self._device_time = self.times.of(self._rendering.what)
        self._vibration_time = self.times.of("vibration") if settings.vibration else NOT_TIMED
        self._codec_time = self.times.of_codec(self._codec)
        fingertip = self._rendering.with_loop
        # largest force [N] requested from the device; None without one that renders forces by a force loop
        self.largest_n: float | None = fingertip.largest_n if fingertip is not None else None
        # No lead on a coupled force, because the future coupling is unknown.
        leads = not (self._coupling.limits or self.parts)
        self._lead_us = fingertip.lead_us if fingertip is not None and leads else None
        self.adaptations = self._rendering.adaptations(getattr(operator, "capabilities", None), settings)
        if self.mapped is not None and self.mapped.adaptation is not None:
            self.adaptations.append(self.mapped.adaptation)
        self._first_touch = FirstTouch(fingertip) if settings.first_touch and fingertip is not None else None
        self._script_start_us: int | None = None
        self.position_m: Vector | None = None  # position [m] of the newest tick; None before there is a session
        self._zero_n: Vector = (0.0,) * operator.axes
        self.held_n = self._ahead_n = self._zero_n  # held force: decayed, or zero after a failure
        self.target_n = self.sensed_n = self.displacement_m = 0.0  # of the device
        self.connections = 0  # number of sessions so far
        self.scene_name: str | None = None  # the slave's name for the scene; None before there is a session
        self.in_force = InForce()  # settings in force, and their history
        self._granted: SettingsInForce | None = None
        self._events: deque[NodeEvent] = deque()
        self._ticked_us = 0

    @property
    def felt_n(self) -> Vector:
        """The held force [N] as it is felt in the hand, in its frame."""
        return self.held_n if self.mapped is None else self.mapped.to_hand(self.held_n)

    @property
    def codec(self) -> Codec:
        """The codec in use, or last requested with `change`."""
        return self._next_codec

    @property
    def received_n(self) -> Vector:
        """Force [N] of all axes as the decoder reconstructs it."""
        return self._applied.received_n

    @property
    def on_model(self) -> bool:
        """Whether the force is that of a model that the slave has announced."""
        return self._applied.on_model

    @property
    def device_status(self) -> str | None:
        """State of the device and of its force loop in words; None without a device."""
        return self._rendering.fingertip.status if self._rendering.fingertip is not None else None

    @property
    def connected(self) -> bool:
        """Whether there has been a session."""
        return self.connections > 0

    @property
    def finished(self) -> bool:
        """Whether the session is over; `end_reason` gives the reason, `refused` whether it never began."""
        return self.end_reason is not None

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        """Process a datagram from the slave. Never raises."""
        if self.datagrams is not None:
            self.datagrams.add((now_us, IN, frame_kind(data), len(data)))
        self.session.receive_datagram(data, now_us)
        if self.session.events:
            self._digest_events(now_us)

    def tick(self, now_us: int) -> None:
        """Send the operator's position. Then send the pending datagrams, and call `drive`."""
        self.ticks += 1
        self._ticked_us = now_us
        if self._first_touch is not None:
            return
        session = self.session
        session.tick(now_us)
        if session.events:
            self._digest_events(now_us)
        is_due = not session.streaming or self._forward.is_due(now_us, self.position_period_us, self.period_us)
        self.positions_due += is_due
        if not session.streaming:
            self._let_feel(self.held_n, now_us)
            return
        if self.paused is None:
            self._ask_operator(now_us)
        if self.position_m is not None:
            state = self._applied.move(now_us, self.position_m)
            self._note(self._applied.caught_up(now_us), now_us)
            if is_due:
                self._send(self.position_m, state, now_us)

    def _send(self, position_m: Vector, state: int | None, now_us: int) -> None:
        """Send the position of a tick, if the slave needs it; `state` is that of an announced model."""
        applied, forward = self._applied, self._forward
        try:
            if not forward.is_sparse:
                forward.send_every(now_us, position_m, state, self._coupling.outgoing(position_m, now_us))
                return
            difference = applied.difference(now_us, self.position_period_us, position_m)
            place_m = forward.send(now_us, position_m, applied.received_n, state, difference)
            applied.follow(now_us, self.position_period_us, place_m)
        except Exception as error:  # a user's codec or coupling may raise anything
            self._fail("the codec", error, now_us)

    def check(self, now_us: int, waited_us: Clock = no_wait) -> None:
        """Check a few times a second that operator, device and codec keep up; `waited_us`: see `StepTimes.check`."""
        self._events.extend(self.times.check(now_us, waited_us) or ())
        if self.failure is None:
            self._events.extend(self._coupling.check(now_us))

    def drive(self, now_us: int) -> None:
        """Hold the force of the present position, move the device one step toward it, and record the tick."""
        if self._first_touch is None:
            self._codec_time.begin()
            self._apply(now_us)
            self._codec_time.end(self.period_us)
        try:
            if self._first_touch is not None:
                if (outcome := self._first_touch.outcome(now_us)) is not None:
                    self._first_touch = None
                    self._events.append(outcome)
                return
            if self._rendering.fingertip is not None:
                self._press(now_us)
            if self.vibration is not None and self.failure is None:
                self._shake(self.vibration, now_us)
        except Exception as error:  # device code may raise anything; from now on no force is requested
            self._fail("the device", error, now_us)
        if self.recording is not None:
            at_m = self.position_m or self._zero_n
            felt = self.target_n, self.sensed_n, self.displacement_m
            self.recording.add((now_us, *at_m, *self.received_n, *self.held_n, *felt))

    def _apply(self, now_us: int) -> None:
        """Decode the force of the present position, let the coupling limit it, and hold it."""
        if self.failure is None:
            try:
                self._applied.advance(now_us, self.position_period_us, self.position_m)
                self._note_idle()
                held_n = self.held_force_n(now_us)
                if self.position_m is not None:
                    held_n = self._coupling.limit(held_n, self.position_m, now_us, follows=self._applied.follows)
                ahead_n = held_n if self._lead_us is None else self._applied.expected(now_us, self._lead_us)
                self.held_n, self._ahead_n = held_n, ahead_n
                return
            except Exception as error:  # a user's codec or coupling may raise anything
                self._fail("the codec", error, now_us)
        self.held_n = self._ahead_n = self.held_force_n(now_us)

    def _shake(self, vibration: VibrationPlayer, now_us: int) -> None:
        """Play the vibration that is due; none while the link is stale or the operator is paused."""
        self._vibration_time.begin()
        vibration.drive(now_us, mute=self.paused is not None or self.session.state is not MasterState.ESTABLISHED)
        self._vibration_time.end(self.period_us)

    def _take_vibration(self, event: VibrationArrived, now_us: int) -> None:
        if self.vibration is not None:
            try:
                self.vibration.receive(event.t_us, event.payload, event.before, now_us)
            except PeerError:
                self.session.payload_was_malformed()

    def _note_idle(self) -> None:
        """Note whether the applied force is so small that the link may be silent for longer."""
        # Position-following decoders are never idle, because they may produce a force at any tick.
        idle = self._forward.is_idle(self.received_n) and not (self.on_model or self._codec.needs_position)
        self.session.idle = idle
        self._applied.keep(idle and self.session.state is MasterState.ESTABLISHED)

    def _press(self, now_us: int) -> None:
        self._device_time.begin()
        held_n, ahead_n = self.held_n, self._ahead_n
        if self.mapped is not None:
            held_n, same = self.mapped.to_hand(held_n), ahead_n is held_n
            ahead_n = held_n if same else self.mapped.to_hand(ahead_n)
        felt = self._rendering.press(held_n, ahead_n, now_us, counts=self.connections > 0)
        self._device_time.end(self.period_us)
        self.target_n, self.sensed_n, self.displacement_m = felt

    def change(
        self, *, codec: str | None = None, parameters: dict[str, float] | None = None, law: WeberLaw | None = None
    ) -> None:
        """Ask for a session with another codec or JND; the present one continues until the slave grants it.

        The new session continues the scene. `Connected` or `ChangeRefused` follows. Omitted values do not change, but
        another codec starts from its own default parameters. Raise SettingsError if there is no such codec, or a
        parameter is invalid.
        """
        now = self._next_codec
        if parameters is None:
            parameters = codec_parameters(now) if codec is None or codec == now.name else {}
        chosen = make_codec(codec or now.name, now.law if law is None else with_numbers(now.law, law), parameters)
        chosen.decoder(self._operator.axes)  # refuse a codec for fewer axes now
        self._next_codec = chosen
        self.session.change(self._request(chosen))

    def emulate(self, channel_out: str | None, channel_in: str | None) -> None:
        """Set the networks emulated at this end from now on, for recordings and reports."""
        self._events += self.in_force.emulate(channel_out, channel_in, self._ticked_us)

    def resume(self) -> None:
        """Resume the operator after `Paused`; the force rises from zero."""
        if self.paused is not None:
            self._events.append(Resumed())
        self.paused = None

    def close(self, reason: str, now_us: int) -> None:
        """End the session; `finished` turns true once the slave has answered or the tries are used up."""
        self._first_touch = None
        self.session.close(reason, now_us)
        self._digest_events(now_us)

    def held_force_n(self, now_us: int) -> Vector:
        """Return the force being held [N]: decayed where the link is stale, zero after a failure and while paused."""
        if self.failure is not None or self.paused is not None:
            self._applied.release()
            return self._zero_n
        return self._applied.value(now_us)

    def datagrams_to_send(self) -> list[bytes]:
        """Return the datagrams to send to the slave now."""
        outbox = self.session.datagrams_to_send()
        if self.datagrams is not None:
            for data in outbox:
                self.datagrams.add((self._ticked_us, OUT, frame_kind(data), len(data)))
        return outbox

    def next_event(self) -> NodeEvent | None:
        """Return the next event, or None."""
        if (event := self._rendering.next_event()) is not None:
            return event
        return self._events.popleft() if self._events else None

    def report(self) -> dict[str, Any]:
        """Return the report of this master for JSON."""
        return {
            "master": self.settings.name,
            "scene": self.scene_name,
            "codec": self._codec.name,
            "parameters": codec_parameters(self._codec),
            **law_numbers(self._codec.law),
            **({"parts": list(map(str, self.parts))} if self.parts else {}),
            "rate_hz": 1e6 / self.position_period_us,
            "positions": self._forward.report(),
            "in_force": self.in_force.report(),
            "ticks": self.ticks,
            "sealed": self.session.sealed,
            "connections": self.connections,
            **self._rendering.report(),
            **({} if self.vibration is None else {"vibration": self.vibration.report()}),
            "coupling": self._coupling.report(),
            "adaptations": self.adaptations,
            "round_trip": self.session.round_trip.report(),
            "age_of_applied_force": self.age.report(),
            "ticks_on_model": self._applied.ticks_on_model,
            "step_times": self.times.report(),
            "notices": list(self.notices.values()),
            "sent": self.session.sent.report(),
            "received": self.session.received.report(),
        }

    def _request(self, codec: Codec) -> Request:
        return self.settings.request(codec, self.axes, self._coupling.request)

    def _let_feel(self, force_n: Vector, now_us: int) -> None:
        """Let an operator that is not asked for positions feel the force, which decays to zero without a session."""
        if self._feel is None or self._script_start_us is None:
            return
        try:
            self._feel(now_us - self._script_start_us, force_n)
        except Exception as error:  # a user's operator may raise anything
            self._fail("the operator", error, now_us)

    def _ask_operator(self, now_us: int) -> None:
        """Let the operator feel the held force, and ask it for its position."""
        self._operator_time.begin()
        t_us = now_us - (self._script_start_us or 0)
        try:
            if self._feel is not None:
                self._feel(t_us, self.held_n)
            position_m = checked_vector(self._operator.sample(t_us).position_m, "position")
            if len(position_m) != self.axes:
                raise SampleError(f"position has {axes_of(len(position_m))}; the operator has {self.axes}")
        except Exception as error:  # a user's operator may raise anything
            if self.settings.on_error == "end":
                self._fail("the operator", error, now_us)
            else:
                self.paused = f"the operator failed: {in_words(error)}"
                self._events.append(Paused(self.paused))
        else:
            self.position_m = position_m
            self._operator_time.end(self.period_us)

    def _fail(self, what: str, error: Exception, now_us: int) -> None:
        """End the session, because some code has raised an error."""
        if self.failure is None:
            failed_itself = isinstance(error, CouplingFailedError)
            self.failure = reason = str(error) if failed_itself else f"{what} failed: {in_words(error)}"
            self._events.append(Failed(reason))
            self.close(reason, now_us)

    def _note(self, applied: Applied | None, now_us: int) -> None:
        """Acknowledge a newly applied force."""
        if applied is None:
            return
        self.session.applied(applied.event)
        if applied.begins:
            self._switch(now_us)

    def _switch(self, now_us: int) -> None:
        """Note that the forces of the newest session are applied from now on."""
        self._coupling.switch()
        if self._granted is not None:
            self._events += self.in_force.begin(self._granted, now_us)

    def _digest_events(self, now_us: int) -> None:
        while self.session.events:
            self._digest(self.session.events.popleft(), now_us)

    def _digest(self, event: MasterEvent, now_us: int) -> None:
        if isinstance(event, ForceArrived):
            try:
                applied = self._applied.receive(event, now_us)
            except PeerError:
                self.session.payload_was_malformed()
            except Exception as error:  # a user's codec may raise anything
                self._fail("the codec", error, now_us)
            else:
                self._note(applied, now_us)
            return
        if isinstance(event, BoundArrived):
            self._forward.set_bound(event.payload)
            return
        if isinstance(event, VibrationArrived):
            self._take_vibration(event, now_us)
            return
        if isinstance(event, HoldConfirmed):
            self._applied.confirm(event, now_us)
            return
        if isinstance(event, Noticed) and event.shapes is not None:
            try:
                count, shapes = unpack_shapes(event.shapes)
            except PeerError:
                self.session.payload_was_malformed()
            else:
                self.shapes = {place: each for place, each in (self.shapes | shapes).items() if place < count}
            return
        self._events.append(event)
        if isinstance(event, Connected):
            if not event.grant.resumed:
                self.shapes = {}
            self._begin(event.grant, now_us)
        elif isinstance(event, Noticed):
            self.notices[event.code] = event.reason
        elif isinstance(event, ChangeRefused):
            self._next_codec = self._codec
        elif isinstance(event, Ended):
            self.end_reason, self.refused = event.reason, event.refused
            self._let_feel(self._zero_n, now_us)
            if event.code is Code.FAILED and not event.refused:
                self.failure = event.reason

    def _begin(self, grant: Grant, now_us: int) -> None:
        """Begin a session that the slave has granted; the forces of the old one are applied until its first."""
        self.connections += 1
        self.scene_name = grant.scene
        self._codec = codec = self._next_codec
        self._granted = SettingsInForce.of(self._request(codec), grant)
        self.position_period_us = round(1e6 / self._granted.rate_hz)
        self._codec_time = self.times.of_codec(codec)
        try:
            self._coupling.begin(codec.law)
        except CouplingFailedError as error:
            self._fail("the coupling", error, now_us)
            return
        if self._applied.begin(codec, grant, self._coupling):
            self._switch(now_us)
        self._forward.begin(codec.law, grant.position_share)
        if self._script_start_us is None:
            self._script_start_us = now_us
