"""The page that replays recordings.

Each page plays independently: it requests the parts that it is about to show and keeps its own time. So it starts when
it becomes visible, and pausing or seeking does not affect other pages. The server keeps no state of a page.

A page is the watch view at ``/watch``; its messages are these. Times of a recording count from its first row. From the
server::

    {"type": "hello", "version": 1, "view": "watch", "speed": 1.0, "loop": false, "history_s": 5.0,
     "duration_s": 12.0,                    // until the last recording ends
     "together": true,                      // made at the same time, and shown at the same moments
     "tapes": [{"label": "A", "name": "run.mcap", "begin_s": 0.0, …}]}  // begin_s: when it begins; `Tape.description`
    {"type": "figures", "t_s": 3.2, "tapes": [FIGURES, …]}             // the answer to "figures"; null before it begins

    FIGURES = {"traffic": TRAFFIC or null, "felt": {…, "so_far": 0.002} or null}  // as in a state

and, binary and little-endian, ``BLOCK``: u8 4; u8 recording; u16 axes; u32 number; u32 rows r; u16 columns c; u16
tissues n; u32 frames f; u32 components p of the held force in frames, the axes or 0; f64 time of its begin [s]; c × r ×
f32, column by column; then for each frame f32 time since the begin, the tool's position on each axis, p × f32 held
force, and n × f32 position of each surface, each as f columns; and n × f × u8 contacts.

From a page::

    {"type": "block", "tape": 0, "number": 17}   // rows of ``block_s`` seconds from 17·``block_s`` on
    {"type": "figures", "t_s": 3.2}              // traffic and felt error at this time
"""

import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple

from hapticnet.web import messages
from hapticnet.web.audience import Audience
from hapticnet.web.messages import MistakeError, Reader, View, number
from hapticnet.web.tape import Tape, together

if TYPE_CHECKING:
    from hapticnet.web.client import Client

BLOCK: Final = 4
LABELS: Final = "AB"
LARGEST: Final = 2**32 - 1  # number in a message
_HEAD: Final = struct.Struct("<BBHIIHHIId")


class AskBlock(NamedTuple):
    """A page asks for rows."""

    tape: int
    number: int


class Replay(Audience):
    """One or two recordings, on pages that each play for themselves."""

    views = ("watch",)
    documents: ClassVar[Mapping[View, str]] = {"watch": "replay.html"}
    farewell = "the replay has ended"
    further: ClassVar[Mapping[str, Reader]] = {
        "block": lambda content: AskBlock(
            *(number(name, content.get(name), 0, LARGEST, whole=True) for name in ("tape", "number"))
        ),
        "figures": lambda content: float(number("t_s", content.get("t_s"), 0, LARGEST)),
    }

    def __init__(
        self, tapes: list[Tape], say: Callable[[str], None], *, speed: float = 1.0, loop: bool = False
    ) -> None:
        super().__init__(None, say)
        self._tapes = tapes
        at_once, first_us = together(tapes), min(int(each.t_us[0]) for each in tapes)
        self._begins_us = [int(each.t_us[0]) - first_us if at_once else 0 for each in tapes]
        shown = [
            {**tape.description(label if len(tapes) > 1 else ""), "begin_s": begin_us / 1e6}
            for tape, label, begin_us in zip(tapes, LABELS, self._begins_us, strict=False)
        ]
        self._hello = messages.text(
            "hello", version=messages.VERSION, view="watch", speed=speed, loop=loop, history_s=messages.HISTORY_S,
            duration_s=max(each["begin_s"] + each["duration_s"] for each in shown), together=at_once, tapes=shown,
        )  # fmt: skip

    def _greet(self, client: "Client") -> None:
        client.post(self._hello)

    def _obey(self, client: "Client", message: object) -> None:
        if isinstance(message, AskBlock):
            if message.tape >= len(self._tapes):
                raise MistakeError(f"there is no recording {message.tape}")
            client.post_replaceable(block(self._tapes[message.tape], message))
        elif isinstance(message, float):  # a page asks for the figures at a time [s]
            at_us = round(1e6 * message)
            figures = [
                None if at_us < begin_us else tape.figures(int(tape.t_us[0]) + at_us - begin_us)
                for tape, begin_us in zip(self._tapes, self._begins_us, strict=True)
            ]
            client.post(messages.text("figures", t_s=message, tapes=figures))
        else:
            raise MistakeError("a replay has no settings and no hand")

    def _send(self) -> None:
        """Send nothing: a page asks."""


def block(tape: Tape, asked: AskBlock) -> bytes:
    """Return a BLOCK message; one beyond the end has no rows."""
    begin_s, rows, (*frames, contacts) = tape.block(asked.number)
    sizes = rows.shape[1], rows.shape[0], contacts.shape[1], len(contacts), frames[2].shape[1]
    head = _HEAD.pack(BLOCK, asked.tape, tape.axes, asked.number, *sizes, begin_s)
    numbers = [rows, *(each.T for each in frames)]
    return b"".join([head, *(each.astype("<f4").tobytes() for each in numbers), contacts.T.tobytes()])
