"""A tool that another program moves by datagrams (``--operator udp:PORT``), without sockets.

A position is a datagram of `plain_datagrams`. The answer has its form: an array ``[f, …]``, or a map with ``force_n``,
``position_m`` and ``t_us``. docs/use/embedding.md describes them for programs in any language.
"""

from collections import deque
from collections.abc import Hashable
from typing import Any, Final

from hapticnet.checks import check_integer
from hapticnet.errors import PeerError
from hapticnet.plain_datagrams import ARRAY, POSITION, Form, read_vector, write
from hapticnet.samples import MAX_AXES, PositionSample, Vector


def read_position(data: bytes, axes: int) -> tuple[Form, Vector]:
    """Return form and position [m] of a datagram; PeerError if it is not a position with this many coordinates."""
    form, position_m, _ = read_vector(data, POSITION, axes)
    return form, position_m


def write_force(form: Form, force_n: Vector, position_m: Vector, t_us: int) -> bytes:
    """Return the answer to a position: the force [N] on all axes; a map also has position [m] and time of the tool."""
    return write(form, {"force_n": force_n, POSITION.key: position_m, "t_us": t_us} if form.is_map else force_n)


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
        self.clutched = False  # whether the sender moves without the tool (`operator.mapping`)
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
            form, position_m, found = read_vector(data, POSITION, self.axes)
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
        self.clutched = found.get("clutched") is True
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
