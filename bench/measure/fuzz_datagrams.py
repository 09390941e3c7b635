"""Hostile datagrams: random, mutated, truncated, spliced, and well formed with hostile contents."""

import random
from collections import deque
from typing import TYPE_CHECKING, Any, Final

import msgpack

from hapticnet.codec.registry import every_codec
from hapticnet.protocol.messages import HELLO_BYTES, Hello, pack_hello
from hapticnet.protocol.wire import MAX_DATAGRAM_BYTES, Kind, pack_body

CODECS = every_codec()

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

REMEMBERED: Final = 512
"""True datagrams kept to be mutated; newer ones replace older ones."""

VALUES: Final[tuple[Any, ...]] = (
    0, 1, -1, 127, 255, 2**15, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**63, 2**64 - 1, -(2**63), True, False, None,
    0.0, -0.0, 1.0, 0.1, 20.0, 1000.0, 1e6, 1e308, -1e308, 5e-324, float("nan"), float("inf"), float("-inf"),
    "", "x", "x" * 65, "\x1b[2J", "\u202e", "deadband", "no such codec", b"", b"\0", b"\xff" * 16, bytes(16),
    bytes(1000), [], [0], [[]], [[[[]]]], [0] * 16, [0] * 17, {}, {"a": 1}, {1: 2}, {"k": float("nan")},
    msgpack.ExtType(1, b"x"), msgpack.Timestamp(0, 0),
)  # fmt: skip
"""Values for any field."""

RAW_BODIES: Final = (
    b"", b"\x91" * 600, b"\xdc\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xa1\xff", b"\xc1",
    b"\xc6\xff\xff\xff\xff", b"\xd9\xff", b"\xc7\xff\x01", b"\x93\x00\xc0", b"\x92\x81\x91\x00\x00\x00",
)  # fmt: skip
"""Bodies that are invalid msgpack, or claim more bytes than they have."""

CODEC_PARAMETERS: Final = ("hysteresis", "absolute_every", "probability", "step_fraction", "degree", "unknown")


class Fuzz:
    """Make hostile datagrams out of true ones.

    Attributes
    ----------
    corpus
        Datagrams that the nodes sent to each other. Add to it during the session.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.corpus: deque[bytes] = deque(maxlen=REMEMBERED)
        self._ways: Sequence[Callable[[], bytes]] = (
            self.noise, self.flipped, self.flipped, self.truncated, self.spliced, self.repeated, self.stretched,
            self.reframed, self.reframed, self.refilled, self.refilled, self.refilled,
        )  # fmt: skip

    def datagram(self) -> bytes:
        """Return a hostile datagram made in one of the ways."""
        return self.random.choice(self._ways)()

    def noise(self) -> bytes:
        """Return random bytes, sometimes more than a receiver reads."""
        return self.random.randbytes(self.random.randrange(MAX_DATAGRAM_BYTES + 2 if self.one_in(8) else 64))

    def flipped(self) -> bytes:
        """Return a true datagram with one to four bytes changed."""
        data = bytearray(self._true())
        for _ in range(self.random.randrange(1, 5)):
            data[self.random.randrange(len(data))] ^= 1 << self.random.randrange(8)
        return bytes(data)

    def truncated(self) -> bytes:
        """Return the beginning of a true datagram."""
        data = self._true()
        return data[: self.random.randrange(len(data))]

    def spliced(self) -> bytes:
        """Return the beginning of one true datagram and the end of another."""
        one, other = self._true(), self._true()
        return one[: self.random.randrange(len(one))] + other[self.random.randrange(len(other)) :]

    def repeated(self) -> bytes:
        """Return a true datagram unchanged."""
        return self._true()

    def stretched(self) -> bytes:
        """Return a true datagram with bytes inserted."""
        data, place = self._true(), self.random.randrange(30)
        return data[:place] + self.random.randbytes(self.random.randrange(1, 9)) + data[place:]

    def reframed(self) -> bytes:
        """Return a true datagram with one or two elements of its frame replaced."""
        frame = self._frame()
        for _ in range(self.random.randrange(1, 3)):
            index = self.random.randrange(len(frame))
            if index == 1 and not self.one_in(4):
                frame[1] = int(self.random.choice(list(Kind)))
            elif index == 3 and not self.one_in(4) and type(frame[3]) is int:
                frame[3] = (frame[3] + self.random.choice((1, 2, 99, 2999, 3000, 32767, 2**31, -1, -200))) & 0xFFFFFFFF
            else:
                frame[index] = self.random.choice(VALUES)
        return self._packed(frame)

    def refilled(self) -> bytes:
        """Return a true datagram whose body has one or two of its fields replaced, or is not an array."""
        frame = self._frame()
        frame[4] = self.body(frame[4])
        if type(frame[3]) is int:
            frame[3] = (frame[3] + self.random.randrange(3)) & 0xFFFFFFFF
        return self._packed(frame)

    def body(self, like: object) -> bytes:
        """Return a hostile body, derived from the true one if that can be read."""
        if self.one_in(10):
            return self.random.choice(RAW_BODIES)
        try:
            fields = list(msgpack.unpackb(like)) if isinstance(like, bytes) else [0, None, b""]
        except (ValueError, TypeError):
            fields = [self.random.randrange(2**32), None, b""]
        for _ in range(self.random.randrange(1, 3)):
            if fields:
                fields[self.random.randrange(len(fields))] = self._value()
        if self.one_in(8):
            fields.append(self._value())
        elif self.one_in(8) and fields:
            fields.pop()
        return self._packed(fields)

    def request(self) -> bytes:
        """Return a request that is nearly acceptable."""
        fields: list[Any] = ["deadband", {}, 0.1, 0.1, 1.0, 1000.0, 1, "fuzz", None, 0, False, 0.0]
        fields[-2:] = self.one_in(3), self.random.choice((0.0, 0.25, 0.9))
        fields[0] = self.random.choice((*CODECS, "deadband"))
        if self.one_in(2):
            names = self.random.choices(CODEC_PARAMETERS, k=self.random.randrange(1, 3))
            fields[1] = {name: self._value() for name in names}
        if self.one_in(2):
            fields[self.random.randrange(len(fields))] = self._value()
        return self._packed(fields) if not self.one_in(20) else self.random.choice(RAW_BODIES)

    def hello(self, nonce: int, cookie: bytes, request: bytes, mac: bytes, version: int) -> bytes:
        """Return a HELLO with these contents, padded to the required length."""
        data = pack_hello(Hello(nonce, cookie, request, mac), 0, version)
        return data if len(data) >= HELLO_BYTES else data + bytes(HELLO_BYTES - len(data))

    def one_in(self, count: int) -> bool:
        """Return True once in `count` times, by chance."""
        return self.random.randrange(count) == 0

    def _true(self) -> bytes:
        return self.random.choice(self.corpus)

    def _frame(self) -> list[Any]:
        return list(msgpack.unpackb(self._true()))

    def _value(self) -> Any:
        if self.one_in(4):
            return self.random.randrange(2**32)
        if self.one_in(6):
            return self.random.randbytes(self.random.randrange(40))
        return self.random.choice(VALUES)

    def _packed(self, fields: list[Any]) -> bytes:
        try:
            return pack_body(tuple(fields))
        except (ValueError, OverflowError, TypeError):  # deeper or larger than msgpack writes
            return self.noise()
