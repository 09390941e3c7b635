"""The master: streams the operator's position, holds the last force, and drives the fingertip device with it."""

import math
from collections import deque
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import codec_parameters, make_codec, with_share
from hapticnet.control.couplings import Port, parameters_of, parse_coupling
from hapticnet.control.energy_bound import EnergyBound
from hapticnet.device.base import Device
from hapticnet.device.user import UserActuator
from hapticnet.errors import PeerError, SampleError, in_words
from hapticnet.node.applied import Applied, AppliedForce
from hapticnet.node.events import Failed, HeldBack, InForce, NodeEvent, Paused, Resumed, SettingsInForce
from hapticnet.node.fingertip import Fingertip, Rendering
from hapticnet.node.positions import Forward
from hapticnet.node.procedures import FirstTouch
from hapticnet.node.recording import DATAGRAM_COLUMNS, IN, OUT, Recording, frame_kind, master_columns
from hapticnet.node.settings import MasterSettings
from hapticnet.node.step_times import Clock, StepTimes, no_wait
from hapticnet.operator.base import Operator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Code, Request
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
from hapticnet.protocol.stats import Distribution
from hapticnet.samples import Vector, checked_vector
from hapticnet.scene.ahead import stiffest_at
from hapticnet.vectors import magnitude, times

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticnet.control.couplings import MasterEnd


HELD_BACK_EVERY_US: Final = 5_000_000  # after this time [µs] without it, a force that is held back is told again


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
        self._operator = operator
        self.times = StepTimes(clock)  # the times of steps of operator, device and a user's codec
        self.notices: dict[Code, str] = {}  # notices of slaves about the sessions, the newest of each code
        # time [µs] between two positions, as the slave has granted it; each is sent in the tick nearest to its time
        self.position_period_us = round(1e6 / settings.rate_hz)
        self.ticks = 0
        self.positions_due = 0  # number of ticks so far in which a position was due
        self.end_reason: str | None = None
        self.refused = False
        self.failure: str | None = None
        self.paused: str | None = None  # why the operator is paused; None if it is not
        self.recording = Recording(master_columns(operator.axes)) if settings.record else None  # rows of ticks
        self.datagrams = Recording(DATAGRAM_COLUMNS) if settings.record_datagrams else None
        self._feel: Callable[[int, Vector], None] | None = getattr(operator, "feel", None)
        self._coupling = parse_coupling(settings.coupling)
        self._codec = make_codec(settings.codec, settings.law, settings.parameters)
        self._next_codec = self._codec
        self.session = MasterSession(self._request(self._codec), settings.session, rng, settings.key)
        self._forward = Forward(self.session, settings.law, operator.axes)
        self._applied = AppliedForce(self._codec, settings.hold, operator.axes)
        self._rendering = Rendering(device, settings, operator.axes)
        # time [µs] between two ticks. No slave may slow the force loop down: its limits hold for the device's rate.
        self.period_us = round(1e6 / max(settings.rate_hz, self._rendering.least_rate_hz))
        self._operator_time = self.times.of(getattr(operator, "what", "the operator"))
        self._device_time = self.times.of(self._rendering.what)
        self._codec_time = self.times.of_codec(self._codec)
        fingertip = self._rendering.with_loop
        self._largest_n = min(self._rendering.largest_n, getattr(operator, "max_force_n", math.inf))
        self._end = self._next_end = self._new_end(settings.law)  # of the forces that are applied, and of the positions
        self._held_back, self._told_us = 0, -HELD_BACK_EVERY_US
        self._lead_us = fingertip.lead_us if fingertip is not None and self._end is None else None
        self._first_touch = FirstTouch(fingertip) if settings.first_touch and fingertip is not None else None
        self._script_start_us: int | None = None
        self.position_m: Vector | None = None  # position [m] of the newest tick; None before there is a session
        self.axes = operator.axes
        self._zero_n: Vector = (0.0,) * operator.axes
        self.held_n = self._ahead_n = self._zero_n  # held force: decayed, or zero after a failure
        self.target_n = self.sensed_n = self.displacement_m = 0.0  # of the device
        self.connections = 0  # number of sessions so far
        self.scene_name: str | None = None  # the slave's name for the scene; None before there is a session
        self.in_force = InForce()  # settings in force, and their history
        self._granted: SettingsInForce | None = None
        self._events: deque[NodeEvent] = deque()
        self._ticked_us = 0
        self._position_due_us = 0

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
    def age(self) -> Distribution:
        """Age [µs] of the force that is applied, in each tick."""
        return self._applied.age

    @property
    def largest_n(self) -> float | None:
        """Largest force [N] requested from the device; None without one that renders forces by a force loop."""
        return self._rendering.with_loop.largest_n if self._rendering.with_loop is not None else None

    def _new_end(self, law: WeberLaw) -> "MasterEnd | None":
        of = self._operator
        applied_n = (lambda: of.applied_n) if hasattr(of, "applied_n") else None
        scale = getattr(of, "scale", 1.0)
        return self._coupling.master(Port(of.axes, law, self.period_us, self._largest_n, scale, applied_n))

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
        is_due = not session.streaming or self._position_is_due(now_us)
        self.positions_due += is_due
        if self._script_start_us is not None and not session.streaming and self._feel is not None:
            self._let_feel(self._feel, now_us)
        if self._script_start_us is not None and session.streaming:
            if self.paused is None:
                self._ask_operator(now_us - self._script_start_us, now_us)
            if self.position_m is not None:
                state = self._applied.move(now_us, self.position_m)
                self._note(self._applied.caught_up(now_us), now_us)
                if is_due:
                    self._send(self.position_m, state, now_us)

    def _position_is_due(self, now_us: int) -> bool:
        """Return whether this tick is the one nearest to the time at which the next position is due."""
        if self.position_period_us <= self.period_us:
            return True
        wait_us = self._position_due_us - now_us
        if 2 * wait_us > self.period_us and wait_us <= self.position_period_us:
            return False
        # After missed ticks or a clock that jumped, the positions continue from now.
        kept = abs(wait_us) <= self.position_period_us
        self._position_due_us = (self._position_due_us if kept else now_us) + self.position_period_us
        return True

    def _send(self, position_m: Vector, state: int | None, now_us: int) -> None:
        """Send the position of a tick, if the slave needs it; `state` is that of an announced model."""
        applied, forward = self._applied, self._forward
        try:
            if not forward.is_sparse:
                data = self._next_end.outgoing(position_m, now_us) if self._next_end is not None else b""
                forward.send_every(now_us, position_m, state, data)
                return
            difference = applied.difference(now_us, self.position_period_us, position_m)
            place_m = forward.send(now_us, position_m, applied.received_n, state, difference)
            applied.follow(now_us, self.position_period_us, place_m)
        except Exception as error:  # a user's codec or coupling may raise anything
            self._fail(f"the codec or the coupling failed: {in_words(error)}", now_us)

    def check(self, now_us: int, waited_us: Clock = no_wait) -> None:
        """Check a few times a second that operator, device and codec keep up; `waited_us`: see `StepTimes.check`."""
        self._events.extend(self.times.check(now_us, waited_us) or ())
        if self._end is not None and self.failure is None:
            since, self._held_back = self._end.held_back - self._held_back, self._end.held_back
            if since and now_us - self._told_us > HELD_BACK_EVERY_US:
                self._events.append(HeldBack())
            self._told_us = now_us if since else self._told_us

    def drive(self, now_us: int) -> None:
        """Hold the force of the present position, move the device one step toward it, and record the tick."""
        if self._first_touch is not None:
            self._touch(self._first_touch, now_us)
            return
        self._codec_time.begin()
        self._apply(now_us)
        self._codec_time.end(self.period_us)
        if self._rendering.fingertip is not None:
            self._press(now_us)
        if self.recording is not None:
            at_m = self.position_m or self._zero_n
            felt = self.target_n, self.sensed_n, self.displacement_m
            self.recording.add((now_us, *at_m, *self.received_n, *self.held_n, *felt))

    def _touch(self, first_touch: FirstTouch, now_us: int) -> None:
        try:
            outcome = first_touch.outcome(now_us)
        except Exception as error:  # device code may raise anything
            self._fail(f"the device failed: {in_words(error)}", now_us)
            return
        if outcome is not None:
            self._first_touch = None
            self._events.append(outcome)

    def _apply(self, now_us: int) -> None:
        if self.failure is None:
            try:
                self._applied.advance(now_us, self.position_period_us, self.position_m)
                self._note_idle()
            except Exception as error:  # a user's codec may raise anything
                self._fail(f"the codec failed: {in_words(error)}", now_us)
        if self.failure is None and self.paused is None:
            held_n = self._applied.value(now_us)
        else:
            held_n = self.held_force_n(now_us)
        if self._end is not None and self.position_m is not None and self.failure is None:
            try:
                limited_n = self._end.limit(held_n, self.position_m, now_us, follows=self._applied.follows)
                held_n = checked_vector(limited_n, "its force")
                if len(held_n) != self.axes:
                    raise SampleError(f"its force has {axes_of(len(held_n))}; the operator has {self.axes}")
                size_n = magnitude(held_n)
                if size_n > self._largest_n:
                    held_n = times(held_n, self._largest_n / size_n)
            except Exception as error:  # a user's coupling may raise anything
                self._fail(f"the coupling failed: {in_words(error)}", now_us)
                held_n = self._zero_n
        self.held_n = self._ahead_n = held_n
        # No lead on a coupled force, because the future coupling is unknown.
        if self._lead_us is not None and self.failure is None:
            try:
                self._ahead_n = self._applied.expected(now_us, self._lead_us)
            except Exception as error:  # a user's codec may raise anything
                self._fail(f"the codec failed: {in_words(error)}", now_us)

    def _note_idle(self) -> None:
        """Note whether the applied force is so small that the link may be silent for longer."""
        # Position-following decoders are never idle, because they may produce a force at any tick.
        idle = self._forward.is_idle(self.received_n) and not (self.on_model or self._codec.needs_position)
        self.session.idle = idle
        self._applied.keep(idle and self.session.state is MasterState.ESTABLISHED)

    def _press(self, now_us: int) -> None:
        self._device_time.begin()
        try:
            felt = self._rendering.press(self.held_n, self._ahead_n, now_us, counts=self.connections > 0)
        except Exception as error:  # device code may raise anything; from now on no force is requested
            self._fail(f"the device failed: {in_words(error)}", now_us)
            return
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
        chosen = make_codec(codec or now.name, law or now.law, parameters)
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
            **asdict(self._codec.law),
            "rate_hz": 1e6 / self.position_period_us,
            "positions": self._forward.report(),
            "in_force": self.in_force.report(),
            "ticks": self.ticks,
            "sealed": self.session.sealed,
            "connections": self.connections,
            **self._rendering.report(),
            "coupling": {"name": self._coupling.name, **self._end_report()},
            "round_trip": self.session.round_trip.report(),
            "age_of_applied_force": self.age.report(),
            "ticks_on_model": self._applied.ticks_on_model,
            "step_times": self.times.report(),
            "notices": list(self.notices.values()),
            "sent": self.session.sent.report(),
            "received": self.session.received.report(),
        }

    def _end_report(self) -> dict[str, Any]:
        try:
            return dict(self._end.report()) if self._end is not None else {}
        except Exception as error:  # a user's coupling may raise anything
            return {"failed": in_words(error)}

    def _request(self, codec: Codec) -> Request:
        return Request(
            codec=codec.name,
            parameters=codec_parameters(codec),
            **asdict(codec.law),
            rate_hz=self.settings.rate_hz,
            axes=self._operator.axes,
            position_share=self.settings.position_share if self.settings.positions == "line" else 0.0,
            name=self.settings.name,
            announced=self.settings.announced,
            predicted=self.settings.predicted,
            coupling=(self._coupling.name, parameters_of(self._coupling)) if self._coupling.two_port else None,
        )

    def _let_feel(self, feel: "Callable[[int, Vector], None]", now_us: int) -> None:
        """Let an operator that is not asked for positions feel the force, which decays to zero without a session."""
        try:
            feel(now_us - (self._script_start_us or now_us), self.held_n)
        except Exception as error:  # a user's operator may raise anything
            self._fail(f"the operator failed: {in_words(error)}", now_us)

    def _ask_operator(self, t_us: int, now_us: int) -> None:
        """Let the operator feel the held force, and ask it for its position."""
        self._operator_time.begin()
        try:
            if self._feel is not None:
                self._feel(t_us, self.held_n)
            position_m = checked_vector(self._operator.sample(t_us).position_m, "position")
            if len(position_m) != len(self._zero_n):
                raise SampleError(f"position has {axes_of(len(position_m))}; the operator has {len(self._zero_n)}")
        except Exception as error:  # a user's operator may raise anything
            reason = f"the operator failed: {in_words(error)}"
            if self.settings.on_error == "end":
                self._fail(reason, now_us)
            else:
                self.paused = reason
                self._events.append(Paused(reason))
        else:
            self.position_m = position_m
            self._operator_time.end(self.period_us)

    def _fail(self, reason: str, now_us: int) -> None:
        if self.failure is None:
            self.failure = reason
            self._events.append(Failed(reason))
            self.close(reason, now_us)

    def _note(self, applied: Applied | None, now_us: int) -> None:
        """Acknowledge a newly applied force."""
        if applied is None:
            return
        self.session.applied(applied.event)
        if applied.begins:  # until then, the forces of the old session belong to its own end
            self._end, self._held_back = self._next_end, 0
        if applied.begins and self._granted is not None:
            self._events += self.in_force.begin(self._granted, now_us)

    def _digest_events(self, now_us: int) -> None:
        events = self.session.events
        while events:
            self._digest(events.popleft(), now_us)

    def _digest(self, event: MasterEvent, now_us: int) -> None:
        if isinstance(event, ForceArrived):
            try:
                applied = self._applied.receive(event, now_us)
            except PeerError:
                self.session.payload_was_malformed()
            except Exception as error:  # a user's codec may raise anything
                self._fail(f"the codec failed: {in_words(error)}", now_us)
            else:
                self._note(applied, now_us)
            return
        if isinstance(event, BoundArrived):
            self._forward.set_bound(event.payload)
            return
        if isinstance(event, VibrationArrived):  # not asked for yet
            return
        if isinstance(event, HoldConfirmed):
            self._applied.confirm(event, now_us)
            return
        self._events.append(event)
        if isinstance(event, Connected):
            self.connections += 1
            self.scene_name = event.grant.scene
            self._granted = SettingsInForce.of(self._request(self._next_codec), event.grant)
            self.position_period_us = round(1e6 / self._granted.rate_hz)
            self._codec = self._next_codec
            self._codec_time = self.times.of_codec(self._codec)
            share = event.grant.position_share
            codec = with_share(self._codec, share) if share else self._codec
            stiffest = stiffest_at(event.grant.rate_hz) if event.grant.announced else None
            if self._coupling.two_port:
                self._next_end = self._new_end(self._codec.law)
            elif isinstance(self._end, EnergyBound):
                self._end.law = self._codec.law
            begins = self._applied.begin(
                codec,
                stiffest,
                on_a_line=share > 0.0,
                predicted=event.grant.predicted,
                end=self._next_end,
                data_bytes=self._coupling.feedback_bytes(self.axes),
            )
            if begins:
                self._end, self._held_back = self._next_end, 0
                self._events += self.in_force.begin(self._granted, now_us)
            self._forward.begin(self._codec.law, share)
            if self._script_start_us is None:
                self._script_start_us = now_us
        elif isinstance(event, Noticed):
            self.notices[event.code] = event.reason
        elif isinstance(event, ChangeRefused):
            self._next_codec = self._codec
        elif isinstance(event, Ended):
            self.end_reason, self.refused = event.reason, event.refused
            if self._feel is not None and self._script_start_us is not None:
                self.held_n = self._zero_n
                self._let_feel(self._feel, now_us)
            if event.code is Code.FAILED and not event.refused:
                self.failure = event.reason
