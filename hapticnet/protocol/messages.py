"""The messages: each is a tuple whose fields, in order, are the body of its datagram."""

import enum
import math
from typing import Any, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.errors import PeerError
from hapticnet.parts import PartsLaw, parse_parts
from hapticnet.perception import WeberLaw
from hapticnet.protocol.stats import REPORT_STEPS, Loss
from hapticnet.protocol.wire import MODULUS, OPEN, Kind, is_uint32, pack, pack_body, unpack_body
from hapticnet.samples import MAX_AXES, MOST_COMPONENTS, new_tuple


class Range(NamedTuple):
    """A closed range of numbers, and 0 where `zero_allowed`."""

    name: str
    smallest: float
    largest: float
    unit: str = ""
    zero_allowed: bool = False

    def has(self, value: float) -> bool:
        """Return whether a number is in the range; NaN is not."""
        return self.smallest <= value <= self.largest or (self.zero_allowed and value == 0)

    def check(self, value: float) -> None:
        """Raise SettingsError if a number is not in the range."""
        check_parameter(self.name, value, self.smallest, self.largest, self.unit, zero_allowed=self.zero_allowed)


RATE_HZ: Final = Range("rate", 20.0, 100_000.0, "Hz")
"""Positions per second. A slave sends only when it receives: at 20 Hz, four times per age limit of 200 ms."""

POSITION_SHARE: Final = Range("share of positions", 0.01, 0.9, zero_allowed=True)
"""Share of the JND that positions may use; 0: every position is sent."""

KEEPALIVE_US: Final = Range("keepalive interval", 1_000, 50_000, "µs")
"""Longest silence without loss: at most a quarter of the age limit of 200 ms."""

CLOCK_US: Final = Range("clock", 0, (1 << 53) - 1, "µs")
"""The master's clock: 285 years, which recordings hold as float64 without rounding."""

HELLO_SEQUENCE: Final = Range("sequence of a sealed HELLO", 0, (1 << 20) - 1)
"""The first epoch of keys (`protocol.seal`): a session that begins later could not open its datagrams."""

VIBRATION_BUDGET: Final = Range("vibration budget", 500.0, 1e6, "B/s")
"""Bytes a second that VIBRATION datagrams may take, without UDP and IP headers; half a second's can be saved up."""

VIBRATION_THRESHOLD: Final = Range("vibration threshold", 0.001, 10.0, "m/s²")
"""Amplitude of the weakest vibration that the person at the master feels, up to 250 Hz (`codec.vibration`)."""

PERCENT: Final = Range("loss", 0, 100, "%")  # shares in the report of loss
WAITED_MS: Final = Range("wait", 0, 255, "ms")


HELLO_BYTES: Final = 400
"""Smallest HELLO datagram [B]: no answer to an unknown peer is larger, so a flood of forged HELLOs is not amplified."""

NAME_BYTES: Final = 64
REASON_BYTES: Final = 200
COOKIE_BYTES: Final = 16

TICKET_BYTES: Final = 16


class Code(enum.IntEnum):
    """Why a session was refused or closed, for a program to act on. An unlisted number reads as `OTHER`."""

    OTHER = 0
    VERSION = 1
    CODEC = 2
    PARAMETER = 3
    AXES = 4
    FULL = 5
    FAILED = 6
    KEY = 7
    STOPPING = 8
    SLOW = 9
    SHAPES = 10

    @classmethod
    def _missing_(cls, value: object) -> "Code":  # noqa: ARG003 - the signature is the enum module's
        return cls.OTHER


class Hello(NamedTuple):
    """Master to slave: asks for a session."""

    nonce: int  # fresh for each requested session; repeated in every answer
    cookie: bytes  # from the slave's COOKIE for this nonce; empty at first
    request: bytes  # a packed `Request`; in version 2 the first Noise message, which contains it
    mac: bytes = b""  # shows that the sender knows the slave's public key (version 2); empty in version 1


class Request(NamedTuple):
    """The session that a master asks for. The JND belongs to the person at the master.

    `ticket` belongs to the session whose scene it wants to continue, or is None. `clock_us` is the master's clock
    when it asks [µs]: time stamps of positions are its lower 32 bits, so that with it both sides record the same
    times. `announced` says whether it renders models of the contact ahead. `position_share` is the share of the JND
    that positions may use, if they are sent only when they matter; 0: every position is sent. `predicted` asks
    for forces where the hand will be when they arrive. `coupling` is the name and the parameters of a coupling that
    needs an end at the slave (docs/refer/payloads.md), or None. `vibration` asks for vibration beside force: its budget
    [B/s] and the person's threshold [m/s²]; None: not asked for. `parts` are the parts of positions and forces, and the
    threshold of each kind other than force (Weber fraction, smallest threshold); None: one force.
    """

    codec: str
    parameters: dict[str, float]
    weber_fraction: float
    floor_n: float
    multiplier: float
    rate_hz: float
    axes: int
    name: str
    ticket: bytes | None = None
    clock_us: int = 0
    announced: bool = False
    position_share: float = 0.0
    predicted: bool = False
    coupling: tuple[str, dict[str, float]] | None = None
    vibration: tuple[float, float] | None = None
    parts: tuple[tuple[str, ...], dict[str, tuple[float, float]]] | None = None

    def check(self) -> None:
        """Raise SettingsError if a number is out of its range; codec and perception check theirs."""
        RATE_HZ.check(self.rate_hz)
        POSITION_SHARE.check(self.position_share)
        if self.vibration is not None:
            VIBRATION_BUDGET.check(self.vibration[0])
            VIBRATION_THRESHOLD.check(self.vibration[1])

    def law(self) -> WeberLaw:
        """Return the law of the person at the master; SettingsError if a number is out of its range."""
        law = WeberLaw(weber_fraction=self.weber_fraction, floor_n=self.floor_n, multiplier=self.multiplier)
        return law if self.parts is None else PartsLaw.of(parse_parts(self.parts[0]), law, self.parts[1])


class Cookie(NamedTuple):
    """Slave to master: repeat the HELLO with this cookie, to show that you receive at your address."""

    nonce: int
    cookie: bytes


class Welcome(NamedTuple):
    """Slave to master: a packed `Grant`; in version 2 the second Noise message, whose payload is a grant or refusal."""

    nonce: int
    grant: bytes


class Grant(NamedTuple):
    """The session that a slave grants."""

    session: int  # number of the session
    rate_hz: float  # positions per second served
    keepalive_us: int  # longest silence while positions arrive
    scene: str  # name of the scene
    ticket: bytes  # lets a later session continue this one's scene
    resumed: bool  # whether this session continues the scene of an earlier one
    announced: bool = False  # whether the contact ahead is announced (docs/refer/payloads.md)
    position_share: float = 0.0  # as in the request; 0 if the master must send every position
    predicted: bool = False  # whether the forces are those where the hand will be when they arrive
    vibration: bool = False  # whether VIBRATION comes beside force
    frame: str | None = None  # where the axes of the scene point, in words for a person; None: not said

    def __repr__(self) -> str:
        """Return the fields without the ticket, which is not for logs."""
        shown = {name: value for name, value in self._asdict().items() if name != "ticket"}
        return f"Grant({', '.join(f'{name}={value!r}' for name, value in shown.items())})"


class Refuse(NamedTuple):
    """Slave to master: no session, and why. Not authenticated in any version."""

    nonce: int
    reason: str
    code: Code = Code.OTHER


class Refusal(NamedTuple):
    """No session, and why, instead of a grant in a sealed WELCOME; `session` is 0."""

    session: int
    reason: str
    code: Code = Code.OTHER


class Position(NamedTuple):
    """Master to slave: the position of the tool tip."""

    t_us: int  # time of the position on the master's clock
    newest: int | None  # sequence of the newest FORCE applied, or of a KEEPALIVE after it that confirmed it
    payload: bytes  # the position
    loss: Loss | None = None  # how many of the slave's datagrams the master misses; None: not reported
    waited_ms: int = 0  # time since the datagram it names arrived, with few positions


class Force(NamedTuple):
    """Slave to master: the whole stimulus for the position of time `t_us`, and possibly a stiffness bound."""

    t_us: int
    payload: bytes
    bound: bytes | None = None


class Keepalive(NamedTuple):
    """Slave to master: position `t_us` was received, and FORCE `newest_force` still holds."""

    t_us: int
    newest_force: int | None
    bound: bytes | None = None


class Vibration(NamedTuple):
    """Slave to master: a frame of acceleration that begins at `t_us`, and, during loss, the one before it again."""

    t_us: int
    payload: bytes
    before: bytes | None = None


class Close(NamedTuple):
    """Either way: the session ends. The slave answers a CLOSE with a CLOSE."""

    reason: str
    code: Code = Code.OTHER


class Notice(NamedTuple):
    """Either way: a notice for the person at the master, how the scene looks, or the wish to know that."""

    reason: str
    code: Code
    shapes: bytes | None = None


def pack_hello(hello: Hello, sequence: int, version: int = OPEN) -> bytes:
    """Return a HELLO datagram, padded to `HELLO_BYTES`."""
    bare = pack(Kind.HELLO, 0, sequence, pack_body((*hello, b"")), version)
    padding = bytes(max(0, HELLO_BYTES - len(bare)))
    return pack(Kind.HELLO, 0, sequence, pack_body((*hello, padding)), version)


def unpack_hello(body: bytes) -> Hello:
    """Return the HELLO in a body; its request is not read. Raise PeerError if it is invalid."""
    nonce, cookie, request, mac, padding = unpack_body(body, 5)
    if not (is_uint32(nonce) and type(cookie) is type(request) is type(mac) is type(padding) is bytes):
        raise PeerError("HELLO of the wrong types")
    return Hello(nonce, cookie, request, mac)


def pack_contents(contents: tuple[Any, ...]) -> bytes:
    """Return a packed request, grant or refusal, without optional fields at its end that say nothing."""
    while contents[-1] is None or contents[-1] is False:
        contents = contents[:-1]
    return pack_body(contents)


def unpack_request(packed: bytes) -> Request:
    """Return the request of a HELLO; raise PeerError if it is invalid. `Request.check` checks the ranges."""
    fields = unpack_body(packed, 12, optional=4)
    codec, parameters, *law, rate_hz, axes, name, ticket, clock_us, announced, share = fields[:12]
    predicted = len(fields) > 12 and fields[12]
    coupling = fields[13] if len(fields) > 13 else None
    vibration = fields[14] if len(fields) > 14 else None
    parts = _parts(fields[15]) if len(fields) > 15 else None
    numbers = _numbers(codec, parameters, "codec")
    if coupling is not None:
        _require(type(coupling) is tuple and len(coupling) == 2, "coupling", coupling)
        coupling = coupling[0], _numbers(coupling[0], coupling[1], "coupling")
    _require(all(map(_is_number, law)), "JND", law)
    _require(_is_number(rate_hz), "rate", rate_hz)
    most = MAX_AXES if parts is None else MOST_COMPONENTS
    _require(type(axes) is int and 1 <= axes <= most, "axes", axes)
    _require(_is_text(name, NAME_BYTES), "name", name)
    _require(ticket is None or _is_bytes(ticket, TICKET_BYTES), "ticket", ticket)
    _require(type(clock_us) is int and CLOCK_US.has(clock_us), "clock", clock_us)
    _require(type(announced) is bool, "announced", announced)
    _require(_is_number(share), "share of positions", share)
    _require(type(predicted) is bool, "predicted", predicted)
    if vibration is not None:
        _require(
            type(vibration) is tuple and len(vibration) == 2 and all(map(_is_number, vibration)), "vibration", vibration
        )
        vibration = float(vibration[0]), float(vibration[1])
    weber_fraction, floor_n, multiplier = map(float, law)
    law_and_rate = weber_fraction, floor_n, multiplier, float(rate_hz)
    asked = announced, float(share), predicted, coupling
    return Request(
        codec, numbers, *law_and_rate, axes, name, ticket, clock_us, *asked, vibration=vibration, parts=parts
    )


def _parts(parts: Any) -> tuple[tuple[str, ...], dict[str, tuple[float, float]]] | None:
    """Return the parts of a request, and the thresholds of their kinds; None if nil."""
    if parts is None:
        return None
    _require(type(parts) is tuple and len(parts) == 2, "parts", parts)
    texts, thresholds = parts
    _require(type(texts) is tuple and all(_is_text(text, NAME_BYTES) for text in texts), "parts", texts)
    _require(type(thresholds) is dict, "thresholds", thresholds)
    for kind, numbers in thresholds.items():
        good = _is_text(kind, NAME_BYTES) and type(numbers) is tuple and len(numbers) == 2
        _require(good and all(map(_is_number, numbers)), "threshold", kind)
    return texts, {kind: (float(fraction), float(floor)) for kind, (fraction, floor) in thresholds.items()}


def _numbers(name: Any, parameters: Any, what: str) -> dict[str, float]:
    """Return the parameters of a codec or a coupling, by name."""
    _require(_is_text(name, NAME_BYTES), what, name)
    _require(type(parameters) is dict, "parameters", parameters)
    for key, value in parameters.items():
        _require(_is_text(key, NAME_BYTES) and _is_number(value), "parameter", key)
    return {key: float(value) for key, value in parameters.items()}


def unpack_cookie(body: bytes) -> Cookie:
    """Return the COOKIE in a body; raise PeerError if it is invalid."""
    nonce, cookie = unpack_body(body, 2)
    _require(is_uint32(nonce), "nonce", nonce)
    _require(_is_bytes(cookie, COOKIE_BYTES), "cookie", cookie)
    return Cookie(nonce, cookie)


def unpack_welcome(body: bytes) -> Welcome:
    """Return the WELCOME in a body; its grant is not read. Raise PeerError if it is invalid."""
    nonce, grant = unpack_body(body, 2)
    _require(is_uint32(nonce), "nonce", nonce)
    _require(type(grant) is bytes, "grant", grant)
    return Welcome(nonce, grant)


def unpack_grant(packed: bytes) -> Grant:
    """Return the grant of a WELCOME; raise PeerError if it is invalid."""
    session, rate_hz, keepalive_us, scene, ticket, resumed, announced, share, *more = unpack_body(packed, 8, optional=3)
    predicted = bool(more) and more[0]
    vibration = len(more) > 1 and more[1]
    frame = more[2] if len(more) > 2 else None
    _require(is_uint32(session) and session > 0, "session", session)
    _require(_is_number(rate_hz) and RATE_HZ.has(rate_hz), "rate", rate_hz)
    _require(type(keepalive_us) is int and KEEPALIVE_US.has(keepalive_us), "keepalive interval", keepalive_us)
    _require(_is_text(scene, NAME_BYTES), "scene", scene)
    _require(_is_bytes(ticket, TICKET_BYTES), "ticket", ticket)
    _require(type(resumed) is bool, "resumed", resumed)
    _require(type(announced) is bool, "announced", announced)
    _require(_is_number(share) and POSITION_SHARE.has(share), "share of positions", share)
    _require(type(predicted) is bool, "predicted", predicted)
    _require(type(vibration) is bool, "vibration", vibration)
    _require(frame is None or _is_text(frame, NAME_BYTES), "frame", frame)
    asked = announced, float(share), predicted, vibration, frame
    return Grant(session, float(rate_hz), keepalive_us, scene, ticket, resumed, *asked)


def unpack_grant_or_refusal(packed: bytes) -> Grant | Refusal:
    """Return the payload of a sealed WELCOME; raise PeerError if it is invalid."""
    (session,) = unpack_body(packed, 1)
    if session != 0:
        return unpack_grant(packed)
    _, reason, code = unpack_body(packed, 3)
    _require(_is_text(reason, REASON_BYTES), "reason", reason)
    _require(is_uint32(code), "code", code)
    return Refusal(0, reason, Code(code))


def unpack_refuse(body: bytes) -> Refuse:
    """Return the REFUSE in a body; raise PeerError if it is invalid."""
    nonce, reason, code = unpack_body(body, 3)
    _require(is_uint32(nonce), "nonce", nonce)
    _require(_is_text(reason, REASON_BYTES), "reason", reason)
    _require(is_uint32(code), "code", code)
    return Refuse(nonce, reason, Code(code))


def pack_position(position: Position) -> bytes:
    """Return the body of a POSITION; a report of loss adds two fields of a byte each, and a wait one."""
    loss, waited_ms = position.loss, position.waited_ms
    report = () if loss is None else tuple(round(REPORT_STEPS * share) for share in loss)
    return pack_body((*position[:3], *report, *((waited_ms,) if waited_ms else ())))


def unpack_position(body: bytes) -> Position:
    """Return the POSITION in a body; raise PeerError if it is invalid."""
    fields = unpack_body(body, 3, optional=3)
    t_us, newest, payload = fields if len(fields) == 3 else fields[:3]
    # Written out instead of calling `is_uint32`: every force waits for this.
    if not (
        type(t_us) is int
        and 0 <= t_us < MODULUS
        and (newest is None or (type(newest) is int and 0 <= newest < MODULUS))
        and type(payload) is bytes
    ):
        raise PeerError("POSITION of the wrong types")
    if len(fields) == 3:
        return new_tuple(Position, (t_us, newest, payload, None, 0))
    waited_ms = 0 if len(fields) == 5 else fields[-1]
    _require(type(waited_ms) is int and WAITED_MS.has(waited_ms), "wait", waited_ms)
    if len(fields) == 4:
        return Position(t_us, newest, payload, None, waited_ms)
    share, again = fields[3:5]
    for percent in share, again:
        _require(type(percent) is int and PERCENT.has(percent), "loss in per cent", percent)
    return Position(t_us, newest, payload, Loss(share / REPORT_STEPS, again / REPORT_STEPS), waited_ms)


def pack_answer(answer: Force | Keepalive | Vibration) -> bytes:
    """Return the body of a FORCE, KEEPALIVE or VIBRATION; a stiffness bound or an earlier frame adds a field."""
    return pack_body(answer[:2] if answer[2] is None else answer)


def unpack_force(body: bytes) -> Force:
    """Return the FORCE in a body; raise PeerError if it is invalid."""
    t_us, payload, *more = unpack_body(body, 2, optional=1)
    if not (is_uint32(t_us) and type(payload) is bytes):
        raise PeerError("FORCE of the wrong types")
    return Force(t_us, payload, _bound(more))


def unpack_keepalive(body: bytes) -> Keepalive:
    """Return the KEEPALIVE in a body; raise PeerError if it is invalid."""
    t_us, newest_force, *more = unpack_body(body, 2, optional=1)
    if not (is_uint32(t_us) and (newest_force is None or is_uint32(newest_force))):
        raise PeerError("KEEPALIVE of the wrong types")
    return Keepalive(t_us, newest_force, _bound(more))


def unpack_vibration(body: bytes) -> Vibration:
    """Return the VIBRATION in a body; raise PeerError if it is invalid. Its payloads are not read."""
    t_us, payload, *more = unpack_body(body, 2, optional=1)
    before = more[0] if more else None
    if not (is_uint32(t_us) and type(payload) is bytes and (before is None or type(before) is bytes)):
        raise PeerError("VIBRATION of the wrong types")
    return Vibration(t_us, payload, before)


def unpack_close(body: bytes) -> Close:
    """Return the CLOSE in a body; raise PeerError if it is invalid."""
    return Close(*_reason_and_code(body))


def unpack_notice(body: bytes) -> Notice:
    """Return the NOTICE in a body; raise PeerError if it is invalid."""
    fields = unpack_body(body, 2, optional=1)
    shapes = fields[2] if len(fields) > 2 else None
    _require(shapes is None or type(shapes) is bytes, "shapes", shapes)
    return Notice(*_reason_and_code(body), shapes)


def clipped(text: str, limit: int) -> str:
    """Return `text` cut to at most `limit` bytes of UTF-8, without control characters a terminal would obey."""
    printable = "".join(character if character.isprintable() else "?" for character in text)
    return printable.encode()[:limit].decode(errors="ignore")


def _reason_and_code(body: bytes) -> tuple[str, Code]:
    reason, code = unpack_body(body, 2)
    _require(_is_text(reason, REASON_BYTES), "reason", reason)
    _require(is_uint32(code), "code", code)
    return reason, Code(code)


def _bound(more: list[Any]) -> bytes | None:
    """Return the bound in an answer's optional fields."""
    bound = more[0] if more else None
    _require(bound is None or type(bound) is bytes, "bound", bound)
    return bound


def _is_text(value: object, limit: int) -> bool:
    return type(value) is str and value.isprintable() and len(value.encode()) <= limit


def _is_bytes(value: object, length: int) -> bool:
    return type(value) is bytes and len(value) == length


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and math.isfinite(value)  # type: ignore[arg-type]


def _require(good: bool, what: str, value: Any) -> None:
    if not good:
        raise PeerError(f"{what} {value!r} is not what the protocol allows")
