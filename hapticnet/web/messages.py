"""Messages between the server and the pages it serves: their specification. Those of the server are made here.

Those of a page are read in `requests`.

Addresses
---------
==============================  =====================================================================================
``/watch?token=T``              the watch view (``watch.html``): everything, and the controls
``/operator?token=T``           the operator view (``operator.html``): the scene only
``/socket/watch?token=T``       WebSocket of the watch view
``/socket/operator?token=T``    WebSocket of the operator view
``/static/NAME``                a file of ``hapticnet/web/static``; needs no token and contains no data
==============================  =====================================================================================

Each view has a token of its own, so a person at the operator view cannot change the address and see the rest. A page
takes its view from the last part of its path and its token from its own address, and opens
``ws://HOST/socket/VIEW?token=T``. The server closes the socket with one of `CloseCode`, and a reason for a person;
after any other code (1001 and 1006 are usual) the page tries again after 0.5 s, and after at most 5 s.

A trial must not reveal the condition, and neither may the data that is sent to it: the operator view gets the
needle, the surfaces, the hand, and whether the scene can be touched. It gets no force, no stiffness, no breach force,
no name, no codec, no counter and no event. Its messages have the same sizes and come at the same times whatever is
transmitted.

Binary messages are little-endian, with each number aligned to its size. JSON messages are text, one object each, with
the key ``type``. Positions are in metres and increase into the tissue; forces are in newtons and positive when they
push out of it.

From the server, binary, `MESSAGES_PER_S` times a second
--------------------------------------------------------
``FRAME``, to both views: the scene now.

======  ========  ===================================================================================================
offset  type      meaning
======  ========  ===================================================================================================
0       u8        1
1       u8        state of the hand: 0 free, 1 live, 2 holding, 3 withdrawing (`operator.live.HandState`)
2       u16       number of surfaces n; 0 while the scene is not known
4       u32       number of this frame, counted by the server; a gap shows that frames were left out
8       f64       ``time_ms`` of the newest HAND message of this page; 0 if there was none
16      f32       position of the needle's tip [m]
20      n × f32   position of each surface [m], front to back; it follows the tip while the tissue is indented
20+4n   n × u8    contact with each tissue: 0 none, 1 indented, 2 penetrated
======  ========  ===================================================================================================

``SAMPLES``, to the watch view only: each tick of the master since the last message. The first one after the hello holds
up to `HISTORY_S` of the past.

======  ============  ===============================================================================================
offset  type          meaning
======  ============  ===============================================================================================
0       u8            2
1       u8            number of columns c, at most 255
2       u16           number of rows r
4       u32           number of the first row, modulo 2³²; rows are numbered without gaps, so a gap shows that messages
                      were left out for this page (it reads too slowly)
8       f64           time of the first row [s] since the server began
16      c × r × f32   column by column, in the order of ``columns`` in the hello
======  ============  ===============================================================================================

Columns, `COLUMNS`. A page must find a column by its name, and ignore names that it does not know.

=============  ========================================================================================================
``t``          time [s] since the first row of this message
``position``   position of the tool's tip [m]; the first axis if there are several
``true``       force of the scene at that position [N], from the server's copy of the scene; NaN while it is not known
``received``   force that the decoder reconstructs [N]
``held``       force being held [N]: ``received``, decayed where the link is stale
``target``     force requested of the device, after all limits [N]
``sensed``     force that the device senses [N]
``platform``   displacement of the device's platform [m]
``packets``    FORCE datagrams that arrived since the row before
=============  ========================================================================================================

With several axes, ``true``, ``received`` and ``held`` are Euclidean norms. Without a device, ``target``, ``sensed`` and
``platform`` are 0.

From the server, JSON
---------------------
``hello``, first, to both views::

    {"type": "hello", "version": 1, "view": "operator",
     "messages_per_s": 60,
     "hand": {"source": "page",          // or "scripted", "trace", …: then nobody can take it
              "speed_m_per_s": 0.06,     // fastest motion of the needle
              "delay_ms": 50,            // how far the needle trails a steadily moving hand
              "repeat_ms": 100}}         // longest pause between HAND messages while the page has the hand

The hello of the watch view has, besides::

     "rate_hz": 1000, "axes": 1, "device": "…" or null, "largest_n": 4.6 or null, "master": "…", "hapticnet": "0.1.0",
     "columns": ["t", "position", …], "history_s": 5,
     "codecs": [{"name": "deadband", "summary": "…"}, …],
     "limits": {"multiplier": [0, 8], "delay_ms": [0, 250], "loss_percent": [0, 50]},
     "adjustable": ["multiplier", "codec", "delay_ms", "loss_percent"],   // what this server lets a page change
     "operator_url": "http://…"                                           // of the operator view, to open elsewhere

``scene``, to both, after the hello and when the scene changes::

    {"type": "scene", "known": true, "range_m": [0.0, 0.085],   // where the needle can be
     "tissues": [{"rest_m": 0.02}, …]}                          // front to back; empty if not known

To the watch view it has a ``name``, and each tissue ``name``, ``stiffness_n_per_m`` and ``breach_force_n``.

``hand``, to both, after the hello and when it changes::

    {"type": "hand", "holder": "you" | "another" | "nobody", "state": "free"}

``state`` is ``"free"``, ``"live"``, ``"holding"`` or ``"withdrawing"``. The holder changes to ``"nobody"`` when the
needle is withdrawn because the page fell silent; the page must then take the hand again.

``ready``, to both, after the hello and when it changes: whether there is a slave whose scene can be touched. A change
of codec is not a change of this::

    {"type": "ready", "ready": true}

``state``, to the watch view, `STATES_PER_S` times a second::

    {"type": "state", "t_s": 12.4, "link": "established", "connections": 1, "sealed": false,
     "codec": "deadband", "parameters": {"step_n": 0}, "multiplier": 1.0, "weber_fraction": 0.05, "floor_n": 0.025,
     "delay_ms": 0, "loss_percent": 0,              // of the emulated channel, in each direction
     "round_trip_ms": 0.41 or null,                 // median over the last second
     "feedback": TRAFFIC, "forward": TRAFFIC,
     "arrived": 1400, "lost": 0,                    // datagrams of the slave since ``since_s``
     "device": "ready" or null,                     // its status in words
     "pages": {"watch": 2, "operator": 1, "left_out": 0}}   // left_out: messages that slow pages did not get

    TRAFFIC = {"packets_per_s": 21, "bytes_per_s": 1344,                  // over the last second, UDP and IP headers
               "raw_packets_per_s": 1000, "raw_bytes_per_s": 49000,       // the same if every sample were sent raw
               "packets": 812, "bytes": 51968, "raw_packets": 12400, "raw_bytes": 607600}   // since ``since_s``,
                                                                          // while a force was felt

``link`` is the state of the session: connecting, established, stale, closing or closed. ``state`` also has ``since_s``,
the time when codec, multiplier, delay or loss last changed (0 at first). The threshold of the deadband around a force F
is ``multiplier · max(weber_fraction · |F|, floor_n)``.

``event``, to the watch view: something to tell a person::

    {"type": "event", "t_s": 3.2, "text": "link stale: nothing arrived from the slave; …"}

The newest `EVENTS_KEPT` come after the hello.

``error``, to the page whose message was refused::

    {"type": "error", "message": "delay_ms is 900; it must be between 0 and 250"}

A page must ignore messages of unknown type.

In an experiment
----------------
There is the operator view only, and one page at a time. Its hello has ``"experiment": {"masking_noise": false,
"texts": {"connected": "…", …}}``: whether masking noise begins with the first press on the page, and what the page says
around the tasks (`hapticnet.study.texts.Texts.for_page`). Tissues have a name, which is their number from
front to back. Frames come, and the hand can be taken, only while a scene can be touched.

``task``, after the hello and when it changes: what to show, and which keys do something (`hapticnet.study.screens`)::

    {"type": "task", "number": 7, "screen": "trial", "title": "Feel the three tissues", "text": "…",
     "keys": [{"key": "1", "does": "tissue 1"}, {"key": "escape", "does": "stop: …"}],
     "typed": "21",                         // what has been typed of an answer
     "remark": "",                          // what was wrong with the last key
     "progress": "3 of 40 trials",          // may be empty
     "wait_s": 0.0}                         // time until the key ``enter`` does something

``screen`` is one of ``instructions``, ``consent``, ``about``, ``meet``, ``practice``, ``trial``, ``stimuli``,
``question``, ``moment``, ``feedback``, ``repeat``, ``rating``, ``break``, ``stopped`` and ``done``; a page shows the
scene in a ``trial``. No task names a condition or a force, or, outside of practice, the right answer.

From the page, binary
---------------------
``HAND``, `requests.HAND_BYTES` bytes, while the page has the hand: for each motion, at most `HANDS_PER_S` a second,
and again every ``repeat_ms`` while nothing moves.

======  ====  =======================================================================================================
offset  type  meaning
======  ====  =======================================================================================================
0       u8    1
1       u8    0, reserved
2       u16   0, reserved
4       f32   position wanted of the needle's tip [m]; the server limits it to ``range_m`` and limits the speed
8       f64   ``time_ms``: ``event.timeStamp`` of the motion; FRAME returns it
======  ====  =======================================================================================================

If none comes for `HOLD_AFTER_US`, the needle stops where it is; after `WITHDRAW_AFTER_US`, and when the socket closes,
it is withdrawn at the speed limit and the hand is free.

From the page, JSON
-------------------
==========================================  =========================================================================
``{"type": "take"}``                        take the hand; refused with ``error`` while another page has it
``{"type": "release"}``                     give the hand back: the needle is withdrawn; sent when the page is hidden
``{"type": "let_go"}``                      watch view: withdraw the needle and free the hand, whoever has it
``{"type": "set", "multiplier": 2.0}``      watch view: change what ``adjustable`` lists, one or several keys;
                                            ``"codec"`` is the name of one in ``codecs``
``{"type": "key", "number": 7,``            experiment: press a key of the task with this number; ignored if that
``"key": "enter"}``                         task is over, so that no press is taken for the answer to another question
``{"type": "noise", "level": 0.3}``         experiment: the level of the masking noise is now this share of full
                                            scale; 0 if it is off
==========================================  =========================================================================

The answer to ``set`` is the next ``state``, or an ``error`` and no change at all. A message that is not of this
specification is counted and answered with ``error``; after `requests.MOST_MISTAKES` the server closes the socket.
"""

import enum
import json
import struct
from collections.abc import Sequence
from typing import Any, Final, Literal, TypeAlias, get_args

from hapticnet.arrays import FloatArray
from hapticnet.operator.live import HandState

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
_FRAME_HEAD: Final = struct.Struct("<BBHIdf")
_SAMPLES_HEAD: Final = struct.Struct("<BBHId")
MOST_ROWS: Final = 0xFFFF


class CloseCode(enum.IntEnum):
    """Why the server closes a socket; after one of these a page does not try again by itself."""

    WRONG_TOKEN = 4401
    TOO_MANY_MISTAKES = 4400
    TOO_MANY_MESSAGES = 4429
    TOO_MANY_PAGES = 4503
    ANOTHER_PAGE = 4409
    MASTER_ENDED = 4410


def frame(
    state: HandState, number: int, time_ms: float, tip_m: float, surfaces_m: Sequence[float], contacts: Sequence[int]
) -> bytes:
    """Return a FRAME message."""
    count = len(surfaces_m)
    head = _FRAME_HEAD.pack(FRAME, state, count, number & 0xFFFFFFFF, time_ms, tip_m)
    return head + struct.pack(f"<{count}f{count}B", *surfaces_m, *contacts)


def samples(first_row: int, start_s: float, columns: FloatArray) -> bytes:
    """Return a SAMPLES message for columns of shape (columns, rows), with at most `MOST_ROWS` rows."""
    count, rows = columns.shape
    return _SAMPLES_HEAD.pack(SAMPLES, count, rows, first_row & 0xFFFFFFFF, start_s) + columns.astype("<f4").tobytes()


def text(kind: str, **content: Any) -> str:
    """Return a JSON message. JSON has no NaN and no infinity; they are a mistake of the caller."""
    return json.dumps({"type": kind, **content}, allow_nan=False)
