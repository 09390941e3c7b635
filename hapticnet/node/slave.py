"""The slave: answers the positions of each master with forces of that master's own scene."""

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.codec.registry import all_codecs, make_codec
from hapticnet.errors import HapticnetError, PeerError, SampleError, SettingsError, in_words
from hapticnet.node.station import SceneFailedError, Station
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import HELLO_BYTES, REASON_BYTES, Code, Hello, Refuse, clipped, unpack_hello
from hapticnet.protocol.settings import Entropy, SessionSettings
from hapticnet.protocol.slave_session import SlaveSession
from hapticnet.protocol.states import SlaveState, Trigger
from hapticnet.protocol.stats import Traffic
from hapticnet.protocol.wire import VERSION, Datagram, Kind, pack, pack_body, unpack, unpack_nonce
from hapticnet.scene.scene import Scene

Address: TypeAlias = Hashable
"""Source or destination of a datagram. Opaque here; the runtime uses (host, port)."""

SMALLEST_SESSION: Final = 1 << 16
"""Smallest session number: from here on all take five bytes, so datagram sizes do not depend on chance."""

REPORTS_KEPT: Final = 1000
"""Accounts of ended sessions that are kept: one or two megabytes, so that memory is bounded."""

NONCES_KEPT: Final = 256
"""Nonces of ended sessions that are remembered: more than a network delays."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveSettings:
    """What a slave grants.

    Attributes
    ----------
    fastest_rate_hz
        Highest sample rate granted to a master [Hz].
    record
        Whether each session remembers every sample.
    """

    fastest_rate_hz: float = 10_000.0
    record: bool = False
    session: SessionSettings = field(default_factory=SessionSettings)

    def __post_init__(self) -> None:
        check_parameter("fastest rate", self.fastest_rate_hz, self.session.slowest_hz, 1_000_000, "Hz")


@dataclass(frozen=True, slots=True)
class MasterJoined:
    """A master has a session."""

    station: Station


@dataclass(frozen=True, slots=True)
class MasterLeft:
    """A master's session has ended; `station` holds its final account."""

    station: Station


SlaveEvent: TypeAlias = MasterJoined | MasterLeft


class _RefusalError(HapticnetError):
    """A HELLO that cannot be served."""

    def __init__(self, code: Code, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class SlaveNode:
    """Serve any number of masters, each with its own scene, codec and account.

    Parameters
    ----------
    make_scene
        Called for each session, because every master touches its own scene.
    rng
        Source of session numbers.
    write_address
        Returns an address as text for the report.
    """

    def __init__(
        self,
        make_scene: Callable[[], Scene],
        settings: SlaveSettings,
        rng: Entropy,
        *,
        write_address: Callable[[Address], str] = str,
    ) -> None:
        self._write_address = write_address
        self.strangers = Traffic()
        self.to_strangers = Traffic()
        self._make_scene = make_scene
        self._settings = settings
        self._rng = rng
        self._stations: dict[int, Station] = {}
        self._spent_nonces: deque[tuple[Address, int]] = deque(maxlen=NONCES_KEPT)
        self.never_used = 0
        self._ended: deque[dict[str, Any]] = deque(maxlen=REPORTS_KEPT)
        self._outbox: list[tuple[bytes, Address]] = []
        self._events: deque[SlaveEvent] = deque()
        self._next_expiry_us: int | None = None

    @property
    def stations(self) -> tuple[Station, ...]:
        """The present sessions."""
        return tuple(self._stations.values())

    def receive_datagram(self, data: bytes, address: Address, now_us: int) -> None:
        """Process a datagram and answer it. Never raises: malformed and stray datagrams are counted."""
        account = self.strangers
        try:
            datagram = unpack(data)
            if datagram.kind is Kind.HELLO:
                self._receive_hello(datagram, len(data), address, now_us)
                return
            station = self._stations.get(datagram.session)
            if station is None or station.address != address:
                self._receive_stray(datagram, len(data), address)
                return
            account = station.session.received
            half_open = station.session.state is SlaveState.HALF_OPEN
            try:
                answer = station.receive(datagram, len(data), now_us)
            except SceneFailedError as failure:
                self._end(station, Trigger.CLOSE, str(failure), now_us, code=Code.FAILED)
                return
        except PeerError:
            account.add_malformed(len(data))
            return
        if half_open and station.steps:
            self._events.append(MasterJoined(station))
        if answer is not None:
            self._outbox.append((answer, address))
        if station.session.state is SlaveState.CLOSED:
            self._outbox.append((station.session.close("as asked", now_us), address))
            self._forget(station)

    def tick(self, now_us: int) -> None:
        """Forget sessions that have been silent for too long."""
        for station in self.stations:
            if now_us >= station.session.expires_us():
                station.session.end(Trigger.IDLE, "nothing arrived from the master")
                self._forget(station)
        self._next_expiry_us = min((station.session.expires_us() for station in self.stations), default=None)

    def next_timer_us(self) -> int | None:
        """Return when `tick` may have something to do [µs]; None if there is no session."""
        return self._next_expiry_us

    def datagrams_to_send(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams to send now, with their destinations."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_event(self) -> SlaveEvent | None:
        """Return the next event, or None."""
        return self._events.popleft() if self._events else None

    def close(self, reason: str, now_us: int) -> None:
        """End every session and send the masters a CLOSE."""
        for station in self.stations:
            self._end(station, Trigger.CLOSE, reason, now_us)

    def report(self) -> dict[str, Any]:
        """Return the account of the sessions for JSON: the present ones and the newest that have ended.

        Sessions without a position count among the strangers.
        """
        return {
            "sessions": [*self._ended, *(self._report(station) for station in self.stations if station.steps)],
            "never_used": self.never_used,
            "strangers": self.strangers.report(),
            "to_strangers": self.to_strangers.report(),
        }

    def _report(self, station: Station) -> dict[str, Any]:
        return {"address": self._write_address(station.address), **station.report()}

    def _receive_hello(self, datagram: Datagram, size: int, address: Address, now_us: int) -> None:
        if size < HELLO_BYTES:
            raise PeerError(f"HELLO of {size} bytes; it is padded to {HELLO_BYTES}")
        if datagram.version != VERSION:
            nonce = unpack_nonce(datagram.body)
            self.strangers.add(Kind.HELLO, size)
            reason = f"this slave speaks protocol version {VERSION} only"
            self._refuse(nonce, _RefusalError(Code.VERSION, reason), address)
            return
        hello = unpack_hello(datagram.body)
        station = next((station for station in self.stations if station.address == address), None)
        if station is None or station.session.hello.nonce != hello.nonce:
            if (address, hello.nonce) in self._spent_nonces:  # overtaken on its way by the session that followed
                self.strangers.add(Kind.HELLO, size)
                self.strangers.late += 1
                return
            try:
                station = self._open(hello, datagram.sequence, address, now_us, replaces=station)
            except _RefusalError as refusal:
                self.strangers.add(Kind.HELLO, size)
                self._refuse(hello.nonce, refusal, address)
                return
        # A HELLO that is repeated because the answer was lost gets the same answer.
        station.session.received.add(Kind.HELLO, size)
        self._outbox.append((self._welcome(station, now_us), address))

    def _open(self, hello: Hello, sequence: int, address: Address, now_us: int, *, replaces: Station | None) -> Station:
        """Open a session; a _RefusalError says why the slave cannot serve what the master asks for.

        Nothing has changed then: the session it would have replaced continues, and no other lost its place.
        """
        try:
            law = WeberLaw(weber_fraction=hello.weber_fraction, floor_n=hello.floor_n, multiplier=hello.multiplier)
            codec = make_codec(hello.codec, law, hello.parameters)
            codec.encoder(hello.axes)
        except SampleError as error:  # a codec for fewer axes
            raise _RefusalError(Code.AXES, str(error)) from error
        except SettingsError as error:
            raise _RefusalError(Code.PARAMETER if hello.codec in all_codecs() else Code.CODEC, str(error)) from error
        try:
            scene = self._make_scene()
        except Exception as error:  # a scene of the user's own may raise anything
            raise _RefusalError(Code.FAILED, f"the scene cannot be made: {in_words(error)}") from error
        if hello.axes != scene.axes:
            raise _RefusalError(Code.AXES, f"{hello.axes} axes asked for; scene {scene.name!r} has {scene.axes}")
        if replaces is None:
            self._make_room(now_us)
        else:
            replaces.session.end(Trigger.REPLACED, "the master asked for a new session")
            self._forget(replaces)
        while (number := int(self._rng.integers(SMALLEST_SESSION, 1 << 32))) in self._stations:
            pass
        session = SlaveSession(number, hello, self._settings.session, first_sequence=sequence, now_us=now_us)
        station = Station(session, address, scene, codec, record=self._settings.record, now_us=now_us)
        self._stations[number] = station
        self._next_expiry_us = min(self._next_expiry_us or session.expires_us(), session.expires_us())
        return station

    def _welcome(self, station: Station, now_us: int) -> bytes:
        rate_hz = min(station.session.hello.rate_hz, self._settings.fastest_rate_hz)
        return station.session.welcome(rate_hz, station.scene.name, now_us)

    def _make_room(self, now_us: int) -> None:
        """Free a place for a new session by ending one whose master is silent; one in use is never ended."""
        most = self._settings.session.most_sessions
        if len(self._stations) < most:
            return
        for station in self.stations:
            half_open = station.session.state is SlaveState.HALF_OPEN
            if half_open or station.session.silent_us(now_us) > self._settings.session.gives_way_us:
                station.session.end(Trigger.REPLACED, "its place was needed")
                self._forget(station)
                return
        raise _RefusalError(Code.FULL, f"all {most} sessions of this slave are taken")

    def _receive_stray(self, datagram: Datagram, size: int, address: Address) -> None:
        """Answer a datagram of an unknown session with RESET, so that its master asks for a new one at once."""
        self.strangers.add(datagram.kind, size)
        self.strangers.stray += 1
        if datagram.kind is Kind.POSITION or datagram.kind is Kind.CLOSE:
            self._answer_stranger(Kind.RESET, pack(Kind.RESET, datagram.session, datagram.sequence, b""), address)

    def _refuse(self, nonce: int, refusal: _RefusalError, address: Address) -> None:
        body = pack_body(Refuse(nonce, clipped(str(refusal), REASON_BYTES), refusal.code))
        self._answer_stranger(Kind.REFUSE, pack(Kind.REFUSE, 0, 0, body), address)

    def _answer_stranger(self, kind: Kind, data: bytes, address: Address) -> None:
        self.to_strangers.add(kind, len(data))
        self._outbox.append((data, address))

    def _end(self, station: Station, trigger: Trigger, reason: str, now_us: int, *, code: Code = Code.OTHER) -> None:
        """End a session from this side and tell its master."""
        self._outbox.append((station.session.close(reason, now_us, code), station.address))
        station.session.end(trigger, f"the slave closed: {reason}")
        self._forget(station)

    def _forget(self, station: Station) -> None:
        del self._stations[station.session.number]
        self._spent_nonces.append((station.address, station.session.hello.nonce))
        if station.steps:
            self._ended.append(self._report(station))
            self._events.append(MasterLeft(station))
        else:
            self.never_used += 1
            self.strangers.absorb(station.session.received)
            self.to_strangers.absorb(station.session.sent)
