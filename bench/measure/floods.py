"""Floods of requests from forged sources: round trips of a running session, and the time that a newcomer needs to join.

The flood comes from addresses of 127/8 that answer nothing, so no request proves its address. Windows with and without
it take turns in one session, with the same processes and scheduling; ratios are between neighbours.
"""

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import record
from flood_roles import MASTER_KEY, SLAVE_KEY
from real_time import fifo_is_granted

from hapticnet.protocol.handshake import MAC_BYTES, hello_mac, prologue
from hapticnet.protocol.messages import COOKIE_BYTES, Hello, Request, pack_hello
from hapticnet.protocol.noise import MESSAGE_1_BYTES, Initiator
from hapticnet.protocol.wire import OPEN, SEALED, pack_body

ROLES: Final = Path(__file__).parent / "flood_roles.py"
PEERS: Final = Path(__file__).parents[1] / "peers"
DATAGRAMS: Final = 2_000
"""Different datagrams of a flood, sent in turns."""

RATES_PER_S: Final = (1_000, 10_000)
QUICK: Final = (("open, no cookie", 1_000), ("sealed, true code, no cookie", 10_000))
REQUEST: Final = pack_body(Request("level-crossing", {"hysteresis": 0.0}, 0.0, 0.01, 1.0, 1000.0, 1, "flood"))
NEWCOMERS_S: Final = 3.0
QUICK_NEWCOMERS_S: Final = 0.5

Make = Callable[[np.random.Generator], bytes]


def open_hello(rng: np.random.Generator, cookie: bytes = b"") -> bytes:
    return pack_hello(Hello(number(rng), cookie, REQUEST), 0, OPEN)


def sealed_hello(rng: np.random.Generator, *, cookie: bytes = b"", true_mac: bool = True) -> bytes:
    """Return a HELLO with noise where the key exchange would be."""
    nonce, noise1 = number(rng), rng.bytes(MESSAGE_1_BYTES + len(REQUEST))
    mac = hello_mac(SLAVE_KEY.public, nonce, 0, noise1) if true_mac else rng.bytes(MAC_BYTES)
    return pack_hello(Hello(nonce, cookie, noise1, mac), 0, SEALED)


def copied_hello(rng: np.random.Generator) -> bytes:
    """Return a HELLO as a true master sends it first."""
    nonce = number(rng)
    initiator = Initiator(MASTER_KEY.private, SLAVE_KEY.public, MASTER_KEY.psk, prologue(nonce, 0), Numbers(rng))
    noise1 = initiator.write(REQUEST)
    return pack_hello(Hello(nonce, b"", noise1, hello_mac(SLAVE_KEY.public, nonce, 0, noise1)), 0, SEALED)


class Numbers:
    """A generator as a source of keys."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def integers(self, low: int, high: int, /) -> int:
        return int(self._rng.integers(low, high))


def number(rng: np.random.Generator) -> int:
    return int(rng.integers(0, 1 << 32))


FLOODS: Final[dict[str, tuple[bool, Make]]] = {
    "open, no cookie": (False, open_hello),
    "open, random cookies": (False, lambda rng: open_hello(rng, rng.bytes(COOKIE_BYTES))),
    "sealed, wrong code": (True, lambda rng: sealed_hello(rng, true_mac=False)),
    "sealed, true code, no cookie": (True, sealed_hello),
    "sealed, true code, random cookies": (True, lambda rng: sealed_hello(rng, cookie=rng.bytes(COOKIE_BYTES))),
    "sealed, copied requests": (True, copied_hello),
}
"""Kinds of floods: whether the slave serves sealed sessions, and the datagrams."""


@contextmanager
def role(*arguments: object) -> Iterator["subprocess.Popen[str]"]:
    """Run one of the roles, and end it."""
    command = [sys.executable, str(ROLES), *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(PEERS.parents[1])}
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, bufsize=1
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def line(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def round_trips(worker: "subprocess.Popen[str]", seconds: float) -> dict[str, float]:
    """Return the round trips of a window."""
    assert worker.stdin is not None
    for wait_s in (0.0, seconds):  # the first mark only starts the window
        time.sleep(wait_s)
        worker.stdin.write("mark\n")
        answer: dict[str, float] = json.loads(line(worker))
    return answer


class Flood:
    """Send the datagrams of a kind, at a rate, while in the context."""

    def __init__(self, program: Path, port: int, datagrams: bytes, per_s: int) -> None:
        self._command = [str(program), "127.0.0.1", str(port), str(per_s), "3600", "127"]
        self._datagrams = datagrams

    def __enter__(self) -> None:
        self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(self._datagrams)
        self._process.stdin.close()
        self._process.stdout.readline()

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()


def flooded(kind: str, per_s: int, program: Path, arguments: argparse.Namespace, *, fifo: bool) -> dict[str, Any]:
    """Measure one kind of flood at one rate."""
    sealed, make = FLOODS[kind]
    rng = np.random.default_rng(arguments.seed)
    made = [make(rng) for _ in range(DATAGRAMS)]
    datagrams = b"".join(len(data).to_bytes(2, "big") + data for data in made)
    flags = [*(["--sealed"] if sealed else []), *(["--real-time"] if fifo else [])]
    quiet, loud = [], []
    come_s = QUICK_NEWCOMERS_S if arguments.quick else NEWCOMERS_S
    with role("slave", *flags) as slave:
        port = int(line(slave))
        with role("work", port, *flags) as worker:
            round_trips(worker, 1.0)
            for _ in range(arguments.repetitions):
                quiet.append(round_trips(worker, arguments.seconds))
                with Flood(program, port, datagrams, per_s):
                    loud.append(round_trips(worker, arguments.seconds))
        with Flood(program, port, datagrams, per_s), role("come", port, come_s, *flags) as comer:
            assert comer.stdout is not None
            newcomers = [json.loads(each) for each in comer.stdout]
    came = [took_s for took_s in newcomers if took_s is not None]
    return {
        "kind": kind,
        "per_s": per_s,
        "sealed": sealed,
        **{f"quiet_{name}_us": statistics.median(each[name] for each in quiet) for name in ("p50", "p99")},
        **{f"flooded_{name}_us": statistics.median(each[name] for each in loud) for name in ("p50", "p99")},
        "p50_ratio": ratio("p50", quiet, loud),
        "p99_ratio": ratio("p99", quiet, loud),
        "connections": loud[-1]["connections"],
        "newcomers": len(newcomers),
        "newcomers_shut_out": len(newcomers) - len(came),
        "newcomer_s_median": statistics.median(came) if came else None,
        "newcomer_s_worst": max(came, default=None),
    }


def ratio(name: str, quiet: list[dict[str, float]], loud: list[dict[str, float]]) -> float:
    """Return the median ratio of neighbouring windows."""
    return statistics.median(one[name] / other[name] for one, other in zip(loud, quiet, strict=True))


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all results."""
    fifo = not arguments.no_real_time and fifo_is_granted()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "flood"
        subprocess.run(["gcc", "-O2", "-o", program, PEERS / "flood.c"], check=True)
        for kind, per_s in QUICK if arguments.quick else itertools.product(FLOODS, RATES_PER_S):
            rows.append(flooded(kind, per_s, program, arguments, fifo=fifo))
    return {"scheduling": "SCHED_FIFO" if fifo else "SCHED_OTHER", "rows": rows}


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seconds", type=record.within(0.1), default=4.0, help="length of each window")
    parser.add_argument("--repetitions", type=record.within(1), default=5)
    parser.add_argument("--quick", action="store_true", help="two floods only, and fewer newcomers")
    parser.add_argument("--no-real-time", action="store_true", help="leave everything in SCHED_OTHER")
    record.run(parser, measure, unit="as in each name")


if __name__ == "__main__":
    main()
