"""Write tests/vectors/refused.json: datagrams, requests and grants that must be refused, and some that must not.

Run ``python -m tests.vectors.make_refused`` after an intended change of the protocol. It packs with msgpack and struct
alone and imports nothing of hapticnet, so that the file says what docs/refer/protocol.md says.
"""

import json
import math
import struct
from pathlib import Path

import msgpack

from tests.vectors.make_protocol import (
    CLOSE,
    FORCE,
    GRANT,
    KEEPALIVE,
    NOTICE,
    ONE_NEWTON,
    POSITION,
    REQUEST,
    SESSION,
    TICKET,
)

FILE = Path(__file__).with_name("refused.json")

NOTE = (
    "What a peer must refuse. Datagrams: 'to' a master or slave, of an open session 0xdeadbeef with the codec deadband,"
    " one axis; their sequence numbers are to be taken as the next ones. 'dropped': it is counted as malformed and"
    " changes nothing. 'not applied': a FORCE whose payload is refused; its number is used, and it is not acknowledged."
    " 'taken': it is read as any other. A number: the code with which the request is refused. Requests and grants are"
    " the bytes of that field of a HELLO or WELCOME; the master's request is that of protocol.json."
)

PLACE = struct.pack(">f", 0.0205)
TOO_BIG = {"nil": None, "true": True, "-1": -1, "2^32": 2**32, "1.5": 1.5, "text": "1"}


def single(value):
    return struct.pack(">f", value)


def body(kind, *fields):
    return [1, kind, SESSION, 2, msgpack.packb(list(fields))]


def framed(**changed):
    frame = dict(
        zip(("version", "kind", "session", "sequence", "body"), body(POSITION, 2000, None, PLACE), strict=True)
    )
    return list((frame | changed).values())


def of_each(kind, name, fields, at, values, outcome="dropped"):
    for what, changed, _ in with_each(name, fields, at, values):
        yield what, body(kind, *changed), outcome


def frames():
    position = msgpack.packb(framed())
    yield "nothing", b"", "dropped"
    yield "no msgpack", b"\xc1", "dropped"
    yield "cut off", position[:-1], "dropped"
    yield "a byte behind it", position + b"\x00", "dropped"
    yield "a map", msgpack.packb({1: 2}), "dropped"
    yield "four elements", msgpack.packb(framed()[:4]), "dropped"
    yield "six elements", msgpack.packb([*framed(), 0]), "dropped"
    yield "version 3", msgpack.packb(framed(version=3)), "dropped"
    for what, value in (TOO_BIG | {"0": 0, "12": 12}).items():
        yield f"kind is {what}", msgpack.packb(framed(kind=value)), "dropped"
    for name in ("session", "sequence"):
        for what, value in TOO_BIG.items():
            yield f"{name} is {what}", msgpack.packb(framed(**{name: value})), "dropped"
    for what, value in {"text": "abc", "nil": None, "an array": [2000, None, PLACE]}.items():
        yield f"body is {what}", msgpack.packb(framed(body=value)), "dropped"
    yield "an extension", msgpack.packb(framed(body=msgpack.ExtType(1, b"x"))), "dropped"


def to_slave():
    at = [2000, None, PLACE, 10, 80]
    for fields in (at[:2], []):
        yield f"position of {len(fields)} fields", body(POSITION, *fields), "dropped"
    for size, outcome in ((1200, "taken"), (1201, "dropped")):
        bare = len(msgpack.packb(framed(body=msgpack.packb([2000, None, PLACE, 0, 0, 0, bytes(1000)])))) - 1000
        data = msgpack.packb(framed(body=msgpack.packb([2000, None, PLACE, 0, 0, 0, bytes(size - bare)])))
        assert len(data) == size
        yield f"{size} bytes", data, outcome
    yield "33 fields", msgpack.packb(framed(body=msgpack.packb([2000, None, PLACE, *range(30)]))), "dropped"
    yield "position as a map", framed(body=msgpack.packb({1: 2})), "dropped"
    for name, place in (("t_us", 0), ("newest", 1), ("payload", 2), ("share", 3), ("again", 4)):
        values = dict(TOO_BIG)
        if name == "newest":
            del values["nil"]
        if name in ("share", "again"):
            values["101"] = 101
        yield from of_each(POSITION, f"position whose {name}", at, place, values)
    places = {"no bytes": b"", "3 bytes": PLACE[:3], "6 bytes": PLACE + b"\0\0", "8 bytes": PLACE * 2}
    places |= {"NaN": single(math.nan), "infinite": single(math.inf), "2e15 m": single(2e15)}
    yield from of_each(POSITION, "position whose payload", at, 2, places)
    yield "position with a wait", body(POSITION, *at[:3], 255), "taken"
    yield "position with a wait and a report of loss", body(POSITION, *at, 255), "taken"
    yield from of_each(POSITION, "position whose wait", [*at[:3], 7], 3, TOO_BIG | {"256": 256, "-1": -1})
    yield "position with fields of a later revision", body(POSITION, *at, 0, {}), "taken"
    yield "position of 1e15 m", body(POSITION, 2000, None, single(9.9e14)), "taken"
    yield "position of a denormal", body(POSITION, 2000, None, single(1e-45)), "taken"


def to_master():
    for kind, name, fields in ((FORCE, "force", [1000, ONE_NEWTON, b""]), (KEEPALIVE, "keepalive", [1000, 1, b""])):
        yield f"{name} of one field", body(kind, 1000), "dropped"
        yield from of_each(kind, f"{name} whose t_us", fields, 0, TOO_BIG)
        bounds = {each: TOO_BIG[each] for each in TOO_BIG if each != "nil"}
        yield from of_each(kind, f"{name} whose bound", fields, 2, bounds)
    yield from of_each(FORCE, "force whose payload", [1000, ONE_NEWTON], 1, TOO_BIG)
    newest = {each: TOO_BIG[each] for each in TOO_BIG if each != "nil"}
    yield from of_each(KEEPALIVE, "keepalive whose newest_force", [1000, 1], 1, newest)
    forces = {"no bytes": b"", "2 bytes": b"\0\0", "3 bytes": b"\0\0\0", "NaN": single(math.nan)}
    forces |= {"infinite": single(math.inf), "2e15 N": single(2e15), "1e308 N": struct.pack(">d", 1e308)}
    yield from of_each(FORCE, "force whose payload", [1000, ONE_NEWTON], 1, forces, "not applied")
    yield from of_reason(NOTICE, "notice")
    yield "force as a denormal float64", body(FORCE, 1000, struct.pack(">d", 5e-324)), "taken"
    yield "force with fields of a later revision", body(FORCE, 1000, ONE_NEWTON, b"", 7), "taken"


def of_reason(kind, message):
    yield f"{message} of one field", body(kind, "done"), "dropped"
    reasons = {"nil": None, "bytes": b"done", "201 bytes": "x" * 201, "a new line": "a\nb", "an escape": "\x1b[2J"}
    yield from of_each(kind, f"{message} whose reason", ["done", 0], 0, reasons)
    yield from of_each(kind, f"{message} whose code", ["done", 0], 1, TOO_BIG)


NUMBERS = {"nil": None, "true": True, "text": "1", "NaN": math.nan, "infinite": math.inf}


def with_each(name, fields, at, values, outcome="dropped"):
    for what, value in values.items():
        yield f"{name} is {what}", [*fields[:at], value, *fields[at + 1 :]], outcome


def by_repr(*values):
    return {repr(value): value for value in values}


def requests():
    yield "as it is", REQUEST, "taken"
    yield "fields of a later revision", [*REQUEST, False, None, None, None, 7], "taken"
    yield "predicted is 1", [*REQUEST, 1], "dropped"
    yield "a coupling that is a number", [*REQUEST, False, 7], "dropped"
    yield "a coupling without parameters", [*REQUEST, False, ["wave"]], "dropped"
    yield "a coupling with text as a parameter", [*REQUEST, False, ["wave", {"b": "0.3"}]], "dropped"
    yield "vibration", [*REQUEST, False, None, [4000.0, 0.1]], "taken"
    for what, value in {
        "a number": 4000.0,
        "one number": [4000.0],
        "text": ["4000", 0.1],
        "NaN": [math.nan, 0.1],
    }.items():
        yield f"vibration is {what}", [*REQUEST, False, None, value], "dropped"
    for value in ([499.0, 0.1], [1e7, 0.1], [4000.0, 0.0], [4000.0, 11.0]):
        yield f"vibration is {value}", [*REQUEST, False, None, value], 3
    yield "a coupling that is not known", [*REQUEST, False, ["rope", {}]], 2
    pose = ["force:3", "torque:3"]
    yield "parts that are text", [*REQUEST, False, None, None, "force:3"], "dropped"
    yield "parts without thresholds", [*REQUEST, False, None, None, [pose]], "dropped"
    yield "a part that is a number", [*REQUEST, False, None, None, [["force:3", 3], {}]], "dropped"
    yield "a threshold of one number", [*REQUEST, False, None, None, [pose, {"torque": [0.1]}]], "dropped"
    yield "25 axes", [*REQUEST[:6], 25, *REQUEST[7:], False, None, None, [pose, {}]], "dropped"
    yield "a part that is not known", [*REQUEST, False, None, None, [["force:3", "slip:2"], {}]], 3
    yield "a part twice", [*REQUEST, False, None, None, [["force:1", "force:1"], {}]], 3
    yield "a grip of three axes", [*REQUEST, False, None, None, [["force:1", "grip:3"], {}]], 3
    yield "a threshold of 0", [*REQUEST, False, None, None, [pose, {"torque": [0.1, 0.0]}]], 3
    yield "a threshold of a kind that is not known", [*REQUEST, False, None, None, [pose, {"slip": [0.1, 0.1]}]], 3
    yield "parts that do not give the axes", [*REQUEST, False, None, None, [pose, {}]], 4
    yield "parts that the scene does not have", [*REQUEST[:6], 6, *REQUEST[7:], False, None, None, [pose, {}]], 4
    yield "eleven fields", REQUEST[:11], "dropped"
    yield "a codec that is not known", ["mp3", *REQUEST[1:]], 2
    yield "a parameter that is not known", ["deadband", {"window_ms": 1.0}, *REQUEST[2:]], 3
    yield "a parameter out of range", ["deadband", {"step_n": 2.0}, *REQUEST[2:]], 3
    yield "a parameter that is a denormal", ["deadband", {"step_n": 5e-324}, *REQUEST[2:]], 3
    texts = {"nil": None, "bytes": b"x", "65 bytes": "x" * 65, "a new line": "a\nb"}
    for at, name in ((0, "codec"), (7, "name")):
        yield from with_each(name, REQUEST, at, texts)
    for what, value in {"nil": None, "an array": [], "a key of bytes": {b"x": 1.0}}.items():
        yield f"parameters are {what}", ["deadband", value, *REQUEST[2:]], "dropped"
    for what, value in NUMBERS.items():
        yield f"a parameter is {what}", ["deadband", {"step_n": value}, *REQUEST[2:]], "dropped"
    edges = {
        (2, "weber_fraction"): ([0.0, 1e-12, 1.0], [-0.01, 5e-324, 9e-13, 1.01, 1e308]),
        (3, "floor_n"): ([0.0, 1e-12, 1e9], [-0.01, 5e-324, 9e-13, 1.1e9, 1e308]),
        (4, "multiplier"): ([0.0, 1e-12, 1000.0], [-0.01, 5e-324, 9e-13, 1001.0, 1e308]),
        (5, "rate_hz"): ([20.0, 20, 1e5], [0.0, -1000.0, 5e-324, 1e-302, 19.999, 100_001.0, 1e308]),
        (11, "position_share"): ([0.0, 0.01, 0.9], [-0.1, 5e-324, 0.009, 0.91, 1e308]),
    }
    for (at, name), (good, bad) in edges.items():
        yield from with_each(name, REQUEST, at, NUMBERS)
        yield from with_each(name, REQUEST, at, by_repr(*good), "taken")
        yield from with_each(name, REQUEST, at, by_repr(*bad), 3)
    yield from with_each("axes", REQUEST, 6, NUMBERS | {"0": 0, "4": 4, "1.0": 1.0, "2^63": 2**63})
    yield from with_each("axes", REQUEST, 6, {"2": 2, "3": 3}, 4)
    yield from with_each("ticket", REQUEST, 8, {"15 bytes": TICKET[:15], "text": "sixteen bytes ok", "true": True})
    yield from with_each("clock_us", REQUEST, 9, NUMBERS | {"-1": -1, "2^53": 2**53, "1.0": 1.0})
    yield from with_each("clock_us", REQUEST, 9, {"0": 0, "2^53 - 1": 2**53 - 1}, "taken")
    yield from with_each("announced", REQUEST, 10, {"nil": None, "1": 1, "text": "yes"})


def grants():
    yield "as it is", GRANT, "taken"
    yield "fields of a later revision", [*GRANT, False, False, None, 7], "taken"
    yield "predicted is 1", [*GRANT, 1], "dropped"
    yield "predicted, which was not asked for", [*GRANT, True], "dropped"
    yield "vibration is 1", [*GRANT, False, 1], "dropped"
    yield "a frame that is a number", [*GRANT, False, False, 3], "dropped"
    yield "a frame of 65 bytes", [*GRANT, False, False, "x" * 65], "dropped"
    yield "vibration, which was not asked for", [*GRANT, False, True], "dropped"
    yield "seven fields", GRANT[:7], "dropped"
    yield "announced, which was not asked for", [*GRANT[:6], True, 0.0], "dropped"
    yield "a share, which was not asked for", [*GRANT[:7], 0.25], "dropped"
    yield from with_each("session", GRANT, 0, NUMBERS | {"0": 0, "2^32": 2**32})
    yield from with_each("rate_hz", GRANT, 1, by_repr(20.0, 20, 1e5), "taken")
    slow_or_fast = by_repr(0.0, -1000.0, 5e-324, 1e-302, 19.999, 100_001.0, 1e308)
    yield from with_each("rate_hz", GRANT, 1, NUMBERS | slow_or_fast)
    yield from with_each("keepalive_us", GRANT, 2, {"1000": 1000, "50000": 50_000}, "taken")
    late = {"0": 0, "999": 999, "50001": 50_001, "400000": 400_000, "45000.0": 45_000.0}
    yield from with_each("keepalive_us", GRANT, 2, NUMBERS | late)
    yield from with_each("scene", GRANT, 3, {"nil": None, "65 bytes": "x" * 65, "a new line": "a\nb"})
    yield from with_each("ticket", GRANT, 4, {"nil": None, "15 bytes": TICKET[:15], "text": "sixteen bytes ok"})
    for at, name in ((5, "resumed"), (6, "announced")):
        yield from with_each(name, GRANT, at, {"nil": None, "0": 0, "text": "no"})
    yield from with_each("position_share", GRANT, 7, NUMBERS | by_repr(-0.1, 5e-324, 0.009, 0.91))


def document():
    datagrams = []
    for to, entries in (
        ("master", [*frames(), *to_master(), *of_reason(CLOSE, "close")]),
        ("slave", [*frames(), *to_slave(), *of_reason(CLOSE, "close")]),
    ):
        for name, datagram, outcome in entries:
            data = datagram if isinstance(datagram, bytes) else msgpack.packb(datagram)
            datagrams.append({"to": to, "name": name, "outcome": outcome, "hex": data.hex()})
    inner = {
        key: [{"name": name, "outcome": outcome, "hex": msgpack.packb(fields).hex()} for name, fields, outcome in made]
        for key, made in (("requests", requests()), ("grants", grants()))
    }
    return {"note": NOTE, "datagrams": datagrams, **inner}


if __name__ == "__main__":
    FILE.write_text(json.dumps(document(), indent=1) + "\n", encoding="utf-8")
