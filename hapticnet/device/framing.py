"""Frames on the serial line: a message and its CRC, COBS-encoded, between zero bytes.

Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999) leaves no zero
inside a frame, so after lost or damaged bytes the receiver resynchronizes at the next zero byte.
"""

import binascii
from typing import Final

LONGEST_BODY: Final = 48
"""Longest message [bytes], including its kind; the size of the firmware's buffers."""

LONGEST_FRAME: Final = LONGEST_BODY + 3
"""Longest frame [bytes] without its delimiter: adds 2 bytes of CRC and 1 byte of COBS."""

_CRC_START: Final = 0xFFFF


def _crc(body: bytes) -> bytes:
    """CRC-16/CCITT-FALSE, little-endian; its check value for "123456789" is 0x29B1."""
    return binascii.crc_hqx(body, _CRC_START).to_bytes(2, "little")


def frame(body: bytes) -> bytes:
    """Return a message as a frame with its delimiter."""
    blocks = (body + _crc(body)).split(b"\0")
    return b"".join(bytes((len(block) + 1,)) + block for block in blocks) + b"\0"


def _unstuffed(stuffed: bytes) -> bytes | None:
    """Decode COBS; None if a length byte points past the end. Frames are too short for blocks of 254 bytes."""
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
    """Extract messages from a stream of bytes that may start anywhere and contain anything.

    Attributes
    ----------
    received
        Number of messages with a correct CRC.
    damaged
        Number of frames dropped because their COBS, CRC or length was wrong, including an incomplete frame before the
        first delimiter.
    """

    __slots__ = ("_oversize", "_partial", "damaged", "received")

    def __init__(self) -> None:
        self.received = 0
        self.damaged = 0
        self._partial = b""
        self._oversize = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; return the messages they complete, oldest first."""
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
        # An oversize frame is discarded, so memory stays bounded on a line without delimiters.
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
