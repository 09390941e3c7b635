"""An attacker who carries every datagram of a session: reads, records, replays, delays, drops and forges."""

import heapq
import random
from collections import deque

from hapticnet.protocol.messages import Close, Code, Force, Keepalive, Refuse
from hapticnet.protocol.wire import Kind, pack, pack_body, unpack

REMEMBERED = 2_000
MOODS = ("honest", "honest", "cut", "slow", "shuffle", "replay", "forge", "forge", "chaos")


class Injector:
    """Both directions of a network, in the hands of an attacker who acts by chance.

    Every now and then the attacker changes its mood: some moods only pass on or drop, others replay and forge.

    `forges`: whether it also alters and makes datagrams; otherwise it is a bad network that also replays.
    """

    def __init__(self, seed: int, *, forges: bool = True) -> None:
        self.random = random.Random(seed)
        self.quiet = False
        self.sent = 0
        self._forges = forges
        self._mood = "honest"
        self._until_us = 500_000
        self._recorded: deque[tuple[bool, bytes]] = deque(maxlen=REMEMBERED)
        self.forward = Direction(self, to_slave=True)
        self.feedback = Direction(self, to_slave=False)

    def handle(self, direction: "Direction", data: bytes, now_us: int) -> None:
        """Decide what becomes of a datagram, and what else is sent."""
        chance = self.random
        self._recorded.append((direction.to_slave, data))
        if self.quiet:
            direction.deliver(data, now_us)
            return
        if now_us >= self._until_us:
            self._mood = chance.choice(MOODS)
            self._until_us = now_us + chance.randrange(20_000, 600_000)
        mood = self._mood if self._mood != "chaos" else chance.choice(MOODS)
        if mood == "cut":
            return
        if mood == "slow":
            direction.deliver(data, now_us + chance.choice((150_000, 400_000, 900_000, 1_500_000, 3_000_000)))
        elif mood == "shuffle":
            if chance.random() > 0.3:
                direction.deliver(data, now_us + chance.randrange(60_000))
        else:
            direction.deliver(data, now_us)
        if mood == "replay":
            for _ in range(chance.randrange(4)):
                self._send(*chance.choice(self._recorded), now_us + chance.randrange(2_000_000))
        elif mood == "forge" and self._forges:
            for _ in range(chance.randrange(4)):
                self._send(*self._forged(*chance.choice(self._recorded)), now_us + chance.randrange(50_000))

    def _send(self, to_slave: bool, data: bytes, at_us: int) -> None:
        self.sent += 1
        if self.random.random() < 0.1:  # also back to where it came from
            to_slave = not to_slave
        (self.forward if to_slave else self.feedback).deliver(data, at_us)

    def _forged(self, to_slave: bool, data: bytes) -> tuple[bool, bytes]:
        chance = self.random
        if chance.random() < 0.3:
            changed = bytearray(data)
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
            return to_slave, bytes(changed)
        true = unpack(data)
        kind = chance.choice(list(Kind)) if chance.random() < 0.5 else true.kind
        sequence = (true.sequence + chance.choice((0, 1, 2, 100, 2_999, 32_767, 2**31, -1, -200))) % 2**32
        body = true.body
        if chance.random() < 0.5:
            body = chance.choice(
                (
                    pack_body(Force(sequence, b"\xff" * 4)),
                    pack_body(Keepalive(sequence, sequence)),
                    pack_body(Close("forged", Code.FAILED)),
                    pack_body(Refuse(sequence, "forged", Code.FULL)),
                    body[: chance.randrange(len(body) + 1)],
                    chance.randbytes(len(body)),
                    b"",
                )
            )
        version = true.version if chance.random() < 0.9 else 3 - true.version
        return to_slave, pack(kind, true.session, sequence, body, version)


class Direction:
    """One direction; satisfies `network.Channel`."""

    def __init__(self, injector: Injector, *, to_slave: bool) -> None:
        self.to_slave = to_slave
        self._injector = injector
        self._waiting: list[tuple[int, int, bytes]] = []
        self._number = 0

    def push(self, item: bytes, size_bytes: int, now_us: int) -> None:  # noqa: ARG002 - a channel's signature
        self._injector.handle(self, item, now_us)

    def deliver(self, data: bytes, at_us: int) -> None:
        self._number += 1
        heapq.heappush(self._waiting, (at_us, self._number, data))

    def due(self, now_us: int) -> list[bytes]:
        due = []
        while self._waiting and self._waiting[0][0] <= now_us:
            due.append(heapq.heappop(self._waiting)[2])
        return due

    def next_timer_us(self) -> int | None:
        return self._waiting[0][0] if self._waiting else None
