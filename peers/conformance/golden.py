"""Scripts and conversations from the golden vectors of tests/vectors, which are the reference here, not hapticnet."""

import json
import re
import struct
from collections.abc import Iterator
from typing import Any, Final

import msgpack

from conformance.child import PEERS, Child, read_float, read_hex, write_float, write_floats, write_hex
from conformance.script import Line
from hapticnet.protocol.messages import Code
from hapticnet.protocol.wire import Kind

VECTORS: Final = PEERS.parent / "tests" / "vectors"
SESSION: Final = 0xDEADBEEF
LAW: Final = {"weber_fraction": 0.05, "floor_n": 0.025, "multiplier": 1.0}
HERE: Final = write_hex("here")


def read(name: str) -> Any:
    """Return the contents of a file of vectors."""
    return json.loads((VECTORS / f"{name}.json").read_text())


def datagrams() -> dict[str, str]:
    """Return the hex digits of the datagrams of protocol.json by their names."""
    return {each["name"]: each["hex"] for each in read("protocol")["datagrams"]}


def make(what: str, case: dict[str, Any], **more: str) -> str:
    """Return the command that makes a master or a decoder for a case."""
    fields = [
        f"codec={case['codec']}",
        f"axes={case.get('axes', 1)}",
        *(f"{key}={value}" for key, value in more.items()),
    ]
    for key, name in (("weber", "weber_fraction"), ("floor", "floor_n"), ("multiplier", "multiplier")):
        fields.append(f"{key}={write_float(case.get(name, LAW[name]))}")
    fields += [f"p.{name}={write_float(value)}" for name, value in case.get("parameters", {}).items()]
    return " ".join([what, *fields])


def master(case: dict[str, Any] | None = None, name: str = "surgeon") -> Line:
    """Return the command that makes a master."""
    return Line(make("master", case or {"codec": "deadband"}, rate=write_float(1000.0), name=write_hex(name)))


def decoders() -> Iterator[tuple[str, str, list[Line]]]:
    """Return name, codec and script of each case of codecs.json, for a peer with bare decoders."""
    for case in read("codecs")["cases"]:
        lines = [Line(make("decoder", case))]
        for t_us, _, position, payload, arrives, applied in case["samples"]:
            if arrives:
                lines.append(Line(f"decode {t_us} {payload or '-'}", f"ok {int(arrives != 'refused')}"))
            lines.append(_applied(t_us, position, applied))
        lines += [Line(f"decode {t_us} {payload or '-'}", "ok 0") for payload in case["refused"]]
        lines += [_applied(t_us, position, applied) for t_us, position, applied in case["later"]]
        yield case["name"], case["codec"], lines


def _applied(t_us: int, position_m: list[float], applied_n: list[float]) -> Line:
    return Line(f"apply {t_us} {write_floats(position_m)}", f"ok {write_floats(applied_n)}")


def opening(case: dict[str, Any] | None = None, grant: bytes | None = None) -> list[Line]:
    """Return the script of a master with session 0xdeadbeef, whose WELCOME arrives at 0 us; or a WELCOME of a grant."""
    welcome = bytes.fromhex(datagrams()["welcome"])
    if grant is not None:
        welcome = msgpack.packb([*msgpack.unpackb(welcome)[:4], msgpack.packb([0x01020304, grant])])
    zeros = write_floats([0.0] * (case or {}).get("axes", 1))
    return [
        Line("random 01020304"), master(case), Line(f"tick 0 {zeros}"), Line("send", None),
        Line(f"receive 0 {welcome.hex()}"),
    ]  # fmt: skip


def conversation() -> tuple[int, list[Line]]:
    """Return how many datagrams of protocol.json a session of a master has, and its script."""
    known = datagrams()
    lines = [Line("random 01020304"), master(), Line(f"tick 5000000000 {write_floats([0.0])}")]
    lines += [Line("send", f"ok {known['hello']}"), Line(f"receive 5000000100 {known['cookie']}")]
    lines += [Line("send", f"ok {known['hello with the cookie']}"), Line(f"receive 5000000200 {known['refuse']}")]
    lines += [Line("state", "ok closed"), Line("reason", None), *opening(), Line("scene", f"ok {write_hex('paper:1')}")]
    lines += [Line(f"tick 1000 {write_floats([0.02])}"), Line("send", f"ok {known['first position']}")]
    lines += [Line(f"receive 1500 {known['first force']}"), Line(f"tick 2000 {write_floats([0.021])}")]
    lines += [Line("send", f"ok {known['position that acknowledges']}"), Line(f"receive 46000 {known['keepalive']}")]
    lines += [Line("state", "ok established"), Line("counts", "ok 0 0 1")]
    used = ("hello", "cookie", "hello with the cookie", "refuse", "welcome", "first position", "first force",
            "position that acknowledges", "keepalive")  # fmt: skip
    return len(used), lines


def refused_by_masters() -> Iterator[tuple[str, list[Line]]]:
    """Return name and script of each datagram and grant of refused.json that a master must refuse, or take."""
    refused, place = read("refused"), write_floats([0.0])
    for case in refused["datagrams"]:
        if case["to"] != "master":
            continue
        dropped = int(case["outcome"] in ("dropped", "not applied"))
        lines = opening()
        for now_us in (1000, 2000):
            lines += [Line(f"tick {now_us} {place}"), Line("send", None)]
        lines += [Line(f"receive 2000 {case['hex'] or '-'}"), Line("counts", f"ok {dropped} 0 0")]
        lines += [Line("state", "ok established"), Line(f"tick 3000 {place}")]
        if case["outcome"] != "taken" or "force" not in case["name"]:
            sent = position(3, 3000, 0.0)
            lines.append(Line("send", f"ok {sent.hex()}"))
        yield case["name"], lines
    for case in refused["grants"]:
        dropped = int(case["outcome"] == "dropped")
        lines = [*opening(grant=bytes.fromhex(case["hex"])), Line("counts", f"ok {dropped} 0 0")]
        yield case["name"], [*lines, Line("state", "ok connecting" if dropped else "ok established")]


def traced(child: Child) -> Iterator[tuple[str, object, object]]:
    """Return name, outcome and wanted outcome of each tick of a trace: what a master sends, and acknowledges."""
    for trace in read("traces")["traces"]:
        if not child.has("codecs", trace["codec"]):
            continue
        lines, sends = [line.command for line in opening(trace)], []
        for tick in trace["ticks"]:
            lines += [f"tick {tick['now_us']} {write_floats(tick['position_m'])}", "send"]
            sends.append(len(lines) - 1)
            lines += [f"receive {tick['now_us']} {each['hex']}" for each in tick["arrives"]]
        answers = child.batch(lines)
        for tick, at in zip(trace["ticks"], sends, strict=True):
            frame = msgpack.unpackb(read_hex(answers[at][3:] or "-") or b"\xc0")
            wanted = [tick["now_us"], tick["newest"], struct.pack(">f", *tick["position_m"])]
            sent = frame and msgpack.unpackb(frame[4])[:3]  # a report of loss may follow
            yield f"{trace['name']} at {tick['now_us']} us", sent, wanted


def sealed() -> tuple[int, list[Line]]:
    """Return how many datagrams of sealed.json the beginning of a master's session has, and its script."""
    vectors = read("sealed")
    keys, request = vectors["keys"], vectors["datagrams"][0]["payload"]
    case = {"codec": request[0], "parameters": request[1]}
    seal = f"seal {keys['master_private']} {keys['slave_public']} {keys['psk']}"
    lines = [Line(f"random {vectors['nonce']:08x}{keys['master_ephemeral']}"), master(case, request[7]), Line(seal)]
    lines.append(Line(f"tick {request[9]} {write_floats([0.0])}"))
    for count, each in enumerate(vectors["datagrams"], 1):
        if each["from"] == "slave":
            lines.append(Line(f"receive {request[9]} {each['hex']}"))
        else:
            lines.append(Line("send", f"ok {each['hex']}"))
        if each["kind"] == "WELCOME":
            return count, [*lines, Line("state", "ok established"), Line("counts", "ok 0 0 0")]
    raise AssertionError("no WELCOME")


def position(sequence: int, now_us: int, x_m: float = 0.03, session: int = SESSION) -> bytes:
    """Return a POSITION of a session."""
    body = msgpack.packb([now_us % 2**32, None, struct.pack(">f", x_m)])
    data: bytes = msgpack.packb([1, Kind.POSITION, session, sequence, body])
    return data


class Talk:
    """A slave of a peer that draws 0xdeadbeef only, with the scene of the traces: a spring of 300 N/m behind 20 mm."""

    def __init__(self, child: Child, drawn: str = f"random {SESSION:08x}") -> None:
        self.child = child
        child.tell(drawn)
        child.ask("slave", f"scene={write_hex('a spring')}", "axes=1")

    def say(self, data: bytes, address: str = HERE, now_us: int = 1000) -> list[Any] | None:
        """Give a datagram; return version, kind, session, sequence and body of the answer, or None."""
        answers = [self.child.ask("receive", now_us, write_hex(data), address)[0]]
        at = self.child.ask("position")[0]
        if at != "-":
            force_n = 300.0 * max(0.0, read_float(at) - 0.02)
            answers.append(self.child.ask("answer", now_us, write_float(force_n))[0])
        sent = [read_hex(answer) for answer in answers if answer != "-"]
        self.answer = sent[0].hex() if sent else None
        return list(msgpack.unpackb(sent[0])) if sent else None

    def greet(
        self, request: bytes | None = None, *, version: int = 1, address: str = HERE, now_us: int = 0, number: int = 0
    ) -> Any:
        """Ask with the HELLO of the vectors or another request, with its cookie; return the last answer."""
        fields = msgpack.unpackb(msgpack.unpackb(bytes.fromhex(datagrams()["hello"]))[4])
        fields[0] += number
        fields[2] = fields[2] if request is None else request
        fields[4] = bytes(400)
        answer = None
        for _ in range(2):
            answer = self.say(msgpack.packb([version, Kind.HELLO, 0, 0, msgpack.packb(fields)]), address, now_us)
            if answer is None or answer[1] != Kind.COOKIE:
                break
            fields[1] = msgpack.unpackb(answer[4])[1]
        return answer

    def counts(self) -> str:
        """Return malformed, stray and too old datagrams."""
        return " ".join(self.child.ask("counts"))


PARTS: Final = re.compile("part |parts|grip|a threshold")  # a slave of one force refuses all of them as other parts


def refused_requests(child: Child) -> Iterator[tuple[str, object, object]]:
    """Return name, outcome and wanted outcome of each request of refused.json."""
    for case in read("refused")["requests"]:
        talk, wanted = Talk(child), case["outcome"]
        answer = talk.greet(bytes.fromhex(case["hex"]))
        outcome: object = "dropped" if talk.counts().startswith("1 ") else "no answer"
        if answer is not None:
            is_refused = answer[1] == Kind.REFUSE
            outcome = msgpack.unpackb(answer[4])[2] if is_refused else "taken" if answer[1] == Kind.WELCOME else answer
        if PARTS.search(case["name"]) and wanted == Code.PARAMETER:
            wanted = Code.AXES
        yield case["name"], outcome, wanted


def refused_by_slaves(child: Child) -> Iterator[tuple[str, object, object]]:
    """Return name, outcome and wanted outcome of each datagram of refused.json that goes to a slave."""
    for case in read("refused")["datagrams"]:
        if case["to"] == "slave":
            talk = Talk(child)
            talk.greet()
            talk.say(position(1, 1000))
            answer = talk.say(bytes.fromhex(case["hex"]), now_us=47_000)
            dropped = case["outcome"] == "dropped"
            yield case["name"], (answer is None, talk.counts()), (dropped, f"{int(dropped)} 0 0")


def answered_positions(child: Child) -> Iterator[tuple[str, object, object]]:
    """Return time, answer and wanted answer of each position of the trace of a slave."""
    talk = Talk(child)
    talk.greet()
    for entry in read("traces")["slave"]:
        talk.say(bytes.fromhex(entry["arrives"]), now_us=entry["now_us"])
        yield f"at {entry['now_us']} us", talk.answer, entry["answer"]
