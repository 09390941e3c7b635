"""Whether a master gets the session it asks for, and the context that serves it."""

from collections.abc import Callable, Hashable
from typing import Final, TypeAlias

from hapticnet.checks import axes_of
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import all_codecs, make_codec, with_share
from hapticnet.errors import HapticnetError, SampleError, SettingsError
from hapticnet.node.session_table import NoSeatError, SessionTable
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave_context import SlaveContext
from hapticnet.node.step_times import StepTimes
from hapticnet.perception import WeberLaw
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
from hapticnet.protocol.settings import Entropy, random_bytes
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.wire import SEALED, Kind, pack, pack_body
from hapticnet.scene.base import Touchable, bound_method, look_ahead_of
from hapticnet.scene.measured import MeasuredScene
from hapticnet.user_code import raised

SMALLEST_SESSION: Final = 1 << 16
"""Smallest session number: from here on all take five bytes, so datagram sizes do not depend on chance."""

MakeScene: TypeAlias = Callable[[MasterEntry | None], Touchable]
"""Makes a scene, for a master of the list or an open session."""


class RefusalError(HapticnetError):
    """A request that cannot be served."""

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
    """Decide on requests.

    `make_scene`: called for each new scene, because every master touches its own.
    `rng`: source of session numbers and tickets.
    `times`: where the steps of scenes and codecs are timed.
    """

    def __init__(self, make_scene: MakeScene, settings: SlaveSettings, rng: Entropy, times: StepTimes) -> None:
        self._make_scene = make_scene
        self._settings = settings
        self._rng = rng
        self._times = times
        self.takes_new = True  # masters, besides those that go on with the scene of a session

    def admit(
        self, visitor: Visitor, sequence: int, address: Address, host: Hashable, seats: SessionTable, now_us: int
    ) -> SlaveContext:
        """Return a context for a master whose HELLO had the number `sequence`.

        Nothing has changed for the present sessions then: the new one takes a seat, and the scene of another, when its
        first position arrives. Raise RefusalError if the slave cannot serve what the master asks for.
        """
        request, entry = visitor.request, visitor.entry
        if visitor.responder is not None and entry is None:
            raise RefusalError(Code.KEY, "this slave does not know the master's key: add it to its list of masters")
        identity = identity_of(visitor, host)
        codec = _codec(request)
        timings = self._settings.session
        found = seats.to_continue(identity, request.name, request.ticket, now_us)
        old, same_clock = (None, False) if found is None else found
        if old is None and not self.takes_new:
            raise RefusalError(Code.STOPPING, "this slave is about to stop: ask another one, or again later")
        most = timings.most_per_identity if entry is None or entry.most_sessions is None else entry.most_sessions
        try:
            seats.eviction_candidate(identity, most, () if old is None else (old,), now_us)
        except NoSeatError as error:
            raise RefusalError(Code.FULL, str(error)) from error
        scene = self._scene(entry, request.name) if old is None else old.scene
        if request.axes != scene.axes:
            raise RefusalError(
                Code.AXES, f"the master has {axes_of(request.axes)}; scene {scene.name!r} has {scene.axes}"
            )
        # Only a scene that says how its force may change is stepped at positions that the master did not send.
        says = request.announced and self._settings.announces != "nothing"
        announced = says and look_ahead_of(scene) is not None
        share = request.position_share if bound_method(scene) is not None else 0.0
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
            Grant(session.number, rate_hz, timings.keepalive_us, scene.name, ticket, old is not None, announced, share),
            address,
            identity,
            scene,
            codec,
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
            return MeasuredScene(scene) if self._settings.announces == "measured" and scene.axes == 1 else scene
        except BaseException as error:  # a scene of the user's own may raise anything
            raise RefusalError(Code.FAILED, f"the scene cannot be made: {raised(error)}") from error


def identity_of(visitor: Visitor, host: Hashable) -> Hashable:
    """Return whom a session counts for: a public key or, without keys, a host."""
    return host if visitor.entry is None else visitor.entry.public


def _codec(request: Request) -> Codec:
    """Return the codec asked for, after a rehearsal; a RefusalError says which number is out of range."""
    try:
        request.check()
        law = WeberLaw(weber_fraction=request.weber_fraction, floor_n=request.floor_n, multiplier=request.multiplier)
        codec = make_codec(request.codec, law, request.parameters)
        codec.encoder(request.axes)
    except SampleError as error:  # a codec for fewer axes
        raise RefusalError(Code.AXES, str(error)) from error
    except SettingsError as error:
        raise RefusalError(Code.PARAMETER if request.codec in all_codecs() else Code.CODEC, str(error)) from error
    return codec
