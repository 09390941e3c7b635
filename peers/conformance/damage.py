"""Damaged and random datagrams."""

import random
from collections.abc import Callable
from typing import Final

import msgpack

from conformance.golden import SESSION, read
from conformance.session import Scenario, Session
from hapticnet.protocol.wire import Kind

# Beginnings of msgpack: integers, arrays, text, bytes and floats of several sizes.
HEADS: Final = bytes.fromhex("007f909195a1c0c2c4cacbcccdcecfd0d3d9e0")
NUMBER: Final = SESSION.to_bytes(4, "big")


def seeds(to: str) -> list[bytes]:
    """Return the datagrams of the vectors that go to a master or a slave and are not refused."""
    kinds = {
        "master": (
            Kind.WELCOME,
            Kind.REFUSE,
            Kind.FORCE,
            Kind.KEEPALIVE,
            Kind.CLOSE,
            Kind.RESET,
            Kind.COOKIE,
            Kind.NOTICE,
        ),
        "slave": (Kind.HELLO, Kind.POSITION, Kind.KEEPALIVE, Kind.CLOSE, Kind.RESET),
    }[to]
    found = [bytes.fromhex(each["hex"]) for each in read("protocol")["datagrams"]]
    found += [bytes.fromhex(each["hex"]) for each in read("refused")["datagrams"] if each["outcome"] == "taken"]
    frames = [(data, *msgpack.unpackb(data)) for data in found]
    # Not a notice with shapes: a peer that did not ask for them need not read it.
    return [data for data, _, kind, _, _, body in frames if kind in kinds and (kind != Kind.NOTICE or body[0] != 0x93)]


def seed_of(chance: random.Random, known: list[bytes], sequence: int) -> bytes:
    """Return a datagram to damage, often numbered as the next one. CLOSE is rare: nothing can be disturbed after it."""
    while True:
        frame = msgpack.unpackb(chance.choice(known))
        if frame[1] != Kind.CLOSE or chance.random() < 0.03:
            break
    if frame[2] != 0 and chance.random() < 0.7:
        frame[3] = sequence
    data: bytes = msgpack.packb(frame)
    return data


def damaged(chance: random.Random, data: bytes) -> bytes:
    """Return a datagram, some of whose bytes were changed, left out or repeated; or random bytes."""
    if chance.random() < 0.05:
        return chance.randbytes(chance.choice([0, 1, 5, 20, 100, 1200, 1201, 2000]))
    frame = msgpack.unpackb(data)
    inside = chance.random() < 0.5
    part = changed(chance, frame[4] if inside else data)  # a body, or all of it
    return msgpack.packb([*frame[:4], part]) if inside else part


def changed(chance: random.Random, data: bytes) -> bytes:
    """Return bytes, some of which were changed, left out or repeated."""
    part = bytearray(data)
    for _ in range(chance.randint(1, 2)):
        at = chance.randrange(len(part) + 1)
        change = chance.choice(["byte", "head", "cut", "repeat", "more"])
        if change == "cut":
            del part[at:]
        elif change == "repeat":
            part[at:at] = part[at : at + chance.randint(1, 9)]
        elif change == "more":
            part.append(chance.choice(HEADS))
            part[:1] = bytes([part[0] + 1 & 0xFF])  # of an array: one element more
        elif at < len(part):
            part[at] = chance.randrange(256) if change == "byte" else chance.choice(HEADS)
    return bytes(part)


def of_session(data: bytes, number: int) -> bytes:
    """Return a datagram of the session of the vectors as one of another session."""
    return data.replace(NUMBER, number.to_bytes(4, "big"))


SEEDS, ROUNDS, EACH_ROUND = 8, 100, 6


def session_of(log: list[tuple[int, bytes]]) -> tuple[int, int]:
    """Return number and newest sequence number of the session in which a slave has sent."""
    _, _, number, sequence, _ = msgpack.unpackb(log[-1][1])
    return number, sequence


def for_master(seed: int) -> Callable[[Session], None]:
    """Return what happens in a session whose master gets damaged datagrams between the others."""

    def play(session: Session) -> None:
        chance, known, log = random.Random(seed), seeds("master"), session.feedback.log
        session.run(0.5)
        for _ in range(ROUNDS):
            number, newest = session_of(log)
            for _ in range(EACH_ROUND):
                recent = [data for _, data in log[-10:]]
                source = of_session(
                    seed_of(chance, chance.choice([known, recent]), newest + chance.randint(0, 3)), number
                )
                session.recorder.receive_datagram(damaged(chance, source), session.loop.now_us)
            session.run(0.004)

    return play


def for_slave(seed: int) -> Callable[[Session], None]:
    """Return what happens in a session whose slave gets damaged datagrams between the others."""

    def play(session: Session) -> None:
        chance, known = random.Random(seed), seeds("slave")
        session.run(0.5)
        for _ in range(ROUNDS):
            number, _ = session_of(session.feedback.log)
            _, newest = session_of(session.forward.log)
            for _ in range(EACH_ROUND):
                source = seed_of(chance, known, newest + chance.randint(0, 3))
                session.loop.slave.receive_datagram(
                    of_session(damaged(chance, source), number), "loopback", session.loop.now_us
                )
            session.run(0.004)

    return play


MASTERS: Final = {f"damaged {seed}": Scenario(play=for_master(seed), network="slow") for seed in range(SEEDS)}
SLAVES: Final = {f"damaged {seed}": Scenario(play=for_slave(seed), network="slow") for seed in range(SEEDS)}
