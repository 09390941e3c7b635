"""Admission at a slave: grant sessions, evict silent ones, and limit the steps between positions.

Each question about places is answered by scanning all sessions: at most `most_sessions`, and only for the few requests
a second that `HelloFilter` lets through. Only `next_expiry_us` is needed after each datagram, so it is cached.
"""

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable
from math import ceil
from typing import Final, TypeAlias

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import all_codecs, make_codec, with_share
from hapticnet.control.couplings import all_couplings, data_bytes, make_coupling
from hapticnet.control.ports import Port, SlaveEnd, TwoPort
from hapticnet.errors import HapticnetError, SampleError, SettingsError, in_words
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import StepTimes
from hapticnet.parts import parts_of, written
from hapticnet.protocol.handshake import Visitor
from hapticnet.protocol.hello_filter import Address
from hapticnet.protocol.keys import MasterEntry
from hapticnet.protocol.messages import (
    REASON_BYTES,
    TICKET_BYTES,
    Code,
    Grant,
    Refusal,
    Refuse,
    Request,
    Welcome,
    clipped,
)
from hapticnet.protocol.settings import Entropy, SessionSettings, random_bytes
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import SEALED, Kind, pack, pack_body
from hapticnet.scene.base import (
    Touchable,
    bound_method,
    copy_method,
    lead_limit_n,
    look_ahead_of,
    scene_frame,
    scene_parts,
    vibration_method,
)
from hapticnet.user_code import raised

MOST_HALF_OPEN: Final = 128  # half-open sessions at once. They take no seat; this bounds their memory.
MOST_HALF_OPEN_EACH: Final = 16  # half-open sessions of one identity at once


class NoSeatError(HapticnetError):
    """There is no place for another session of this identity."""


class SessionTable:
    """The present sessions of a slave: `by_number` has them in order of arrival, read-only."""

    def __init__(self, settings: SessionSettings) -> None:
        self.by_number: dict[int, SlaveContext] = {}
        self._settings = settings
        self._came = 0
        self._order: dict[SlaveContext, int] = {}
        self._now_us = 0
        self._expiry_us: int | None = None  # time of the next expiry; None without a session

    def __len__(self) -> int:
        return len(self.by_number)

    def see(self, now_us: int) -> None:
        """Note the time [µs]. If the clock went back, the silence of all sessions counts from now."""
        if now_us < self._now_us:
            for context in self.by_number.values():
                context.session.silent_us(now_us)
            self._look_at_expiry()
        self._now_us = now_us

    def add(self, context: SlaveContext) -> None:
        """Add a half-open session."""
        self._came += 1
        self._order[context] = self._came
        self.by_number[context.session.number] = context
        self._note_expiry(context)

    def seat(self, context: SlaveContext) -> None:
        """Give a session its seat: it is open now."""
        context.seated = True
        self._note_expiry(context)  # an open session may expire sooner than a half-open one

    def remove(self, context: SlaveContext) -> None:
        """Forget a session that has ended."""
        del self.by_number[context.session.number]
        del self._order[context]
        if not self.by_number:
            self._expiry_us = None

    def in_order(self, contexts: Iterable[SlaveContext]) -> list[SlaveContext]:
        """Return present sessions in order of arrival."""
        return sorted(contexts, key=self._order.__getitem__)

    def expired(self, now_us: int) -> list[SlaveContext]:
        """Return the sessions that have been silent for too long. They must be removed."""
        self.see(now_us)
        if self._expiry_us is None or now_us < self._expiry_us:
            return []
        expired = [each for each in self.by_number.values() if each.session.expires_us() <= now_us]
        self._look_at_expiry(besides=expired)
        return expired

    def next_expiry_us(self) -> int | None:
        """Return when the next session may expire [µs]; None if there is no session."""
        return self._expiry_us

    def users_of(self, scene: Touchable) -> list[SlaveContext]:
        """Return the open sessions that touch a scene."""
        return [each for each in self.by_number.values() if each.seated and each.scene is scene]

    def eviction_candidate(
        self, identity: Hashable, most: int, besides: Collection[SlaveContext], now_us: int
    ) -> SlaveContext | None:
        """Return the session to evict so that `identity` gets another one; None if a place is free.

        A session with a silent master is evicted for another one of the same identity if that holds all its places, or,
        when all places are taken, for an identity that holds fewer: first from the identity that holds most, and
        of these the longest silent one. So an identity with many places cannot shut out the others.
        Raise NoSeatError if none may be evicted.

        `most`: places that this identity may hold.
        `besides`: further sessions of this identity without a place.
        """
        self.see(now_us)
        taken = [each for each in self.by_number.values() if each.seated and each not in besides]
        held = Counter(each.identity for each in taken)
        own = held[identity]
        if own >= most:
            candidates = [each for each in taken if each.identity == identity]
            reason = f"all sessions that this master may have are taken; it may have {most} at once"
        elif len(taken) >= self._settings.most_sessions:
            candidates = [each for each in taken if held[each.identity] > own]
            reason = f"all sessions of this slave are taken; it serves {self._settings.most_sessions} at once"
        else:
            return None
        silent = [each for each in candidates if each.session.silent_us(now_us) > self._settings.gives_way_us]
        if not silent:
            raise NoSeatError(reason)
        return max(silent, key=lambda each: (held[each.identity], each.session.silent_us(now_us)))

    def surplus_half_open(self, identity: Hashable) -> SlaveContext | None:
        """Return the half-open session that must end before another one of `identity` begins, or None."""
        waiting = [each for each in self.by_number.values() if not each.seated]
        held = Counter(each.identity for each in waiting)
        if held[identity] < MOST_HALF_OPEN_EACH:
            if len(waiting) < MOST_HALF_OPEN:
                return None
            identity = held.most_common(1)[0][0]
        return next(each for each in waiting if each.identity == identity)

    def to_continue(
        self, identity: Hashable, name: str, ticket: bytes | None, now_us: int
    ) -> tuple[SlaveContext, bool] | None:
        """Return the session whose scene a new one continues, and whether its own master asks; None without one.

        That is the session of the ticket, or the one that the session of the ticket was to continue; without a ticket,
        one of the same identity and name. A different (restarted) master gets only the scene of a
        session whose link is stale.
        """
        self.see(now_us)
        for context in self.by_number.values():
            if context.identity != identity or not context.seated:
                continue
            if ticket is not None:
                is_own = context.is_own(ticket)
            else:
                is_own = False if context.session.request.name == name else None
            if is_own or (is_own is not None and context.session.silent_us(now_us) > self._settings.stale_after_us):
                return context, is_own
        return None

    def _note_expiry(self, context: SlaveContext) -> None:
        expires_us = context.session.expires_us()
        if self._expiry_us is None or expires_us < self._expiry_us:
            self._expiry_us = expires_us

    def _look_at_expiry(self, besides: Collection[SlaveContext] = ()) -> None:
        others = (each for each in self.by_number.values() if each not in besides)
        self._expiry_us = min((each.session.expires_us() for each in others), default=None)


EACH_HZ: Final = 4_000
"""Steps between positions a second for one identity: four usual sessions in full, and a quarter of a core."""

ALL_HZ: Final = 12_000  # steps between positions a second for all
MOST_AT_ONCE: Final = 8
"""Most steps in a row before newly arrived positions are answered: these wait for half a millisecond."""


class LineSteps:
    """Schedule and limit of steps between positions that are sent only when they matter.

    A line takes its master ten datagrams a second, and the slave the steps of the session's rate. Every step
    without a datagram therefore counts toward a limit, for each identity and in all. Where a limit is
    reached, the sessions of that identity, or all, are stepped at every second, third, … of their times, and all
    positions that arrive are still answered.
    """

    def __init__(self) -> None:
        self._steps_us: dict[SlaveContext, int] = {}  # when each is to be stepped
        self._rates_hz: dict[SlaveContext, int] = {}
        self._asked_hz: dict[Hashable, int] = {}  # by identity
        self._all_hz = 0  # total of the identities' steps, up to the limit

    def note(self, context: SlaveContext) -> None:
        """Note that a session was answered, which changes its next step."""
        reckoning = context.reckoning
        if reckoning is None or reckoning.next_step_us() is None:  # it waits for a position: others may be stepped more
            self.forget(context)
            return
        if context not in self._rates_hz:
            self._rates_hz[context] = rate_hz = ceil(context.grant.rate_hz)
            self._ask(context.identity, rate_hz)
        reckoning.every = ceil(self._asked_hz[context.identity] / EACH_HZ) * ceil(self._all_hz / ALL_HZ)
        step_us = reckoning.next_step_us()
        if step_us is None:
            self._steps_us.pop(context, None)
        else:
            self._steps_us[context] = step_us

    def forget(self, context: SlaveContext) -> None:
        """Remove a session."""
        rate_hz = self._rates_hz.pop(context, None)
        if rate_hz is not None:
            self._ask(context.identity, -rate_hz)
            self._steps_us.pop(context, None)

    def due(self, now_us: int) -> list[SlaveContext]:
        """Return the sessions to step now, the longest waiting first; call `note` after each step."""
        steps_us = self._steps_us
        due = sorted((each for each, step_us in steps_us.items() if step_us <= now_us), key=steps_us.__getitem__)
        for context in due[:MOST_AT_ONCE]:
            del steps_us[context]
        return due[:MOST_AT_ONCE]

    def earliest_us(self) -> int | None:
        """Return the time of the next step [µs]; None if there is none."""
        return min(self._steps_us.values(), default=None)

    def _ask(self, identity: Hashable, more_hz: int) -> None:
        """Note a change of an identity's steps a second."""
        before_hz = self._asked_hz.get(identity, 0)
        after_hz = before_hz + more_hz
        self._all_hz += min(after_hz, EACH_HZ) - min(before_hz, EACH_HZ)
        if after_hz:
            self._asked_hz[identity] = after_hz
        else:
            del self._asked_hz[identity]


SMALLEST_SESSION: Final = 1 << 16
"""Smallest session number: all larger ones take five bytes, so datagram sizes do not depend on chance."""

MakeScene: TypeAlias = Callable[[MasterEntry | None], Touchable]
"""Makes a scene, for a master of the list or an open session."""


class RefusalError(HapticnetError):
    """The refusal of a request."""

    def __init__(self, code: Code, reason: str) -> None:
        super().__init__(reason)
        self.code = code

    def datagram(self, visitor: Visitor, nonce: int) -> bytes:
        """Return the answer to a HELLO with `nonce`: a REFUSE, or in a sealed handshake a WELCOME of session 0."""
        reason = clipped(str(self), REASON_BYTES)
        if visitor.responder is None:
            return pack(Kind.REFUSE, 0, 0, pack_body(Refuse(nonce, reason, self.code)))
        answer, _ = visitor.answer(Refusal(0, reason, self.code))
        return pack(Kind.WELCOME, 0, 0, pack_body(Welcome(nonce, answer)), SEALED)


class Admission:
    """Decide on requests."""

    def __init__(self, make_scene: MakeScene, settings: SlaveSettings, rng: Entropy, times: StepTimes) -> None:
        self._make_scene = make_scene
        self._settings = settings
        self._rng = rng
        self._times = times
        self.takes_new = True  # masters, without those that continue the scene of a session

    def admit(
        self, visitor: Visitor, sequence: int, address: Address, host: Hashable, seats: SessionTable, now_us: int
    ) -> SlaveContext:
        """Return a context for a master, which changes nothing before its first position; RefusalError if refused."""
        request, entry = visitor.request, visitor.entry
        if visitor.responder is not None and entry is None:
            raise RefusalError(Code.KEY, "this slave does not know the master's key: add it to its list of masters")
        identity = identity_of(visitor, host)
        codec, coupling = _codec(request), _coupling(request)
        timings = self._settings.session
        found = seats.to_continue(identity, request.name, request.ticket, now_us)
        old, same_clock = (None, False) if found is None else found
        if old is None and not self.takes_new:
            raise RefusalError(Code.STOPPING, "this slave is about to stop: ask another one, or try again later")
        most = timings.most_per_identity if entry is None or entry.most_sessions is None else entry.most_sessions
        try:
            seats.eviction_candidate(identity, most, () if old is None else (old,), now_us)
        except NoSeatError as error:
            raise RefusalError(Code.FULL, str(error)) from error
        scene = self._scene(entry, request.name) if old is None else old.scene
        _compare(codec, request, scene)
        # Only a scene with a stiffness bound is stepped at positions that the master did not send.
        alone = coupling is None and not parts_of(codec.law)  # models, lines and robots that move ahead have one part
        says = request.announced and self._settings.announces and alone
        announced = says and look_ahead_of(scene) is not None
        # A codec that follows the hand's own position would be judged at the place of a robot that moves ahead.
        may_lead = lead_limit_n(scene) > 0.0 and not codec.needs_position and not announced and alone
        predicted = request.predicted and (copy_method(scene) is not None or may_lead) and coupling is None
        share = request.position_share if bound_method(scene) is not None and alone else 0.0
        codec = with_share(codec, share) if share else codec
        rate_hz = min(request.rate_hz, self._settings.fastest_rate_hz)
        if entry is not None and entry.fastest_rate_hz is not None:
            rate_hz = min(rate_hz, entry.fastest_rate_hz)
        session = SlaveSession(
            self._number(seats),
            request,
            timings,
            rate_hz=rate_hz,
            first_sequence=sequence,
            now_us=now_us,
            sparse=share > 0.0,
        )
        ticket = random_bytes(self._rng, TICKET_BYTES)
        return SlaveContext(
            session,
            Grant(
                session.number,
                rate_hz,
                timings.keepalive_us,
                scene.name,
                ticket,
                resumed=old is not None,
                announced=announced,
                position_share=share,
                predicted=predicted,
                vibration=request.vibration is not None and vibration_method(scene) is not None,
                frame=scene_frame(scene),
            ),
            address,
            identity,
            scene,
            codec,
            None if coupling is None else _slave_end(coupling, Port(scene.axes, codec.law, round(1e6 / rate_hz))),
            seats=most,
            listed=None if entry is None else entry.name,
            settings=self._settings,
            times=self._times,
            now_us=now_us,
            continues=old,
            same_clock=same_clock,
        )

    def _number(self, seats: SessionTable) -> int:
        while (number := int(self._rng.integers(SMALLEST_SESSION, 1 << 32))) in seats.by_number:
            pass
        return number

    def _scene(self, entry: MasterEntry | None, master: str) -> Touchable:
        try:
            scene = self._make_scene(entry)
            welcome: Callable[[str], None] | None = getattr(scene, "welcome", None)
            if welcome is not None:
                welcome(master)
            return scene
        except BaseException as error:  # a scene of the user's own may raise anything
            raise RefusalError(Code.FAILED, f"the scene cannot be made: {raised(error)}") from error


def _compare(codec: Codec, request: Request, scene: Touchable) -> None:
    """Raise RefusalError if the master and the scene have other axes, or other parts."""
    asked, has = parts_of(codec.law), scene_parts(scene)
    if asked != has or request.axes != scene.axes:
        if asked or has:
            wanted, offered = written(asked, request.axes), written(has, scene.axes)
            raise RefusalError(Code.AXES, f"the master has the parts {wanted}; scene {scene.name!r} has {offered}")
        raise RefusalError(Code.AXES, f"the master has {axes_of(request.axes)}; scene {scene.name!r} has {scene.axes}")
    if asked and request.coupling is not None:
        raise RefusalError(
            Code.PARAMETER, f"coupling {request.coupling[0]!r} has an end at the slave, for one part only"
        )


def identity_of(visitor: Visitor, host: Hashable) -> Hashable:
    """Return the identity of a session: a public key or, without keys, a host."""
    return host if visitor.entry is None else visitor.entry.public


def _coupling(request: Request) -> TwoPort | None:
    """Return the coupling asked for that has an end at the slave; None if there is none."""
    if request.coupling is None:
        return None
    name, parameters = request.coupling
    try:
        coupling = make_coupling(name, parameters)
    except SettingsError as error:
        raise RefusalError(Code.PARAMETER if name in all_couplings() else Code.CODEC, str(error)) from error
    return coupling if isinstance(coupling, TwoPort) else None


def _slave_end(coupling: TwoPort, port: Port) -> tuple[SlaveEnd, int, int]:
    """Return the end of a coupling, and the lengths of its data before a position and a force [B]."""
    try:
        return coupling.slave(port), *data_bytes(coupling, port.axes)
    except Exception as error:  # a user's coupling may raise anything
        raise RefusalError(Code.FAILED, f"the coupling failed: {in_words(error)}") from error


def _codec(request: Request) -> Codec:
    """Return the codec asked for, after a rehearsal; a RefusalError says which number is out of range."""
    try:
        request.check()
        codec = make_codec(request.codec, request.law(), request.parameters)
        codec.encoder(request.axes)
    except SampleError as error:  # a codec for fewer axes
        raise RefusalError(Code.AXES, str(error)) from error
    except SettingsError as error:
        raise RefusalError(Code.PARAMETER if request.codec in all_codecs() else Code.CODEC, str(error)) from error
    return codec
