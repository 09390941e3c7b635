"""Write tests/vectors/protocol.json: the datagrams of open sessions.

Run ``python -m tests.vectors.make_protocol`` after an intended change of the protocol. It packs the fields with msgpack
alone and imports nothing of hapticnet, so that the file says what docs/refer/protocol.md says.
"""

import json
import struct
from pathlib import Path

import msgpack

FILE = Path(__file__).with_name("protocol.json")

NOTE = (
    "Datagrams of open sessions. Byte strings in fields are {'hex': ...}. 'fields' are those of the body, without"
    " HELLO's padding; 'contents' are those of the request in a HELLO and of the grant in a WELCOME."
)

NAMES = ["HELLO", "WELCOME", "REFUSE", "POSITION", "FORCE", "KEEPALIVE", "CLOSE", "RESET", "COOKIE", "NOTICE"]
NAMES.append("VIBRATION")
HELLO, WELCOME, REFUSE, POSITION, FORCE, KEEPALIVE, CLOSE, RESET, COOKIE, NOTICE, VIBRATION = range(1, 12)
HELLO_BYTES = 400
SESSION = 0xDEADBEEF
NONCE = 0x01020304
COOKIE_VALUE = bytes(range(0xC0, 0xD0))
TICKET = bytes(range(0x70, 0x80))
REQUEST = ["deadband", {}, 0.05, 0.025, 1.0, 1000.0, 1, "surgeon", None, 5_000_000_000, False, 0.0]
CONTINUING = ["level-crossing", {"hysteresis": 0.25}, 0.1, 0.0, 1.5, 500.0, 3, "Chirurgin Ä", TICKET, 0, True, 0.25]
GRANT = [SESSION, 1000.0, 45_000, "paper:1", TICKET, False, False, 0.0]
AHEAD = [*REQUEST, True]
PREDICTED = [SESSION + 2, *GRANT[1:], True]
FELT = [*REQUEST, False, None, [4000.0, 0.1]]
POSED = [
    *REQUEST[:6],
    7,
    *REQUEST[7:],
    False,
    None,
    None,
    [["force:3", "torque:3", "grip:1"], {"torque": [0.1, 0.006]}],
]
VIBRATES = [SESSION + 3, *GRANT[1:], False, True]
FRAMED = [SESSION + 4, *GRANT[1:], False, False, "x away from you, z up"]
RESUMED = [SESSION + 1, 500.0, 45_000, "three axes", TICKET, True, True, 0.25]


def number(text):
    return bytes.fromhex(text)


def packed(contents):
    return msgpack.packb(contents)


CONTINUED = [NONCE + 1, COOKIE_VALUE, packed(CONTINUING), b""]
PLACE, BOUND = number("3cac0831"), number("4348000000000000428000003ca3d70b3cf5c28f")
ONE_NEWTON, DOUBLE, THREE_AXES = number("3f800000"), number("3fb999999999999a"), number("3f800000c000000040400000")
LOST = "0.021 m; KEEPALIVE 2 confirmed FORCE 1; 10 % are lost, and after 80 % of these the next one, too"
MOVING = "0.021 m, moving at 0.1 m/s: float32, float16"
BENT = "the same, and faster by 2 m/s², which dies out: another float16"
BALL = struct.pack(">BBB12f", 2, 1, 1, 0.034, 0.004, 0.0, 0.012, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
BETWEEN = "1 N; 200 N/m, which grow by 64 N/m per N, and no damping between 0.02 and 0.03 m"
UNKNOWN = "the scene cannot tell: every position is needed"
AFTER_IT = number("00243850"), number("10478ac71b92")
LAST = "1 N; sequence and time stamp are followed by 0"

OPENING = [
    ("hello", "no cookie yet", HELLO, 0, [NONCE, b"", packed(REQUEST), b""], REQUEST),
    ("cookie", "the same nonce, and 16 bytes to send back", COOKIE, 0, [NONCE, COOKIE_VALUE], None),
    ("hello with the cookie", "all else is the same", HELLO, 0, [NONCE, COOKIE_VALUE, packed(REQUEST), b""], REQUEST),
    ("hello that continues", "with the ticket of an earlier session", HELLO, 0, CONTINUED, CONTINUING),
    ("hello that asks for prediction", "a last field more", HELLO, 0, [NONCE, b"", packed(AHEAD), b""], AHEAD),
    ("hello that asks for vibration", "its budget and threshold", HELLO, 0, [NONCE, b"", packed(FELT), b""], FELT),
    ("hello of several parts", "a threshold of torques", HELLO, 0, [NONCE, b"", packed(POSED), b""], POSED),
    ("welcome", "grants session 0xdeadbeef", WELCOME, SESSION, [NONCE, packed(GRANT)], GRANT),
    ("welcome that resumes", "goes on with a scene", WELCOME, SESSION + 1, [NONCE + 1, packed(RESUMED)], RESUMED),
    ("welcome that predicts", "the same", WELCOME, SESSION + 2, [NONCE, packed(PREDICTED)], PREDICTED),
    ("welcome with vibration", "the same", WELCOME, SESSION + 3, [NONCE, packed(VIBRATES)], VIBRATES),
    ("welcome with a frame", "the same", WELCOME, SESSION + 4, [NONCE, packed(FRAMED)], FRAMED),
    ("refuse", "", REFUSE, 0, [NONCE, "unknown codec 'mp3'; there are: raw, deadband", 2], None),
]
"""Name, note, kind, session, fields, contents; the sequence is 0."""

IN_SESSION = [
    ("first position", "0.02 m as float32; no force applied yet", POSITION, 1, [1000, None, number("3ca3d70a")]),
    ("first force", "0 N answers the position of 1000 us", FORCE, 1, [1000, number("00000000")]),
    ("position that acknowledges", "0.021 m; FORCE 1 is applied", POSITION, 2, [2000, 1, PLACE]),
    ("position that reports loss", LOST, POSITION, 3, [3000, 2, PLACE, 10, 80]),
    ("keepalive", "FORCE 1 still holds", KEEPALIVE, 2, [46_000, 1]),
    ("position that waited", "KEEPALIVE 2 had arrived 12 ms before", POSITION, 6, [47_500, 2, PLACE, 12]),
    ("position with a velocity", MOVING, POSITION, 4, [47_000, 2, PLACE + number("2e66")]),
    ("position with an acceleration", BENT, POSITION, 5, [48_000, 2, PLACE + number("2e664000")]),
    ("force with a stiffness bound", BETWEEN, FORCE, 5, [47_000, ONE_NEWTON, BOUND]),
    ("keepalive with a stiffness bound", UNKNOWN, KEEPALIVE, 6, [48_000, 5, b""]),
    ("numbers about to wrap", LAST, FORCE, 2**32 - 1, [2**32 - 1, ONE_NEWTON]),
    ("numbers that wrapped", "1.1 N", FORCE, 0, [999, number("3f8ccccd")]),
    ("force as float64", "0.1 N where float32 is not within the threshold", FORCE, 3, [3000, DOUBLE]),
    ("three axes", "1, -2, 3 N", FORCE, 4, [4000, THREE_AXES]),
    ("vibration", "the breach of vibration.json, from 40 ms on", VIBRATION, 7, [40_000, number("10478ac71b92")]),
    ("vibration during loss", "and the frame before it again", VIBRATION, 8, [50_000, *AFTER_IT]),
    ("close", "", CLOSE, 70_000, ["done", 0]),
    ("notice", "the session goes on", NOTICE, 70_000, ["this slave is about to stop", 8]),
    ("notice that asks how the scene looks", "by the master", NOTICE, 7, ["", 10]),
    ("notice of a shape", "the second of two is a sphere of 12 mm", NOTICE, 70_002, ["", 10, BALL]),
    ("reset", "the body is empty", RESET, 70_001, []),
]
"""Name, note, kind, sequence, fields."""


def datagram(kind, session, sequence, fields):
    """Return the bytes of a datagram; a HELLO is padded so that it has at least 400."""

    def packed_with(more):
        return packed([1, kind, session, sequence, packed([*fields, *more]) if fields else b""])

    if kind != HELLO:
        return packed_with([])
    return packed_with([bytes(HELLO_BYTES - len(packed_with([b""])))])


def plain(value):
    """Return a value as JSON holds it."""
    if isinstance(value, bytes | bytearray):
        return {"hex": bytes(value).hex()}
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list | tuple) else value


def document():
    entries = []
    rows = [(*row[:4], 0, *row[4:]) for row in OPENING]
    rows += [(*row[:3], SESSION, *row[3:], None) for row in IN_SESSION]
    for name, note, kind, session, sequence, fields, contents in rows:
        data = datagram(kind, session, sequence, fields)
        entry = {"name": name, "note": note, "kind": NAMES[kind - 1], "session": session, "sequence": sequence}
        extra = {} if contents is None else {"contents": plain(contents)}
        entries.append({**entry, "fields": plain(fields), **extra, "hex": data.hex()})
    return {"protocol_version": 1, "note": NOTE, "datagrams": entries}


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=1) + "\n")
