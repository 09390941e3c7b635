"""The largest force on a finger that a hostile slave can cause, found by a search over what it may send.

Two searches, each on fingers of any stiffness in a range. *asked*: any force, now and ahead, requested from the force
loop at its own rate: all that a slave can reach, whatever it sends. *sent*: datagrams of an open session to a master
with a device: any rate, any payload of several codecs, announced models, keepalives, and new sessions at any moment.
Both mutate the worst sequences found so far; a search starts from those in hostile_worst.json, which tests replay
(``--keep`` writes it). The device is simulated in Python or (``--device simavr``) as the compiled firmware, in virtual
time. On the simulated device, *asked* also grows sequences move by move from copies of the loop and the device, so
that a try costs a few moves and not a whole sequence.
"""

import argparse
import contextlib
import copy
import functools
import itertools
import json
import random
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import record
from force_loop import FINGERS_N_M
from force_scenarios import SEED_SHIFT_US, TICK_US, Simulated, started

from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.device.simulated import Finger, PlantSettings
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.node.decoders import OF_CODEC, pack_model
from hapticnet.node.fingertip import Fingertip
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.protocol.messages import (
    COOKIE_BYTES,
    TICKET_BYTES,
    Close,
    Cookie,
    Force,
    Grant,
    Keepalive,
    Welcome,
    pack_answer,
    unpack_hello,
    unpack_position,
    unpack_request,
)  # fmt: skip
from hapticnet.protocol.wire import Kind, pack, pack_body, unpack
from hapticnet.scene.ahead import LayerAhead

WORST: Final = Path(__file__).with_name("hostile_worst.json")
"""The worst sequence known of each search, device and finger."""

RANGES_N_M: Final = tuple(itertools.pairwise(FINGERS_N_M))
"""Ranges of stiffness [N/m]: each search has its worst in each."""

LONGEST_MS: Final = 5000
"""Length of a sequence: time to find the finger, learn it, and mislead the loop."""

KEPT: Final = 12
"""Worst sequences that are mutated further."""

SAME_DEVICE: Final = 0.6
"""Share of the mutations that keep the finger and the device's noise and phase."""

GROWING: Final = 6
CHILDREN: Final = 18
"""Sequences that grow at a time, and how many they become before the worst of them are kept."""

FORCES_N: Final = (0.0, 0.3, 1.0, 3.0, 4.6, 6.0)
PAUSES_MS: Final = (1, 3, 5, 10, 20, 40, 80, 160, 300)
RATES_HZ: Final = (20.0, 31.0, 50.0, 137.0, 500.0, 1000.0, 1e5)
CODECS: Final = ("raw", "deadband", "linear-predictive", "adaptive-predictive", "motion-predictive")
SMALLEST_SESSION: Final = 1 << 16


class Asked(NamedTuple):
    """A force, and the force ahead, that are requested from the loop for some time."""

    ms: int
    force_n: float
    ahead_n: float

    @classmethod
    def drawn(cls, rng: random.Random) -> "Asked":
        force_n = some_force_n(rng)
        return cls(
            rng.choice((*PAUSES_MS, rng.randint(1, 400))), force_n, rng.choice((force_n, some_force_n(rng), 6.0))
        )

    def mutated(self, rng: random.Random) -> "Asked":
        return Asked(
            min(500, max(1, self.ms + rng.randint(-15, 15))),
            max(0.0, self.force_n + rng.gauss(0.0, 0.3)),
            max(0.0, self.ahead_n + rng.gauss(0.0, 0.3)),
        )


class Sent(NamedTuple):
    """What a slave sends, and how long it then waits: "force", "keepalive", "model", "nothing" or "session"."""

    ms: int
    kind: str
    force_n: float
    slope: float
    rate_hz: float

    @classmethod
    def drawn(cls, rng: random.Random) -> "Sent":
        kind = rng.choice(("force", "force", "force", "keepalive", "model", "nothing", "session"))
        return cls(rng.choice(PAUSES_MS), kind, some_force_n(rng), rng.uniform(-60.0, 60.0), rng.choice(RATES_HZ))

    def mutated(self, rng: random.Random) -> "Sent":
        ms = min(500, max(1, self.ms + rng.randint(-15, 15)))
        return self._replace(
            ms=ms, force_n=max(0.0, self.force_n + rng.gauss(0.0, 0.3)), slope=self.slope * rng.gauss(1, 0.3)
        )


Move = Asked | Sent


PRESS: Final = Asked(120, 6.0, 6.0)
"""How hard a growing sequence could still press."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """Moves, the stiffness [N/m] of the finger they press, and the seed of the device's noise and phase."""

    stiffness_n_m: float
    seed: int
    moves: tuple[Move, ...]


def some_force_n(rng: random.Random) -> float:
    return rng.choice((*FORCES_N, rng.uniform(0.0, 5.0), rng.uniform(0.0, 1.0)))


def play_asked(device: Simulated, now_us: int, sequence: Sequence) -> float:
    """Return the largest true force [N] on the finger while the loop follows the moves."""
    asked = AskedLoop(device, now_us)
    for move in sequence.moves:
        assert isinstance(move, Asked)
        asked.do(move)
    return asked.largest_n


class AskedLoop:
    """A force loop that follows moves; with a device in Python it can be copied at any moment.

    Attributes
    ----------
    largest_n
        Largest true force [N] on the finger.
    """

    def __init__(self, device: Simulated, now_us: int) -> None:
        self._device = device
        self._now_us = now_us
        self._fingertip = Fingertip(device, ForceControlSettings())
        self.largest_n = 0.0

    def do(self, move: Asked) -> None:
        """Ask for a force and a force ahead for the time of a move."""
        for _ in range(move.ms):
            self._now_us += TICK_US
            self._fingertip.press(move.force_n, self._now_us, move.ahead_n)
            self.largest_n = max(self.largest_n, self._device.contact_force_n or 0.0)

    def could_press_n(self) -> float:
        """Return the largest force [N] so far or within `PRESS` from now."""
        pressed = copy.deepcopy(self)
        pressed.do(PRESS)
        return pressed.largest_n


class HostileSlave:
    """The slave's end of open sessions with one master; it sends what the moves say."""

    def __init__(self, master: MasterNode) -> None:
        self._master = master
        self._number = SMALLEST_SESSION
        self._sequence = 0
        self._newest: int | None = None
        self._t_us = 0
        self.rate_hz = 1000.0
        self._announced = False

    def answer(self, now_us: int) -> None:
        """Answer the requests of the master: grant every session, at the present rate."""
        for data in self._master.datagrams_to_send():
            datagram = unpack(data)
            if datagram.kind is Kind.POSITION:
                self._t_us = unpack_position(datagram.body).t_us
            if datagram.kind is not Kind.HELLO:
                continue
            hello = unpack_hello(datagram.body)
            if not hello.cookie:
                self._send(Kind.COOKIE, pack_body(Cookie(hello.nonce, bytes(COOKIE_BYTES))), now_us, session=0)
                continue
            self._number += 1
            self._sequence, self._newest = 0, None
            self._announced = unpack_request(hello.request).announced
            grant = Grant(self._number, self.rate_hz, 45_000, "hostile", bytes(TICKET_BYTES), True, self._announced)
            self._send(Kind.WELCOME, pack_body(Welcome(hello.nonce, pack_body(grant))), now_us, session=self._number)

    def do(self, move: Sent, codec: str, now_us: int) -> None:
        """Send what a move says, for the newest position."""
        if move.kind == "session":
            self.rate_hz = move.rate_hz
            self._send(Kind.CLOSE, pack_body(Close("another")), now_us)
        elif move.kind == "keepalive":
            self._send(Kind.KEEPALIVE, pack_answer(Keepalive(self._t_us, self._newest)), now_us)
        elif move.kind in ("force", "model"):
            payload = payload_of(move, codec)
            if self._announced:
                payload = pack_model((layer_of(move),), 1) if move.kind == "model" else OF_CODEC + payload
            self._newest = self._sequence + 1
            self._send(Kind.FORCE, pack_answer(Force(self._t_us, payload)), now_us)

    def _send(self, kind: Kind, body: bytes, now_us: int, *, session: int | None = None) -> None:
        if kind not in (Kind.COOKIE, Kind.WELCOME):
            self._sequence += 1
        number = self._number if session is None else session
        self._master.receive_datagram(pack(kind, number, self._sequence, body), now_us)


def payload_of(move: Sent, codec: str) -> bytes:
    """Return a payload of a codec that asks for the force of a move, and for a slope where the codec has one."""
    value = struct.pack(">f", move.force_n)
    if codec == "linear-predictive":
        return value + struct.pack(">f", move.slope)
    if codec == "adaptive-predictive":
        return value + struct.pack(">e", move.slope)
    if codec == "motion-predictive":
        travel, stiffness, viscosity = 0.1 * move.slope, 100.0 * abs(move.slope), abs(move.slope)
        return bytes([3]) + struct.pack(">ffee", move.force_n, travel, stiffness, viscosity)
    return value


def layer_of(move: Sent) -> LayerAhead:
    """Return a layer as stiff as a move says, somewhere in the hand's path."""
    return LayerAhead(0.01 * move.force_n, 10.0 + 100.0 * abs(move.slope), viscosity_n_s_per_m=abs(move.slope))


def play_sent(device: Simulated, now_us: int, sequence: Sequence) -> float:
    """Return the largest true force [N] on the finger while a slave sends what the moves say."""
    codec = CODECS[sequence.seed % len(CODECS)]
    rng = np.random.default_rng(sequence.seed)
    operator = ScriptedOperator(InsertionSettings(insertions=10), rng)
    settings = MasterSettings(codec=codec, announced=sequence.seed % 2 == 0)
    master = MasterNode(operator, device, settings, rng)
    slave = HostileSlave(master)
    largest_n, next_us = 0.0, now_us
    for move in sequence.moves:
        assert isinstance(move, Sent)
        end_us = now_us + 1000 * move.ms
        slave.do(move, codec, now_us)
        while now_us < end_us:
            now_us = max(now_us, next_us)
            next_us = now_us + master.period_us
            master.tick(now_us)
            slave.answer(now_us)
            master.drive(now_us)
            largest_n = max(largest_n, device.contact_force_n or 0.0)
            now_us = next_us
    return largest_n


def grown(range_n_m: tuple[float, float], seconds: float, rng: random.Random) -> list[Sequence]:
    """Return the worst of each round of growing sequences on the simulated device, for some time."""
    worst, end_s = [], time.monotonic() + seconds
    while time.monotonic() < end_s:
        stiffness_n_m, seed = some_stiffness(range_n_m, rng), rng.randrange(70)
        opening = [PRESS] * rng.randint(4, 10)
        with on_finger("sim", stiffness_n_m, seed) as (device, now_us):
            loop = AskedLoop(device, now_us)
        for move in opening:
            loop.do(move)
        growing = [(loop.could_press_n(), loop, opening)]
        while growing and time.monotonic() < end_s:
            children = []
            for _, parent, moves in growing * (CHILDREN // len(growing)):
                child, more = copy.deepcopy(parent), [Asked.drawn(rng) for _ in range(rng.randint(1, 4))]
                for move in more:
                    child.do(move)
                children.append((child.could_press_n(), child, [*moves, *more]))
            best = max(children, key=lambda each: each[0])
            worst.append((best[0], Sequence(stiffness_n_m, seed, (*best[2], PRESS))))
            short = [each for each in children if sum(move.ms for move in each[2]) < LONGEST_MS - 2 * PRESS.ms]
            growing = sorted(short, key=lambda each: -each[0])[:GROWING]
        worst = sorted(worst, key=lambda each: -each[0])[:KEPT]
    return [sequence for _, sequence in worst]


def search(
    draw: Callable[[random.Random], Move],
    evaluate: Callable[[Sequence], float],
    known: list[Sequence],
    range_n_m: tuple[float, float],
    seconds: float,
    rng: random.Random,
) -> tuple[int, Sequence]:
    """Return how many sequences were played, and the one with the largest force."""
    worst = [(evaluate(sequence), sequence) for sequence in known]
    played, end_s = len(worst), time.monotonic() + seconds
    while time.monotonic() < end_s or not played:
        if len(worst) < KEPT or rng.random() < 0.15:
            stiffness_n_m, seed = some_stiffness(range_n_m, rng), rng.randrange(70)
            moves = [draw(rng) for _ in range(rng.randint(4, 40))]
        else:
            _, like = rng.choice(worst)
            stiffness_n_m, seed = like.stiffness_n_m, like.seed
            if rng.random() > SAME_DEVICE:
                stiffness_n_m, seed = some_stiffness(range_n_m, rng), rng.randrange(70)
            moves = mutated(list(like.moves), draw, rng)
        sequence = Sequence(stiffness_n_m, seed, cut(moves))
        worst = sorted([*worst, (evaluate(sequence), sequence)], key=lambda each: -each[0])[:KEPT]
        played += 1
    return played, max(worst, key=lambda each: each[0])[1]


def some_stiffness(range_n_m: tuple[float, float], rng: random.Random) -> float:
    """Return a stiffness [N/m] of a range, often an end of it."""
    return rng.choice((*range_n_m, float(round(rng.uniform(*range_n_m))), float(round(rng.uniform(*range_n_m)))))


def mutated(moves: list[Move], draw: Callable[[random.Random], Move], rng: random.Random) -> list[Move]:
    """Return the moves with one to four changes."""
    for _ in range(rng.randint(1, 4)):
        at, change = rng.randrange(len(moves)), rng.random()
        if change < 0.25:
            moves[at] = draw(rng)
        elif change < 0.4:
            moves.insert(at, draw(rng))
        elif change < 0.5 and len(moves) > 2:
            del moves[at]
        elif change < 0.6:  # the same again
            other = rng.randrange(len(moves))
            moves[at:at] = moves[min(at, other) : max(at, other) + 1]
        else:
            moves[at] = moves[at].mutated(rng)
    return moves


def cut(moves: list[Move]) -> tuple[Move, ...]:
    """Return the moves of the first `LONGEST_MS`, at least one."""
    total_ms, kept = 0, []
    for move in moves:
        total_ms += move.ms
        if kept and total_ms > LONGEST_MS:
            break
        kept.append(move)
    return tuple(kept)


class Search(NamedTuple):
    """What a search draws, and how it is played."""

    move: type[Asked] | type[Sent]
    play: Callable[[Simulated, int, Sequence], float]


SEARCHES: Final = {"asked": Search(Asked, play_asked), "sent": Search(Sent, play_sent)}


def read_worst() -> list[dict[str, Any]]:
    """Return the rows of the worst sequences known."""
    rows: list[dict[str, Any]] = json.loads(WORST.read_text(encoding="utf-8"))
    return rows


def sequence_of(row: dict[str, Any]) -> Sequence:
    """Return the sequence of a row."""
    return Sequence(
        row["stiffness_n_m"], row["seed"], tuple(SEARCHES[row["what"]].move(*move) for move in row["moves"])
    )


@contextlib.contextmanager
def on_finger(kind: str, stiffness_n_m: float, seed: int) -> Iterator[tuple[Simulated, int]]:
    """Yield a device on a finger, and the time [µs] at which a sequence begins."""
    settings = PlantSettings(finger=Finger(stiffness_n_m=stiffness_n_m))
    with started(kind, settings, seed % 7) as (device, now_us):
        yield device, now_us + SEED_SHIFT_US


def evaluated(kind: str, what: str, sequence: Sequence) -> float:
    """Return the largest force [N] of a sequence on its finger."""
    with on_finger(kind, sequence.stiffness_n_m, sequence.seed) as (device, now_us):
        return SEARCHES[what].play(device, now_us, sequence)


def searched(
    kind: str, what: str, range_n_m: tuple[float, float], worst: list[dict[str, Any]], seconds: float, seed: int
) -> dict[str, Any]:
    """Return the row of the worst sequence of a search, which starts from the worst known on either device."""
    rng = random.Random(seed)
    known = [sequence_of(row) for row in worst if (row["what"], tuple(row["range_n_m"])) == (what, range_n_m)]
    if (kind, what) == ("sim", "asked"):
        seconds /= 2.0
        known += grown(range_n_m, seconds, rng)
    evaluate = functools.partial(evaluated, kind, what)
    played, sequence = search(SEARCHES[what].move.drawn, evaluate, known, range_n_m, seconds, rng)
    moves = [[round(part, 6) if isinstance(part, float) else part for part in move] for move in sequence.moves]
    row = {"what": what, "device": kind, "range_n_m": range_n_m, "stiffness_n_m": sequence.stiffness_n_m}
    row |= {"played": played, "seed": sequence.seed, "moves": moves}
    return row | {"largest_n": evaluate(sequence_of(row))}


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the worst of each search in each range of stiffness."""
    arguments.repetitions = 1
    ranges_n_m = RANGES_N_M[::3] if arguments.quick else RANGES_N_M
    seconds = 3.0 if arguments.quick else arguments.seconds
    worst = read_worst()
    rows = []
    for what, range_n_m in itertools.product(SEARCHES, ranges_n_m):
        row = searched(arguments.device, what, range_n_m, worst, seconds, arguments.seed)
        rows.append(row)
        print(
            f"{what}, {row['stiffness_n_m']:.0f} N/m: {row['largest_n']:.2f} N, the worst of {row['played']} sequences",
            flush=True,
        )
        if arguments.keep:
            found = {(each["what"], each["device"], *each["range_n_m"]): each for each in [*worst, *rows]}
            lines = (json.dumps(found[key]) for key in sorted(found))
            WORST.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")
    return {"device": arguments.device, "limit_n": MAX_FORCE_N, "rows": rows}


def main() -> None:
    parser = record.options(__doc__, seed=0)
    parser.add_argument("--device", choices=("sim", "simavr"), default="sim")
    parser.add_argument("--seconds", type=record.within(1.0), default=15.0, help="length of each of the eight searches")
    parser.add_argument("--quick", action="store_true", help="three seconds for each, on two ranges of fingers")
    parser.add_argument("--keep", action="store_true", help=f"write the worst sequences to {WORST.name}")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
