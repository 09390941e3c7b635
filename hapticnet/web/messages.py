"""Messages between the server and the pages it serves: their specification, how to make the server's and read a page's.

The watch view shows everything and has the controls; the operator view shows the scene only. Each has a token of its
own, so a person at the operator view cannot change the address and see the rest. A view is at ``/VIEW?token=T``, and
opens the WebSocket ``/socket/VIEW?token=T`` with the token of its address; ``/static/NAME`` needs no token. The
server closes the socket with one of `CloseCode` and a reason for a person; after any other code the page tries again.

A trial must not reveal the condition, and neither may the data sent to it: the operator view gets the needle, the
surfaces, the hand, and whether the scene can be touched; no force, stiffness, breach force, name, codec, counter or
event. Its messages have the same sizes and come at the same times whatever is transmitted.

Binary messages are little-endian, each number aligned to its size. JSON messages are text, one object each, with a key
``type``; messages of unknown type are ignored. Positions are in metres and increase into the tissue; forces are in
newtons and positive when they push out of it. `HandState` numbers the states of the hand, `Contact` a contact's.

From the server, binary, `MESSAGES_PER_S` times a second
--------------------------------------------------------
``FRAME``, to both views, the scene now: u8 1; u8 state of the hand; u16 number n of surfaces, 0 while the scene is not
known; u32 number of the frame, in which a gap shows that frames were left out; f64 ``time_ms`` of this page's newest
HAND, or 0; f32 position of the needle's tip; n × f32 position of each surface, front to back, which follows the tip
while the tissue is indented; n × u8 contact with each tissue. With several axes n is 0, and f32 position of the tool
on each further axis follows; to the watch view then f32 held force [N] on each axis.

``SAMPLES``, to the watch view, each tick since the last message: u8 2; u8 number c of columns; u16 number r of rows;
u32 number of the first row modulo 2³², in which a gap shows that messages were left out because the page reads too
slowly; f64 time of the first row [s] since the server began; c × r × f32, column by column, in the order of ``columns``
in the hello. A page finds a column by its name:

=============  ========================================================================================================
``t``          time [s] since the first row of this message
``position``   position of the tool's tip [m]; the first axis if there are several
``true``       force of the scene there [N], from the server's copy of the scene; NaN while it is not known
``received``   force that the decoder reconstructs [N]
``held``       force being held [N]: ``received``, decayed where the link is stale
``target``     force requested of the device, after all limits [N]; like the next two, 0 without a device
``sensed``     force that the device senses [N]
``platform``   displacement of the device's platform [m]
``packets``    FORCE datagrams that arrived since the row before
=============  ========================================================================================================

With several axes, ``true``, ``received`` and ``held`` are Euclidean norms.

``VIBRATION``, to the watch view, while vibration is played: u8 3; u8 0; u16 number n of samples; n × f32 acceleration
that was played since the last such message [m/s²], at 2800 Hz.

From the server, JSON
---------------------
To both views, after the hello and when they change::

    {"type": "hello", "version": 1, "view": "operator", "messages_per_s": 60,      // first, and once
     "hand": {"source": "page",       // or "scripted", "trace", …: then no page can take it
              "speed_m_per_s": 0.06,  // fastest motion of the needle
              "delay_ms": 50,         // how far the needle trails a steadily moving hand
              "repeat_ms": 100}}      // longest pause between HAND messages while the page has the hand
    {"type": "scene", "known": true, "range_m": [0.0, 0.085],                      // where the needle can be
     "tissues": [{"rest_m": 0.02}, …],                                             // front to back; empty if not known
     "axes": 1, "reach_m": 0.05}                                                   // on further axes, to each side
    {"type": "shapes", "count": 2,          // how the scene looks, if it says so: number of shapes, and those that are
     "changed": {"0": ["sphere", [0.034, 0, 0], [0.012, 0, 0], [1, 0, 0], [0, 1, 0]]}}  // new: see `scene.shapes.Shape`
    {"type": "hand", "holder": "you" | "another" | "nobody", "state": "free" | "live" | "holding" | "withdrawing"}
    {"type": "ready", "ready": true}  // whether a slave's scene can be touched; a change of codec does not change this
    {"type": "error", "message": "delay_ms is 900; it must be between 0 and 250"}  // its message was refused

To the watch view, the hello has ``rate_hz``, ``axes``, ``device``, ``largest_n``, ``master``, ``hapticnet``,
``columns``, ``history_s``, ``codecs`` (each with ``name`` and ``summary``), ``limits`` and ``adjustable`` (what a page
may change), and ``operator_url``; the scene has a ``name`` and ``parts`` (their labels, if there are several; the first
is shown), and each tissue ``name``, ``stiffness_n_per_m`` and ``breach_force_n``. To it alone::

    {"type": "event", "t_s": 3.2, "text": "link stale: …"}                         // the newest `EVENTS_KEPT` at first
    {"type": "state", "t_s": 12.4, "link": "established", "connections": 1, "sealed": false,  // `STATES_PER_S` a second
     "codec": "deadband", "parameters": {"step_n": 0}, "multiplier": 1.0, "weber_fraction": 0.05, "floor_n": 0.025,
     "delay_ms": 0, "loss_percent": 0,         // of the emulated channel, in each direction
     "since_s": 0.0,                           // when codec, multiplier, delay or loss last changed
     "round_trip_ms": 0.41 or null,            // median over the last second
     "feedback": TRAFFIC, "forward": TRAFFIC, "arrived": 1400, "lost": 0,          // datagrams of the slave since then
     "device": "ready" or null,                // its status in words
     "pages": {"watch": 2, "operator": 1, "left_out": 0}}                          // messages not sent to slow pages

    TRAFFIC = {"packets_per_s": 21, "bytes_per_s": 1344,                           // over the last second, with headers
               "raw_packets_per_s": 1000, "raw_bytes_per_s": 49000,                // the same if all samples were sent
               "packets": 812, "bytes": 51968, "raw_packets": 12400, "raw_bytes": 607600}  // since then, in contact

A page of another package (`audience.Audience.further`) may have further messages in both directions.

From the page
-------------
``HAND``, `HAND_BYTES` bytes and 4 for each further axis, while the page has the hand, for each motion, at most
`HANDS_PER_S` a second, and again every ``repeat_ms``: u8 1; u8 0; u16 0; f32 position wanted of the needle's tip, which
the server limits to ``range_m`` and in speed; f64 ``time_ms``, the motion's ``event.timeStamp``, which FRAME returns;
f32 for each further axis. If none comes for `HOLD_AFTER_US`, the needle stops; after `WITHDRAW_AFTER_US`, and when the
socket closes, it is withdrawn and the hand is free.

==========================================  =========================================================================
``{"type": "take"}``                        take the hand; refused with ``error`` while another page has it
``{"type": "release"}``                     give the hand back: the needle is withdrawn; sent when the page is hidden
``{"type": "let_go"}``                      watch view: withdraw the needle and free the hand from any page
``{"type": "set", "multiplier": 2.0}``      watch view: change one or several settings of ``adjustable``
==========================================  =========================================================================

The answer to ``set`` is the next ``state``, or an ``error`` and no change at all. A message that is not of this
specification is counted and answered with ``error``; after `MOST_MISTAKES` the server closes the socket.
"""

import enum
import json
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, TypeAlias, get_args

from hapticnet.arrays import FloatArray
from hapticnet.errors import PeerError
from hapticnet.operator.live import HandState
from hapticnet.samples import MAX_AXES, Vector
from hapticnet.vectors import in_range

VERSION: Final = 1
View: TypeAlias = Literal["operator", "watch"]
VIEWS: Final[tuple[View, ...]] = get_args(View)
MESSAGES_PER_S: Final = 60
STATES_PER_S: Final = 5
HISTORY_S: Final = 5.0
EVENTS_KEPT: Final = 20
HANDS_PER_S: Final = 250
REPEAT_MS: Final = 100
COLUMNS: Final = ("t", "position", "true", "received", "held", "target", "sensed", "platform", "packets")
FRAME: Final = 1
SAMPLES: Final = 2
VIBRATION: Final = 3
_FRAME_HEAD: Final = struct.Struct("<BBHIdf")
_SAMPLES_HEAD: Final = struct.Struct("<BBHId")
MOST_ROWS: Final = 0xFFFF
MOST_MISTAKES: Final = 20
LARGEST_MESSAGE: Final = 4096  # limit of a message from a page [B]
HAND: Final = 1
_HAND: Final = struct.Struct("<BBHfd")
HAND_BYTES: Final = _HAND.size


class CloseCode(enum.IntEnum):
    """Why the server closes a socket; after these a page does not try again by itself."""

    WRONG_TOKEN = 4401
    TOO_MANY_MISTAKES = 4400
    TOO_MANY_MESSAGES = 4429
    TOO_MANY_PAGES = 4503
    ANOTHER_PAGE = 4409
    MASTER_ENDED = 4410
    NOT_STARTED = 4500


def frame(
    state: HandState,
    number: int,
    time_ms: float,
    tip_m: float,
    surfaces_m: Sequence[float],
    contacts: Sequence[int],
    further: Sequence[float] = (),
) -> bytes:
    """Return a FRAME message; `further`: what follows with several axes."""
    count = len(surfaces_m)
    head = _FRAME_HEAD.pack(FRAME, state, count, number & 0xFFFFFFFF, time_ms, tip_m)
    return head + struct.pack(f"<{count}f{count}B{len(further)}f", *surfaces_m, *contacts, *further)


def samples(first_row: int, start_s: float, columns: FloatArray) -> bytes:
    """Return a SAMPLES message for columns of shape (columns, rows), with at most `MOST_ROWS` rows."""
    count, rows = columns.shape
    return _SAMPLES_HEAD.pack(SAMPLES, count, rows, first_row & 0xFFFFFFFF, start_s) + columns.astype("<f4").tobytes()


def vibration(played_m_s2: Sequence[float]) -> bytes:
    """Return a VIBRATION message, with at most `MOST_ROWS` samples."""
    count = len(played_m_s2)
    return struct.pack(f"<BBH{count}f", VIBRATION, 0, count, *played_m_s2)


def text(kind: str, **content: Any) -> str:
    """Return a JSON message. JSON has no NaN and no infinity; they are a mistake of the caller."""
    return json.dumps({"type": kind, **content}, allow_nan=False)


class MistakeError(PeerError):
    """A message from a page is outside this specification."""


class Hand(NamedTuple):
    """A position of the hand from a page."""

    position_m: Vector
    time_ms: float


class Order(enum.Enum):
    """Take the hand, give it back, or withdraw the needle and free the hand from any page."""

    TAKE = "take"
    RELEASE = "release"
    LET_GO = "let_go"


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Settings to change during a run; None leaves one unchanged."""

    multiplier: float | None = None
    codec: str | None = None
    delay_ms: float | None = None
    loss_percent: float | None = None


Reader: TypeAlias = Callable[[dict[str, Any]], object]
"""Returns a message from its content; raises MistakeError if that is invalid."""

LIMITS: Final[dict[str, tuple[float, float]]] = {  # ranges of the settings that a page may change
    "multiplier": (0.0, 8.0),
    "delay_ms": (0.0, 250.0),  # each way: well below the largest age of a force, 1 s
    "loss_percent": (0.0, 50.0),
}


def parse_binary(data: bytes) -> Hand:
    """Return the HAND message in `data`; raise MistakeError if it is invalid, or its numbers are not finite."""
    further = (len(data) - HAND_BYTES) // 4
    if not 0 <= further < MAX_AXES or (len(data) - HAND_BYTES) % 4 or data[0] != HAND:
        kind = data[0] if data else "none"
        raise MistakeError(
            f"binary message of {len(data)} bytes and kind {kind}; expected {HAND_BYTES} for one axis, and kind {HAND}"
        )
    _, _, _, first_m, time_ms = _HAND.unpack_from(data)
    position_m = (first_m, *struct.unpack_from(f"<{further}f", data, HAND_BYTES))
    if not in_range(position_m) or not math.isfinite(time_ms):
        raise MistakeError(f"the hand is at {position_m} m at {time_ms} ms; both must be finite")
    return Hand(position_m, time_ms)


def parse_text(data: str, further: Mapping[str, Reader] = {}) -> object:
    """Return the JSON message in `data`: an Order, a Change, or what a reader in `further`, by type, returns.

    Raises MistakeError if the message is invalid, of unknown type, or a value is out of range.
    """
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise MistakeError(f"{data[:40]!r} is not JSON") from None
    if not isinstance(content, dict) or not isinstance(kind := content.pop("type", None), str):
        raise MistakeError("a message must be an object with a 'type'")
    if kind == "set":
        return _change(content)
    if kind in further:
        return further[kind](content)
    orders = {each.value: each for each in Order}
    if kind not in orders:
        raise MistakeError(f"unknown message {kind[:40]!r}; there are: {', '.join([*orders, 'set', *further])}")
    if content:
        raise MistakeError(f"message {kind!r} has no key {next(iter(content))[:40]!r}")
    return orders[kind]


def _change(content: dict[str, Any]) -> Change:
    if not content:
        raise MistakeError(f"message 'set' changes nothing; it takes: {', '.join(Change.__dataclass_fields__)}")
    for key, value in content.items():
        if key == "codec":
            if not isinstance(value, str):
                raise MistakeError("codec must be a name")
        elif key not in LIMITS:
            raise MistakeError(f"cannot set {key[:40]!r}; only: {', '.join(Change.__dataclass_fields__)}")
        else:
            number(key, value, *LIMITS[key])
    return Change(**content)


def number(name: str, value: Any, low: float, high: float, *, whole: bool = False) -> Any:
    """Return a number from a page; MistakeError if it is none, or out of range."""
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise MistakeError(f"{name} must be a {'whole ' * whole}number")
    if not low <= value <= high:
        raise MistakeError(f"{name} is {str(value)[:20]}; it must be between {low:g} and {high:g}")
    return value
