"""Frames on the serial line: a message and its CRC in COBS, between zero bytes.

Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999) leaves no zero
inside a frame, so whatever was lost or garbled, the next zero byte starts afresh.
"""

import binascii
from typing import Final

LONGEST_BODY: Final = 48
"""Longest message [bytes], kind included; the firmware's buffers are made for it."""

LONGEST_FRAME: Final = LONGEST_BODY + 3
"""The same on the line without its delimiter: 2 bytes CRC, 1 byte COBS."""

_CRC_START: Final = 0xFFFF


def _crc(body: bytes) -> bytes:
    """CRC-16/CCITT-FALSE, low byte first as all of the wire; its check value for "123456789" is 0x29B1."""
    return binascii.crc_hqx(body, _CRC_START).to_bytes(2, "little")


def frame(body: bytes) -> bytes:
    """Return a message as it goes on the line, its delimiter included."""
    blocks = (body + _crc(body)).split(b"\0")
    return b"".join(bytes((len(block) + 1,)) + block for block in blocks) + b"\0"


def _unstuffed(stuffed: bytes) -> bytes | None:
    """Undo COBS; None when a length byte points beyond the end. Frames are too short for a block of 254."""
    blocks = []
    at = 0
    while at < len(stuffed):
        beyond = at + stuffed[at]
        if beyond > len(stuffed):
            return None
        blocks.append(stuffed[at + 1 : beyond])
        at = beyond
    return b"\0".join(blocks)


class Deframer:
    """Finds messages in a stream of bytes that may start anywhere and hold anything.

    Attributes
    ----------
    received
        Messages whose CRC was right.
    damaged
        Frames dropped because their COBS or CRC was wrong, or because they were too short or too long. What comes
        before the first delimiter is such a frame, too, unless it is whole.
    """

    __slots__ = ("_oversize", "_partial", "damaged", "received")

    def __init__(self) -> None:
        self.received = 0
        self.damaged = 0
        self._partial = b""
        self._oversize = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes, however many; return the messages they complete, oldest first."""
        *ended, rest = data.split(b"\0")
        bodies = []
        for end in ended:
            body = None if self._oversize else self._body(self._partial + end)
            if body is not None:
                bodies.append(body)
            elif self._oversize or self._partial or end:
                self.damaged += 1
            self._partial = b""
            self._oversize = False
        if len(self._partial) + len(rest) > LONGEST_FRAME:
            self._oversize = True
        # Nothing of an oversize frame is kept, so memory is bounded on a line without delimiters.
        self._partial = b"" if self._oversize else self._partial + rest
        self.received += len(bodies)
        return bodies

    def _body(self, stuffed: bytes) -> bytes | None:
        if len(stuffed) > LONGEST_FRAME:
            return None
        checked = _unstuffed(stuffed)
        if checked is None or len(checked) < 3 or _crc(checked[:-2]) != checked[-2:]:
            return None
        return checked[:-2]
