"""One master's context at the slave: session, scene, codec and report."""

from collections.abc import Callable, Hashable
from dataclasses import asdict
from typing import Any, Final, TypeAlias

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec
from hapticnet.codec.parts import positions_codec
from hapticnet.codec.positions import PromisedLine, unpack_line
from hapticnet.codec.registry import codec_parameters
from hapticnet.control.ports import SlaveEnd
from hapticnet.errors import PeerError, SampleError, UserCodeError, in_words, printable, shortened
from hapticnet.measure.running_error import parts_report, running_error
from hapticnet.node.decoders import read_state
from hapticnet.node.feedback import Feedback, SceneFailedError
from hapticnet.node.hand_predictor import ForceAhead
from hapticnet.node.positions import VELOCITY_STEP_US, DeadReckoning
from hapticnet.node.recording import DATAGRAM_COLUMNS, IN, OUT, Recording, frame_kind, slave_columns
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.step_times import NOT_TIMED, StepTime, StepTimes
from hapticnet.node.vibration import VibrationSender
from hapticnet.parts import law_numbers, parts_of
from hapticnet.protocol.messages import Code, Grant
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import Datagram, Kind
from hapticnet.samples import PositionSample, Vector, checked_vector, new_tuple
from hapticnet.scene.base import Touchable, bound_method, breaches_of, vibration_method
from hapticnet.scene.shapes import ShapeFeed, Shapes
from hapticnet.user_code import report_of
from hapticnet.vectors import along

MOST_SUCCESSORS: Final = 16
"""Most remembered successors of a session: a master with a bad link may need several tries."""

LONGEST_LINE: Final = 200  # most characters of a scene's message

_Answered: TypeAlias = tuple[PositionSample, Vector, Vector, bytes | None, bytes | None, int]
"""An answer not yet accounted for: position, its force, the encoded force, payload of the FORCE if any,
datagram, and time [µs]."""


class SlaveContext:
    """Pass a position through decoder, scene and encoder.

    `identity`: the owner of the session: a public key, or the host of an open session.
    `listed`: its name in the list of masters; None for an open session.
    `continues`: the context whose scene this one continues. A restarted master has another clock; `same_clock` says
    whether this one's time stamps continue the old ones.
    """

    def __init__(
        self,
        session: SlaveSession,
        grant: Grant,
        address: Hashable,
        identity: Hashable,
        scene: Touchable,
        codec: Codec,
        coupling: tuple[SlaveEnd, int, int] | None = None,
        *,
        seats: int,
        listed: str | None,
        settings: SlaveSettings,
        times: StepTimes,
        now_us: int,
        continues: "SlaveContext | None" = None,
        same_clock: bool = True,
    ) -> None:
        self.session = session
        self.grant = grant
        self.address = address
        self.identity = identity
        self.seats = seats
        self.listed = listed
        self.greeting: tuple[Hashable, int] | None = None  # address and nonce of the HELLO
        self.scene = scene
        self.codec = codec
        self.continues = continues
        self.same_clock = same_clock
        self._successors: dict[bytes, bool] = {}
        self._continued = continues.session.number if continues is not None else None
        self.seated = False
        self.steps = 0
        self.superseded = 0
        self.paused: str | None = None
        self.failure: str | None = None  # why this side closed the session, if its code failed
        # the newest answered position: its time [µs] on the master's clock, position [m], true force [N],
        # force that the master holds if nothing is lost [N], and whether a force was transmitted. None before the
        # first.
        self.newest: tuple[int, Vector, Vector, Vector, bool] | None = None
        self.recording = Recording(slave_columns(scene.axes, parts_of(codec.law))) if settings.record else None
        self.datagrams = Recording(DATAGRAM_COLUMNS) if settings.record_datagrams else None
        self._on_error = settings.on_error
        self._shift_us: int | None = None  # scene's time minus master's time
        self._scene_us = 0
        self._opened_us = now_us
        self._stepped_us = now_us
        self._pending: PositionSample | None = None
        self.reckoning = DeadReckoning(round(1e6 / grant.rate_hz)) if grant.position_share else None
        self._end: SlaveEnd | None = None  # of the coupling
        # data of the coupling: length before a position and before a force, and that of the newest position
        self._data_bytes, self._answer_bytes, self._data = 0, 0, b""
        if coupling is not None:
            self._end, self._data_bytes, self._answer_bytes = coupling
        self._vibration: VibrationSender | None = None
        vibrate, asked = vibration_method(scene), session.request.vibration
        if grant.vibration and vibrate is not None and asked is not None:
            self._vibration = VibrationSender(vibrate, session, *asked)
        self._knows_bound = False
        self.between = 0
        self._answered: _Answered | None = None
        self._positions = positions_codec(codec.law).decoder(scene.axes)
        self._feedback: Feedback | None = None
        self._ahead: ForceAhead | None = None
        self._period_us = 1e6 / grant.rate_hz
        what = getattr(scene, "what", f"scene {scene.name}")
        self._next_line: Callable[[], Any] | None = getattr(scene, "next_line", None)
        self._scene_time = times.of(what)
        self._copy_time = times.of(f"the copy of {what}") if grant.predicted else NOT_TIMED
        self._codec_time = times.of_codec(codec)
        self._master_state: int | None = None  # layers of the model pierced at the master
        self._zero_n = (0.0,) * scene.axes
        self._error = running_error(codec.law)
        shapes: Shapes | None = getattr(scene, "shapes", None)
        self._looks = None if shapes is None else ShapeFeed(shapes)

    @property
    def feedback(self) -> Feedback:
        """The encoder of answers; built at the first position, so that an unused session costs little."""
        if self._feedback is None:
            self._feedback = Feedback(
                self.session, self.codec, self.scene, announced=self.grant.announced, rate_hz=self.grant.rate_hz
            )
            if self.grant.predicted:
                self._ahead = ForceAhead(self.scene, round(self._period_us), self.codec.law)
        return self._feedback

    def is_own(self, ticket: bytes) -> bool | None:
        """Return whether the holder of a ticket is this context's own master, now or as a successor; None: unknown."""
        return True if ticket == self.grant.ticket else self._successors.get(ticket)

    def add_successor(self, other: "SlaveContext") -> None:
        """Note a session that is to continue this one, when its first position arrives."""
        self._successors[other.grant.ticket] = other.same_clock
        if len(self._successors) > MOST_SUCCESSORS:
            del self._successors[next(iter(self._successors))]

    def inherit(self, old: "SlaveContext") -> None:
        """Take over the successors of the session that this one continues."""
        own = {ticket: is_own and self.same_clock for ticket, is_own in old._successors.items()}
        self._successors = own | self._successors
        self._successors.pop(self.grant.ticket, None)

    def receive(self, datagram: Datagram, data: bytes, address: Hashable, now_us: int) -> bool:
        """Process a datagram of this session; return whether there is now a position to `answer`.

        Only the newest position is answered. A suspended slave thus skips the queue. Raise
        PeerError if it cannot be opened or is malformed; the caller counts it.
        """
        if self.datagrams is not None:
            self.datagrams.add((now_us, IN, frame_kind(data), len(data)))
        taken = self.session.receive(datagram, data, now_us, self._read)
        if taken is None:
            return False
        if self.session.seal is not None:
            self.address = address  # the newest datagram that opens gives the master's address
        t_us, (state, line, self._data) = taken
        position_m = line.position_m
        if self.reckoning is not None:
            self.reckoning.receive(line._replace(t_us=t_us), now_us)
        if self._pending is not None:
            self.superseded += 1
            self._scene_time.unanswered += 1
            self._codec_time.unanswered += 1
        self._pending = new_tuple(PositionSample, (t_us, position_m))
        self._master_state = state if self.session.in_step else None
        return True

    def _read(self, payload: bytes) -> tuple[int | None, PromisedLine, bytes]:
        """Return state of the model, line of a position at time 0, and data of the coupling; PeerError if malformed."""
        state, data = None, payload[: self._data_bytes]
        payload = payload[self._data_bytes :]
        if self.grant.announced:
            state, payload = read_state(payload)
        if self.reckoning is not None:
            return state, unpack_line(0, payload, self.scene.axes), data
        self._positions.decode(0, payload)
        return state, PromisedLine(0, self._positions.reconstruct(0), (), ()), data

    @property
    def waits(self) -> bool:
        """Whether there is a position to `answer`."""
        return self._pending is not None

    def answer(self, now_us: int) -> bytes | None:
        """Move the scene to the newest position; return the answer, if any. SceneFailedError if that fails."""
        sample, self._pending = self._pending, None
        if sample is None:
            return None
        self.account_sent()
        if self._shift_us is None:
            self._shift_us = self._begin(sample.t_us, now_us)
        try:
            if self._end is not None:
                return self._answer_coupled(self._end, sample, now_us)
            if self.reckoning is None:
                sample = self._led(sample)
                return self._answer(sample, self._step(sample), now_us)
            return self._answer_line(self.reckoning, sample, now_us)
        except SampleError:
            if self.reckoning is not None:
                self.reckoning.answered(sample.t_us)
            self.session.received.malformed += 1
            return None

    def _answer_coupled(self, end: SlaveEnd, sample: PositionSample, now_us: int) -> bytes | None:
        """Move the scene to where the coupling puts the tool; return its answer. SampleError if its data is bad."""
        try:
            tool_m = checked_vector(end.command(sample.position_m, sample.t_us, self._data), "its position")
            force_n = self._step(PositionSample(sample.t_us, tool_m))
            coded_n, data = end.answer(force_n)
            coded_n = checked_vector(coded_n, "its force")
            if len(coded_n) != self.scene.axes or type(data) is not bytes or len(data) != self._answer_bytes:
                raise ValueError(f"answer returned {axes_of(len(coded_n))} and {len(data)} bytes")
        except PeerError as error:
            raise SampleError(str(error)) from error
        except SceneFailedError:
            raise
        except Exception as error:  # a user's coupling may raise anything
            raise SceneFailedError(f"the coupling failed: {in_words(error)}") from error
        self.feedback.data = data
        return self._answer(sample, force_n, now_us, coded_n)

    def step_between(self, now_us: int) -> bytes | None:
        """Step the scene along the promised line; return the answer, if any. SceneFailedError if that fails."""
        sample = self.reckoning.due(now_us) if self.reckoning is not None else None
        if sample is None:
            return None
        self.account_sent()
        self.between += 1
        if self.reckoning is not None:  # even if the scene refuses the position: the next step is one period later
            self.reckoning.answered(sample.t_us)
        try:
            force_n = self._step(sample)
            self._look(sample.position_m)
            return self._answer(sample, force_n, now_us)
        except SampleError:
            return None

    def _answer_line(self, reckoning: DeadReckoning, sample: PositionSample, now_us: int) -> bytes | None:
        """Move the scene to a received position; if it was late, answer for the present."""
        t_us = reckoning.present_us(now_us)
        # Lasting changes, such as a breach, happen here, at a received position. Time does not go back.
        force_n = self._step(PositionSample(t_us, sample.position_m))
        self._look(sample.position_m)
        if reckoning.bound is not None and reckoning.bound.damping_n_s_per_m:
            # The hand left the old line after the last step. It now follows the new one.
            before_us = t_us - VELOCITY_STEP_US
            back_m = along(sample.position_m, -1e-6 * VELOCITY_STEP_US, reckoning.arriving_m_per_s)
            self._step(PositionSample(before_us, reckoning.bound.nearest(back_m)))
            force_n = self._step(PositionSample(t_us, sample.position_m))
        if reckoning.bound is not None and t_us > sample.t_us:
            sample = PositionSample(t_us, reckoning.at(t_us))
            force_n = self._step(sample)
            self._look(sample.position_m)
        return self._answer(sample._replace(t_us=t_us), force_n, now_us)

    def _look(self, position_m: Vector) -> None:
        """Ask the scene for its stiffness bound near a position, and send it to the master."""
        reckoning, look = self.reckoning, bound_method(self.scene)
        if reckoning is None or look is None or self.paused is not None:
            return
        try:
            news = reckoning.news(look(), position_m, first=not self._knows_bound)
        except Exception as error:  # a user's scene may raise anything, and return anything
            self._fail(error)
            return
        if news is not None:
            self._knows_bound = True
            self.session.set_bound(news)

    def _answer(
        self, sample: PositionSample, force_n: Vector, now_us: int, coded_n: Vector | None = None
    ) -> bytes | None:
        """Return the datagram that answers a position with its force, if any; `coded_n`: the vector encoded for it."""
        if self.reckoning is not None:
            self.reckoning.answered(sample.t_us)
        feedback = self.feedback
        predicted = None
        if self._ahead is not None and self.paused is None:
            line = None if self.reckoning is None else self.reckoning.line
            self._copy_time.begin()
            predicted = self._ahead.answer(sample, self._scene_us, self.session.round_trip.us, line)
            self._copy_time.end(self._period_us)
            if self._ahead.fault is not None and self.codec.needs_position:
                # Its master applies what follows the hand without a bound, because this slave judges it there.
                self._fail(UserCodeError(f"its copy failed: {self._ahead.fault}"))
        self.steps += 1
        self._codec_time.begin()
        payload, datagram = feedback.answer(sample, force_n if coded_n is None else coded_n, now_us, predicted)
        self._codec_time.end(self._period_us)
        self._stepped_us = now_us
        if coded_n is None:
            coded_n = force_n if predicted is None or feedback.on_model else predicted[1]
        self._answered = sample, force_n, coded_n, payload, datagram, now_us
        return datagram

    @property
    def vibrates(self) -> bool:
        """Whether vibration is sent beside force."""
        return self._vibration is not None

    def vibrations(self, now_us: int) -> list[bytes]:
        """Return the datagrams of the scene's vibration up to its newest step; SceneFailedError if that fails."""
        if self._vibration is None or self.paused is not None or self._shift_us is None:
            return []
        try:
            made = self._vibration.datagrams(self._scene_us - self._shift_us, self._shift_us, now_us)
        except Exception as error:  # a user's scene may raise anything
            self._fail(error)
            return []
        if self.datagrams is not None:
            for data in made:
                self.datagrams.add((now_us, OUT, frame_kind(data), len(data)))
        return made

    def account_sent(self) -> None:
        """Account for the last answer, once it is on its way; SceneFailedError if the codec cannot read it."""
        answered, self._answered = self._answered, None
        if answered is None:
            return
        sample, force_n, coded_n, payload, datagram, now_us = answered
        self.feedback.account_sent(sample, payload)
        held_n = self.feedback.held_n
        self.newest = sample.t_us, sample.position_m, force_n, held_n, payload is not None
        self._error.add(coded_n, held_n)
        size = 0 if datagram is None else len(datagram)
        if self.recording is not None:
            vectors = *sample.position_m, *force_n, *held_n
            sent = payload is not None, size, breaches_of(self.scene), now_us
            self.recording.add((sample.t_us, *vectors, *sent))
        if self.datagrams is not None and datagram is not None:
            self.datagrams.add((now_us, OUT, frame_kind(datagram), size))

    def look(self, now_us: int) -> bytes | None:
        """Return a NOTICE with what has changed of how the scene looks, if it is due and the master looks at it."""
        if self._looks is None or not self.session.is_looked_at(now_us):
            return None
        try:
            shapes = self._looks.due(now_us)
        except Exception as error:  # a user's scene may raise anything; its forces are still served
            self._looks = None
            return self.session.notice(f"the scene is not drawn: {in_words(error)}", now_us, Code.SHAPES)
        return None if shapes is None else self.session.notice("", now_us, Code.SHAPES, shapes)

    @property
    def slow(self) -> StepTime | None:
        """The code (scene or codec) of this session whose steps are too slow now; None if none is."""
        times = self._scene_time, self._copy_time, self._codec_time
        return next((each for each in times if each.is_slow), None)

    def next_line(self) -> str | None:
        """Return the next message of the scene for a person, or None."""
        if self._next_line is None:
            return None
        try:
            line = self._next_line()
        except Exception as error:  # a user's scene may raise anything
            self._next_line, line = None, in_words(error)
        return None if line is None else shortened(printable(str(line)), LONGEST_LINE)

    def resume(self) -> None:
        """Step the scene again after it has failed."""
        self.paused = None

    def _step(self, sample: PositionSample) -> Vector:
        """Return the force of the scene at a position; zero while paused."""
        if self.paused is not None:
            return self._zero_n
        self._scene_us = sample.t_us + (self._shift_us or 0)
        try:
            at_scene_time = PositionSample(self._scene_us, sample.position_m) if self._shift_us else sample
            self._scene_time.begin()
            force_n = self.scene.step(at_scene_time).force_n
            self._scene_time.end(self._period_us)
        except SampleError:
            raise
        except Exception as error:  # a user's scene may raise anything
            self._fail(error)
            return self._zero_n
        self.feedback.step(sample, self._master_state)
        self._master_state = None
        return force_n

    def _led(self, sample: PositionSample) -> PositionSample:
        """Return the position at which to step the scene: the expected one, for a robot that moves ahead."""
        if self._ahead is None:
            return sample
        force_n = self._zero_n if self.newest is None else self.newest[2]
        position_m = self._ahead.lead(sample, self.session.round_trip.us, force_n)
        return sample if position_m is None else PositionSample(sample.t_us, position_m)

    def _fail(self, error: Exception) -> None:
        """End or pause the session, because the scene has failed."""
        reason = f"the scene failed: {in_words(error)}"
        if self._on_error == "end":
            self.steps += 1
            raise SceneFailedError(reason) from error
        self.paused = reason

    def _begin(self, t_us: int, now_us: int) -> int:
        """Return the offset [µs] from the master's time that makes a continued scene's time run on evenly."""
        old, self.continues = self.continues, None  # so that a chain of sessions does not stay in memory
        if old is None or old._shift_us is None:
            return 0
        if self.same_clock:
            return old._shift_us
        return old._scene_us + max(0, now_us - old._stepped_us) - t_us

    def report(self) -> dict[str, Any]:
        """Return the report of this session for JSON."""
        forces = self.session.sent.by_kind[Kind.FORCE]
        return {
            "session": self.session.number,
            "master": self.session.request.name,
            "listed": self.listed,
            "scene": self.scene.name,
            "codec": self.codec.name,
            "parameters": codec_parameters(self.codec),
            **law_numbers(self.codec.law),
            "sealed": self.session.seal is not None,
            "continues": self._continued,
            "state": self.session.state.value,
            "end_reason": self.session.end_reason,
            "duration_s": (self._stepped_us - self._opened_us) / 1e6,
            "position_share": self.grant.position_share,
            "steps": self.steps,
            "between": self.between,
            "superseded": self.superseded,
            "breaches": breaches_of(self.scene),
            "scene_report": report_of(self.scene),
            "announced": self.feedback.report(),
            "predicted": None if self._ahead is None else self._ahead.report(),
            **({} if self._vibration is None else {"vibration": self._vibration.report()}),
            "packet_rate_reduction": 1.0 - forces / self.steps if self.steps else None,
            **asdict(self._error.report()),
            **parts_report(self._error),
            "sent": self.session.sent.report(),
            "received": self.session.received.report(),
        }
