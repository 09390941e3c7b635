"""A tool that another program moves by datagrams (``--operator udp:PORT``), without sockets.

A position is a msgpack array ``[x, …]``, a msgpack map ``{"position_m": [x, …]}`` or the same as JSON. The answer has
the form of the question: an array ``[f, …]``, or a map with ``force_n``, ``position_m`` and ``t_us``.
docs/use/embedding.md describes them for programs in any language.
"""

import json
from collections import deque
from collections.abc import Hashable
from typing import Any, Final, NamedTuple

import msgpack

from hapticnet.checks import check_integer
from hapticnet.errors import PeerError
from hapticnet.samples import MAX_AXES, PositionSample, Vector

MOST_BYTES: Final = 512  # largest datagram that is read; three positions take 50 to 100 bytes
FARTHEST_M: Final = 10.0  # largest plausible coordinate [m]; larger ones are probably millimetres

POSITION: Final = "position_m"


class Form(NamedTuple):
    """The form of a datagram."""

    text: str
    is_json: bool
    is_map: bool


ARRAY: Final = Form("msgpack array", False, False)
MAP: Final = Form("msgpack map", False, True)
JSON_ARRAY: Final = Form("JSON array", True, False)
JSON_OBJECT: Final = Form("JSON object", True, True)


def read_position(data: bytes, axes: int) -> tuple[Form, Vector]:
    """Return form and position [m] of a datagram; PeerError if it is not a position with this many coordinates."""
    if len(data) > MOST_BYTES:
        raise PeerError(f"a datagram of {len(data)} bytes; a position has at most {MOST_BYTES}")
    is_json = data.startswith((b"{", b"["))
    try:
        found: Any = json.loads(data) if is_json else msgpack.unpackb(data)
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise PeerError(f"neither msgpack nor JSON: {' '.join(str(error).split())[:80] or 'incomplete'}") from error
    if type(found) is dict:
        values = found.get(POSITION)
        form = JSON_OBJECT if is_json else MAP
        if type(values) is float or type(values) is int:
            values = [values]
    else:
        values = found
        form = JSON_ARRAY if is_json else ARRAY
    if type(values) is not list:
        raise _not_numbers(form, axes)
    for each in values:
        if type(each) is not float and type(each) is not int:
            raise _not_numbers(form, axes)
        # Written so that NaN, which compares false with everything, is refused too.
        if not -FARTHEST_M <= each <= FARTHEST_M:
            raise PeerError(f"coordinate {str(each)[:30]} is not within ±{FARTHEST_M:g} m; coordinates are metres")
    if len(values) != axes:
        raise PeerError(f"{len(values)} coordinates; expected {axes}, such as {_example(axes)}")
    return form, tuple(map(float, values))


def write_force(form: Form, force_n: Vector, position_m: Vector, t_us: int) -> bytes:
    """Return the answer to a position: the force [N] on all axes; a map also has position [m] and time of the tool."""
    answer: Any = {"force_n": force_n, POSITION: position_m, "t_us": t_us} if form.is_map else force_n
    if form.is_json:
        return json.dumps(answer).encode()
    packed: bytes = msgpack.packb(answer)
    return packed


def _not_numbers(form: Form, axes: int) -> PeerError:
    expected = f"{POSITION} must be" if form.is_map else "expected"
    return PeerError(f"{expected} a list of {axes} numbers, such as {_example(axes)}")


def _example(axes: int) -> str:
    return str([0.01, 0.0, 0.0][:axes])


HOLD_AFTER_US: Final = 300_000  # silence [µs] after which the tool does not jump to the next position but moves there
WITHDRAW_AFTER_US: Final = 1_000_000  # silence [µs] after which the tool is withdrawn and another sender may move it
APPROACH_M_S: Final = 0.06  # speed [m/s] with which the tool withdraws, and moves to the first position after a silence
LONGEST_STEP_US: Final = 20_000  # longest time [µs] by which one sample advances such a motion
SILENCE_LINES_EVERY_US: Final = 10_000_000  # shortest time [µs] between two messages about silence


class RemoteOperator:
    """Follow the positions of one sender at a time; answer each with the force. Satisfies `operator.base.Operator`.

    The tool is where the newest position says, without smoothing. Before the first position it rests at 0, and when
    none arrives any more it stays there. After `WITHDRAW_AFTER_US` it moves back along the first axis to 0, at
    `APPROACH_M_S`; at the same speed it moves to the first position of a sender and to the first one after a silence.
    """

    duration_us = None

    def __init__(self, axes: int = 1) -> None:
        check_integer("axes of the operator", axes, 1, MAX_AXES)
        self.axes = axes
        # Counts: datagrams with positions, without, and from a sender other than the one in control; withdrawals
        # because the sender was silent; forces sent back
        self.positions = self.malformed = self.unknown_peers = self.silences = self.answers = 0
        self._sender: Hashable = None
        self._form = ARRAY
        self._heard_us: int | None = None  # on the clock of `receive`
        self._goal_m: Vector = (0.0,) * axes
        self._at_m = self._goal_m
        self._force_n: Vector = (0.0,) * axes
        self._felt_us = self._t_us = 0
        self._heard_t_us: int | None = None  # on the clock of `sample`
        self._news = False
        self._owed = False
        self._following = self._withdrawing = False
        self._lines: deque[str] = deque()
        self._told_silence_us: int | None = None

    def receive(self, data: bytes, sender: Hashable, now_us: int) -> None:
        """Process a datagram from `sender`. Never raises."""
        alone = self._heard_us is None or now_us - self._heard_us > WITHDRAW_AFTER_US
        if sender != self._sender and not alone:
            self.unknown_peers += 1
            if self.unknown_peers == 1:
                self._lines.append(f"{_place(sender)} sends positions too; it may once {_place(self._sender)} stops")
            return
        try:
            form, position_m = read_position(data, self.axes)
        except PeerError as error:
            self.malformed += 1
            if self.malformed == 1:
                self._lines.append(f"dropped a datagram from {_place(sender)}: {error}")
            return
        self.positions += 1
        if sender != self._sender:
            self._lines.append(f"positions come from {_place(sender)}, as {form.text}")
            self._sender = sender
            self._following = False
        self._form, self._goal_m, self._heard_us = form, position_m, now_us
        self._news = self._owed = True

    def sample(self, t_us: int) -> PositionSample:
        """Return where the tool is at `t_us` [µs]."""
        if self._news:
            self._news = self._withdrawing = False
            self._heard_t_us = t_us
        elapsed_us, self._t_us = t_us - self._t_us, t_us
        if self._heard_t_us is not None:
            silent_us = t_us - self._heard_t_us
            if silent_us > HOLD_AFTER_US:
                self._following = False
            if silent_us > WITHDRAW_AFTER_US and not self._withdrawing:
                self._withdraw(t_us)
            if self._following:
                self._at_m = self._goal_m
            elif silent_us <= HOLD_AFTER_US or self._withdrawing:
                self._approach(APPROACH_M_S * min(max(0, elapsed_us), LONGEST_STEP_US) * 1e-6)
        return PositionSample(t_us, self._at_m)

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Note the force [N] held at `t_us` [µs], for the next answer."""
        self._felt_us, self._force_n = t_us, force_n

    def answer(self) -> tuple[bytes, Any] | None:
        """Return the answer to the newest position and its address, once; None if nothing arrived since."""
        if not self._owed:
            return None
        self._owed = False
        self.answers += 1
        return write_force(self._form, self._force_n, self._at_m, self._felt_us), self._sender

    def next_line(self) -> str | None:
        """Return the next message for a person, or None."""
        return self._lines.popleft() if self._lines else None

    def report(self) -> dict[str, int]:
        """Return the report of this operator for JSON."""
        names = "positions", "malformed", "unknown_peers", "silences", "answers"
        return {name: getattr(self, name) for name in names}

    def _withdraw(self, t_us: int) -> None:
        self._withdrawing = True
        self.silences += 1
        if self._told_silence_us is None or t_us - self._told_silence_us > SILENCE_LINES_EVERY_US:
            self._told_silence_us = t_us
            self._lines.append(f"no positions for {WITHDRAW_AFTER_US / 1e6:g} s; the tool is withdrawn")

    def _approach(self, step_m: float) -> None:
        """Move by at most `step_m` on each axis: out of the tissue, or to the sender's position."""
        goal_m = (min(0.0, self._at_m[0]), *self._at_m[1:]) if self._withdrawing else self._goal_m
        self._at_m = tuple(
            [x + min(max(goal - x, -step_m), step_m) for x, goal in zip(self._at_m, goal_m, strict=True)]
        )
        self._following = not self._withdrawing and self._at_m == self._goal_m


def _place(sender: Hashable) -> str:
    if not isinstance(sender, tuple) or len(sender) < 2:
        return str(sender)
    host, port = sender[:2]
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"
