"""The force that a master applies: decoded from updates, held in between, with its age.

A change of session is not felt: the forces of the old session are applied until the first of the new one arrives.
"""

from dataclasses import replace
from typing import Any, NamedTuple

from hapticnet.codec.base import Codec, Decoder, Predictive
from hapticnet.codec.positions import Difference
from hapticnet.codec.registry import with_share
from hapticnet.control.hold import HoldSettings, hold_for
from hapticnet.node.coupled import MasterCoupling, catching
from hapticnet.node.decoders import Allowance, AnnouncedDecoder, BoundedDecoder, LineDecoder, receiver
from hapticnet.node.force_predictor import ForcePredictor
from hapticnet.parts import parts_of
from hapticnet.protocol.messages import Grant
from hapticnet.protocol.states import ForceArrived, HoldConfirmed
from hapticnet.protocol.stats import Distribution
from hapticnet.protocol.wire import distance
from hapticnet.samples import Vector
from hapticnet.scene.ahead import stiffest_at


class _Stream:
    """The forces of one session, on their way from a payload to a force."""

    def __init__(
        self, codec: Codec, axes: int, allowance: Allowance, grant: Grant | None, coupling: MasterCoupling | None
    ) -> None:
        self._end: Any = None if coupling is None else coupling.newest
        self._data_bytes = 0 if coupling is None else coupling.feedback_bytes  # of the coupling, before each payload
        share = 0.0 if grant is None else grant.position_share
        predicted = grant is not None and grant.predicted
        stiffest_n_per_m = stiffest_at(grant.rate_hz) if grant is not None and grant.announced else None
        codec = with_share(codec, share) if share else codec
        self._needs_position = codec.needs_position
        # Between lines the slave steps where the hand may not be: what it judges there is bounded in any case.
        period_us = 0 if grant is None else round(1e6 / grant.rate_hz)
        self.decoder: Decoder = receiver(codec, axes, predicted=predicted and not share, period_us=period_us)
        self.announced: AnnouncedDecoder | None = None
        if stiffest_n_per_m is not None:
            self.decoder = self.announced = AnnouncedDecoder(self.decoder, axes, stiffest_n_per_m, allowance)
        self.line_decoder = LineDecoder(codec, axes, stiffest_n_per_m, allowance) if share else None
        self.heard_us: int | None = None  # when the newest force arrived [µs], and its time stamp
        self.heard_t_us = 0
        self._late: list[tuple[int, ForceArrived]] = []  # received models that are not applied yet, with their numbers
        self._asked: Decoder | None = None  # the decoder that was last tested for prediction
        self._predicts = False

    @property
    def on_model(self) -> bool:
        """Whether the force is that of an announced model."""
        return self.announced is not None and self.announced.on_model

    @property
    def rendering(self) -> Decoder:
        """The source of the force: the decoder of the codec, or of the model."""
        return self.decoder if self.announced is None else self.announced.rendering

    @property
    def predicts(self) -> bool:
        """Whether it can predict forces."""
        decoder = self.rendering
        if decoder is not self._asked:  # a slow check
            self._asked, self._predicts = decoder, isinstance(decoder, Predictive)
        return self._predicts

    @property
    def follows(self) -> bool:
        """Whether the force is a function of the newest position, and not of an earlier one."""
        return self.on_model or (self._needs_position and self.predicts)

    def move(self, now_us: int, position_m: Vector) -> int | None:
        """Move the tool; return the pierced layers of an announced model, or None if nothing is announced."""
        if self.announced is None:
            return None
        self.announced.move(now_us, position_m)
        return self.announced.state

    def decode(self, event: ForceArrived) -> bool:
        """Receive a force; return whether it is applied now, or later (`caught_up`), if at all."""
        late = self._late
        if late and distance(event.sequence, late[-1][1].sequence) <= 0:  # overtaken by a model
            return False
        if self._data_bytes:
            data, event = event.payload[: self._data_bytes], replace(event, payload=event.payload[self._data_bytes :])
            if self._end is not None:
                with catching():
                    self._end.incoming(data)
        self.decoder.decode(event.t_us, event.payload)
        if self.line_decoder is not None:
            self.line_decoder.decode(event.t_us, event.payload)
        if self.announced is not None and self.announced.settled != self.announced.taken:
            late[1:] = [(self.announced.taken, event)]  # of the waiting models, only the newest is kept
            return False
        late.clear()
        return True

    def caught_up(self) -> ForceArrived | None:
        """Return the newest force whose model is applied since the last call; None if there is none."""
        newest = None
        while self._late and self.announced is not None and self._late[0][0] <= self.announced.settled:
            newest = self._late.pop(0)[1]
        return newest

    def time_us(self, now_us: int, period_us: int) -> int:
        """Return the time [µs] of the newest position whose answer may have arrived.

        A prediction for that time is not contradicted; the answer to the next position comes within this period.
        """
        if self.heard_us is None:
            return now_us
        late_us = now_us - self.heard_us - period_us
        return self.heard_t_us + late_us if late_us > 0 else self.heard_t_us


class Applied(NamedTuple):
    """A newly applied force, and whether it replaces one of the previous session."""

    event: ForceArrived
    begins: bool


class AppliedForce:
    """The force that is applied: from the newest session with a force, and its hold."""

    def __init__(self, codec: Codec, settings: HoldSettings, axes: int) -> None:
        self.received_n: Vector = (0.0,) * axes  # force [N] of all axes as the decoder reconstructs it
        self.age = Distribution()  # age [µs] of the force that is applied, in each tick
        self.ticks_on_model = 0  # ticks in which the force was that of an announced model
        self._axes = axes
        self._allowance = Allowance()
        self._stream = _Stream(codec, axes, self._allowance, None, None)
        self._next: _Stream | None = None  # the path of a session that has sent no force yet
        self._has_parts = bool(parts_of(codec.law))  # no device moves ahead of them
        self._predictor = ForcePredictor(axes)
        self._hold = hold_for(settings, codec.law, axes)
        self._position_m: Vector | None = None  # of the newest tick, and its time
        self._position_us = 0
        self._at_us = 0  # time for which the decoder was asked last
        # returns the held force [N] at a time [µs], decayed if the link is stale
        self.value = self._hold.value  # bound once, because every tick calls it
        self._valid_t_us = 0  # time of the newest position for which the applied force is known to be right

    @property
    def on_model(self) -> bool:
        """Whether the force is that of an announced model."""
        return self._stream.on_model

    @property
    def follows(self) -> bool:
        """Whether the applied force is a function of the newest position, and not of an earlier one."""
        return self._stream.follows

    def begin(self, codec: Codec, grant: Grant | None = None, coupling: MasterCoupling | None = None) -> bool:
        """Begin a session; the previous one is applied until the first force arrives. Return whether there is none."""
        self._next = _Stream(codec, self._axes, self._allowance, grant, coupling)
        if self._stream.heard_us is not None:
            return False
        self._go_on_with(self._next)
        return True

    def move(self, now_us: int, position_m: Vector) -> int | None:
        """Move the tool; return an announced model's state for the slave, or None if nothing is announced."""
        state = self._stream.move(now_us, position_m)
        return state if self._next is None else self._next.move(now_us, position_m)

    def difference(self, now_us: int, period_us: int, position_m: Vector) -> Difference | None:
        """Return the function of positions that the applied force follows; None if it depends on none."""
        stream, decoder = self._stream, self._stream.rendering
        line_decoder = stream.line_decoder
        if isinstance(decoder, BoundedDecoder):
            decoder = decoder.inner  # a position cannot correct the difference that the bound makes
        if line_decoder is None or not isinstance(decoder, Predictive):
            return None
        at_us = stream.time_us(now_us, period_us)
        here_n = decoder.predict(at_us, position_m, now_us)
        return lambda place_m: line_decoder.difference(here_n, at_us, place_m, now_us)

    def follow(self, now_us: int, period_us: int, place_m: Vector | None) -> None:
        """Note the tool's position as the slave assumes it; None if it does not follow a line."""
        for stream in (self._stream, self._next):
            if stream is not None and stream.line_decoder is not None and place_m is not None:
                stream.line_decoder.move(stream.time_us(now_us, period_us), place_m, now_us)

    def receive(self, event: ForceArrived, now_us: int) -> Applied | None:
        """Apply a force that has arrived; None if its model must catch up first. PeerError if it is malformed."""
        stream = self._stream if self._next is None or event.is_parting else self._next
        return self._apply(stream, event, now_us) if stream.decode(event) else None

    def caught_up(self, now_us: int) -> Applied | None:
        """Apply the newest force whose model has caught up in `move`; None if there is none."""
        applied = None
        for stream in (self._stream, self._next):
            event = None if stream is None else stream.caught_up()
            if stream is not None and event is not None:
                applied = self._apply(stream, event, now_us)
        return applied

    def _apply(self, stream: _Stream, event: ForceArrived, now_us: int) -> Applied:
        stream.heard_us, stream.heard_t_us = now_us, event.t_us
        if stream is self._stream and self._next is not None:
            event = replace(event, is_parting=True)  # its session may have been replaced since it arrived
        begins = stream is self._next
        if begins:
            self._hold.restart()
            self._go_on_with(stream)
        self.received_n = stream.decoder.reconstruct(event.t_us, self._position_m, self._position_us)
        self._hold.receive(self.received_n, now_us)
        if not stream.on_model and not self._has_parts:  # a model's force belongs to the present
            self._predictor.learn(event.t_us, self.received_n)
        self._valid_t_us = event.t_us
        return Applied(event, begins)

    def confirm(self, event: HoldConfirmed, now_us: int) -> None:
        """Note that the applied force was still right at a position."""
        # A new session does not confirm the held force of an earlier one.
        if self._stream.heard_us is not None and event.is_parting == (self._next is not None):
            self._hold.confirm(now_us)
            self._valid_t_us = event.t_us

    def keep(self, kept: bool) -> None:
        """Set whether the stimulus is kept at any age, because it is small, and its successor must not have to rise.

        It still ages: once it is no longer kept, it decays like any stimulus of that age.
        """
        self._hold.kept = kept and self._stream.heard_us is not None

    def advance(self, now_us: int, period_us: int, position_m: Vector | None) -> None:
        """Update the held force from the decoder for a tick at a position. A user's codec may raise anything."""
        self._position_m, self._position_us = position_m, now_us
        if self._next is not None and position_m is not None:  # it needs the motion when its first force arrives
            self._next.decoder.reconstruct(now_us, position_m, now_us)
        stream = self._stream
        if stream.heard_us is None:
            if position_m is not None:
                stream.decoder.reconstruct(now_us, position_m, now_us)
            return
        self._at_us = at_us = stream.time_us(now_us, period_us)
        self.received_n = force_n = stream.decoder.reconstruct(at_us, position_m, now_us)
        if stream.on_model:
            self.ticks_on_model += 1
        if self._hold.follow(force_n, now_us):
            self.age.add(now_us - self._valid_t_us)

    def expected(self, now_us: int, lead_us: int) -> Vector:
        """Return the force [N] expected `lead_us` from now, after `advance`; the held one unless the link is alive."""
        if self._has_parts:
            return self._hold.value(now_us)
        if self._position_m is not None:
            self._predictor.move(now_us, self._position_m)
        if not self._hold.is_fresh(now_us):
            return self._hold.value(now_us)
        predict = self._predict if self._stream.predicts else None
        return self._predictor.expected(now_us, self._at_us, lead_us, self.received_n, predict)

    def _go_on_with(self, stream: _Stream) -> None:
        """Apply the forces of a session from now on."""
        self._stream, self._next = stream, None
        self._predictor = ForcePredictor(self._axes)

    def _predict(self, lead_us: int, position_m: Vector) -> Vector:
        """Return what the decoder predicts [N] for a position [m] ahead."""
        decoder: Any = self._stream.rendering  # the decoder predicts
        force_n: Vector = decoder.predict(self._at_us + lead_us, position_m, self._position_us + lead_us)
        return force_n

    def release(self) -> None:
        """Set the force to zero; it rises from there."""
        self._hold.release()
