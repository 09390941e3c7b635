"""What an adversary on the path does to datagrams: copy, change, cut, forge and repeat them."""

from collections import deque

import msgpack
import numpy as np

from hapticnet.protocol.messages import Close, Position, pack_position
from hapticnet.protocol.stats import Loss
from hapticnet.protocol.wire import OPEN, Kind, pack, pack_body, unpack

NUMBERS = (0, 1, 127, 128, 255, 256, 65_535, 65_536, 2**31, 2**32 - 1)
COMPONENTS = (0.0, -0.0, 0.01, -0.02, 0.031, 1e15, 1.1e15, -3e38, np.inf, -np.inf, np.nan)


class Adversary:
    """Spoils batches of datagrams. `calm` is the share that passes untouched."""

    def __init__(self, seed, *, calm=0.9, closes=0.001):
        self._rng = np.random.default_rng([seed, 77])
        self._past = deque(maxlen=400)
        self._calm = calm
        self._closes = closes
        self._tricks = (
            self._copy, self._repeat, self._flip, self._cut, self._elsewhere, self._forge, self._longer, self._append,
            self._reorder, self._leap, self._garbage, self._other_version,
        )  # fmt: skip

    def __call__(self, batch, _):
        arrives = []
        for data, address in batch:
            self._past.append((data, address))
            if self._rng.random() < self._closes:
                arrives.append((self._close(data), address))
            if self._rng.random() < self._calm:
                arrives.append((data, address))
                continue
            trick = self._tricks[self._rng.integers(len(self._tricks))]
            arrives = trick(arrives, data, address)
        return arrives

    def _any(self, values):
        return values[int(self._rng.integers(len(values)))]

    def _number(self):
        return int(self._any(NUMBERS)) if self._rng.random() < 0.5 else int(self._rng.integers(2**32))

    def _copy(self, arrives, data, address):
        return [*arrives, (data, address), (data, address)]

    def _repeat(self, arrives, data, address):
        return [*arrives, (data, address), self._any(self._past)]

    def _flip(self, arrives, data, address):
        changed = bytearray(data)
        for _ in range(int(self._rng.integers(1, 4))):
            changed[int(self._rng.integers(len(changed)))] ^= 1 << int(self._rng.integers(8))
        return [*arrives, (bytes(changed), address), (data, address)]

    def _cut(self, arrives, data, address):
        return [*arrives, (data[: int(self._rng.integers(len(data)))], address), (data, address)]

    def _elsewhere(self, arrives, data, _):
        return [*arrives, (data, ("elsewhere", int(self._rng.integers(3))))]

    def _reorder(self, arrives, data, address):
        return [(data, address), *arrives]

    def _garbage(self, arrives, data, address):
        return [*arrives, (self._rng.bytes(int(self._rng.integers(0, 1202))), address), (data, address)]

    def _forge(self, arrives, data, address):
        """Forge a position of the session from its address, of any kind of content."""
        frame = _frame(data)
        if frame is None:
            return [*arrives, (data, address)]
        sequence = (frame.sequence + int(self._rng.integers(-3, 4))) % 2**32
        payload = np.array([self._any(COMPONENTS)], ">f4").tobytes()
        payload += self._any((b"", self._rng.bytes(2), self._rng.bytes(4), b"\x7c\x00"))
        newest = self._any((None, self._number(), 1, 2, 50))
        loss = Loss(self._any((0.0, 0.01, 0.3, 1.0)), self._any((0.0, 0.5, 1.0))) if self._rng.random() < 0.3 else None
        body = pack_position(Position(self._number(), newest, payload, loss))
        return [*arrives, (pack(Kind.POSITION, frame.session, sequence, body), address), (data, address)]

    def _leap(self, arrives, data, address):
        frame = _frame(data)
        if frame is None:
            return [*arrives, (data, address)]
        sequence = (frame.sequence + int(self._any((99, 101, 900, 1023, 1025, 2999, 3000, 40_000, 2**31)))) % 2**32
        return [*arrives, (pack(Kind.POSITION, frame.session, sequence, frame.body), address), (data, address)]

    def _append(self, arrives, data, address):
        """Append fields, as a later revision may."""
        frame = _frame(data)
        if frame is None:
            return [*arrives, (data, address)]
        fields = msgpack.unpackb(frame.body)
        fields += self._any(([7], [7, 8], [101, 3], [3, 4, 5]))
        return [*arrives, (pack(Kind.POSITION, frame.session, frame.sequence, pack_body(tuple(fields))), address)]

    def _longer(self, arrives, data, address):
        """Write numbers longer than they need to be, which msgpack allows."""
        frame = _frame(data)
        if frame is None:
            return [*arrives, (data, address)]
        head = (
            b"\x95\x01\x04" + b"\xce" + frame.session.to_bytes(4, "big") + b"\xce" + frame.sequence.to_bytes(4, "big")
        )
        size = len(frame.body)
        return [
            *arrives,
            (head + self._any((b"\xc4" + bytes([size]), b"\xc5" + size.to_bytes(2, "big"))) + frame.body, address),
        ]

    def _other_version(self, arrives, data, address):
        changed = bytearray(data)
        changed[1] ^= 3
        return [*arrives, (bytes(changed), address), (data, address)]

    def _close(self, data):
        frame = _frame(data)
        if frame is None:
            return data
        return pack(Kind.CLOSE, frame.session, (frame.sequence + 1) % 2**32, pack_body(Close("forged")))


def _frame(data):
    """Return the frame of an open POSITION, None for anything else."""
    frame = unpack(data)
    return frame if frame.kind is Kind.POSITION and frame.version == OPEN else None
