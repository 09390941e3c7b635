"""A script: the commands that hapticnet's own node was given in a session, and the answers that a peer must give.

A node is deterministic. So a peer that gives the same answers to a script has had the same session, in lockstep.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgpack
import numpy as np

from conformance.child import Child, write_float, write_floats, write_hex
from hapticnet.codec.registry import codec_parameters
from hapticnet.node.master import MasterNode
from hapticnet.protocol.keys import NO_PSK, MasterKey
from hapticnet.protocol.wire import OPEN, Kind

ZERO = re.compile("\\b80{15}\\b")  # the sign of a zero is left open
WORDS = 600  # of entropy, for a session of a node: more than any draws


class Line(NamedTuple):
    """A command and its answer; None if any will do."""

    command: str
    answer: str | None = "ok"


def random_line(seed: int | Sequence[int]) -> Line:
    """Give a peer the words that a node with `numpy.random.default_rng(seed)` draws."""
    rng = np.random.default_rng(seed)
    words = (int(rng.integers(0, 1 << 32)) for _ in range(WORDS))
    return Line(f"random {b''.join(word.to_bytes(4, 'big') for word in words).hex()}")


def seal_fields(key: MasterKey) -> str:
    """Return the keys of a master, as the command `seal` has them."""
    psk = "-" if key.own.psk == NO_PSK else key.own.psk.hex()
    return f"{key.own.private.hex()} {key.peer.hex()} {psk}"


def master_line(node: MasterNode, axes: int, asked: dict[str, Any]) -> Line:
    """Return the command that makes a master of a peer ask for the same as a node."""
    law = node.codec.law
    numbers = {"rate": asked["rate_hz"], "weber": law.weber_fraction, "floor": law.floor_n}
    numbers |= {"multiplier": law.multiplier}
    numbers |= {f"p.{name}": value for name, value in codec_parameters(node.codec).items()}
    if asked.get("positions") == "line":
        numbers["share"] = asked.get("position_share", 0.25)
    flags = [f"{name}=1" for name in ("announced", "predicted") if asked.get(name)]
    fields = [f"codec={node.codec.name}", f"name={write_hex(asked['name'])}", f"axes={axes}"]
    fields += [f"{name}={write_float(value)}" for name, value in numbers.items()]
    return Line(" ".join(["master", *fields, *flags]))


class Recorder:
    """A `MasterNode` that writes the script of what is done with it. It has the calls that a `Loopback` needs."""

    def __init__(self, node: MasterNode, hand: Any, first: Sequence[Line]) -> None:
        self.node, self._hand = node, hand
        self.lines = list(first)
        self.period_us, self.axes = node.period_us, node.axes
        self.largest_n = 0.0

    @property
    def end_reason(self) -> str | None:
        return self.node.end_reason

    @property
    def session(self) -> Any:
        return self.node.session

    def tick(self, now_us: int) -> None:
        self.node.tick(now_us)
        self.lines.append(Line(f"tick {now_us} {write_floats(self._hand.position_m)}"))

    def drive(self, now_us: int) -> None:
        self.node.drive(now_us)
        force_n = self.node.held_n
        # At its last tick, hapticnet still applies what it held.
        answer = None if self.state == "closed" else f"ok {write_floats(force_n)}"
        self.lines.append(Line(f"force {now_us}", answer))
        self.largest_n = max(self.largest_n, *map(abs, force_n))

    def datagrams_to_send(self) -> list[bytes]:
        sent = self.node.datagrams_to_send()
        self.lines.append(Line("send", " ".join(["ok", *(data.hex() for data in sent)])))
        return sent

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        self.node.receive_datagram(data, now_us)
        self.lines.append(Line(f"receive {now_us} {write_hex(data)}"))
        self.note()

    def close(self, reason: str, now_us: int) -> None:
        self.node.close(reason, now_us)
        self.lines.append(Line(f"close {now_us} {write_hex(reason)}"))

    @property
    def state(self) -> str:
        return self.node.session.state.value

    def note(self) -> None:
        """Let the script ask for what the node has counted, and its state."""
        received = self.node.session.received
        self.lines.append(Line("counts", f"ok {received.malformed} {received.stray} {received.too_old}"))
        self.lines.append(Line("state", f"ok {self.state}"))


def request_of(data: bytes) -> Any:
    """Return the contents of an open HELLO; hapticnet writes a whole parameter as an integer, others as a float."""
    version, kind, *head, body = msgpack.unpackb(data)
    if (version, kind) != (OPEN, Kind.HELLO):
        return data
    fields = msgpack.unpackb(body)
    return head, fields[:2], msgpack.unpackb(fields[2])


def same(answer: str, wanted: str) -> bool:
    """Return whether an answer is the wanted one, but for the sign of zeros, and how numbers of a HELLO are written."""
    if answer == wanted or ZERO.sub("0" * 16, answer) == ZERO.sub("0" * 16, wanted):
        return True
    ours, theirs = answer.split(" "), wanted.split(" ")
    if len(ours) != len(theirs) or ours[0] != "ok" or len(ours) < 2 or len(ours[1]) < 800:
        return False
    try:
        return [request_of(bytes.fromhex(each)) for each in ours[1:]] == [
            request_of(bytes.fromhex(each)) for each in theirs[1:]
        ]
    except ValueError:
        return False


def near(answer: str, wanted: str, ulps: int) -> bool:
    """Return whether each float of an answer is the wanted one, to some units in the last place."""
    ours, theirs = answer.split(" ")[1:], wanted.split(" ")[1:]
    pairs = zip(ours, theirs, strict=False)
    if not answer.startswith("ok ") or len(ours) != len(theirs):
        return False
    return all(abs(int(one, 16) - int(other, 16)) <= ulps for one, other in pairs)


def first_difference(child: Child, script: Sequence[Line], ulps: int = 0) -> str | None:
    """Return the first answer of a peer that differs from the script, and the commands before it; None if all agree.

    Forces may differ by some units in the last place.
    """
    answers = child.batch([line.command for line in script])
    for i, (line, answer) in enumerate(zip(script, answers, strict=True)):
        if ulps and line.answer is not None and line.command.startswith("force ") and near(answer, line.answer, ulps):
            continue
        if line.answer is not None and not same(answer, line.answer):
            before = "\n".join(each.command[:300] for each in script[max(0, i - 6) : i])
            said = f"{before}\n{line.command[:600]}\ngives\n{answer}\nnot\n{line.answer}"
            return f"line {i + 1} of {len(script)}, after\n{said}"
    return None


def dumps(script: Sequence[Line]) -> str:
    """Return the text of a script: a command and an answer a line."""
    return "".join(f"{line.command}\t{'*' if line.answer is None else line.answer}\n" for line in script)


def loads(text: str) -> list[Line]:
    """Return the script that `dumps` wrote."""
    pairs = (line.split("\t") for line in text.splitlines())
    return [Line(command, None if answer == "*" else answer) for command, answer in pairs]
