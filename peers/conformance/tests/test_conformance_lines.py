"""An adapter answers each line, whatever it holds, and goes on."""

import random

import msgpack

from conformance import golden
from conformance.child import write_floats

WRONG = [
    "", "nonsense", "tick", "tick x 0", "tick 0", "tick 0 00", "tick 0 zz", "force", "force one", "receive 0",
    "receive 0 0", "receive 0 xyz", "random", "random 0", "master codec", "master axes=9", "close",
    "slave axes=x scene=-", "seal", "seal 00 00 -", "answer 0", "features\tx",
    "state of things", "é",
]  # fmt: skip


def test_a_wrong_line_is_an_error_and_changes_nothing(child):
    lines = [line.command for line in golden.opening()]
    child.batch([*lines, f"tick 1000 {write_floats([0.02])}", "send"])
    before = child.batch(["state", "counts", "force 1000"])
    for line in WRONG:
        (answer,) = child.batch([line])
        assert answer.startswith(("ok", "error ")), line
        assert answer.startswith("error ") or line in ("random", "features\tx", "state of things"), line
    assert child.batch(["state", "counts", "force 1000"]) == before


def test_random_lines_are_answered(child):
    chance = random.Random(1)
    words = ["features", "state", "0", "-", "ff", "axes=1", *(word for line in WRONG for word in line.split())]
    lines = [" ".join(chance.choices(words, k=chance.randint(1, 6))) for _ in range(2000)]
    answers = child.batch(lines)
    assert {answer.split(" ")[0] for answer in answers} <= {"ok", "error"}
    assert child.ask("features")


def test_lines_that_are_not_waited_for_are_answered_in_their_order(child):
    lines = [line.command for line in golden.opening()]
    ticks = [f"tick {1000 * i} {write_floats([0.01])}" for i in range(1, 500)]
    answers = child.batch([*lines, *(line for tick in ticks for line in (tick, "send", "state"))])
    assert answers[len(lines) + 2 :: 3] == ["ok established"] * 200 + ["ok stale"] * 299
    sent = [answer for answer in answers[len(lines) + 1 :: 3] if answer != "ok"]
    numbers = [msgpack.unpackb(bytes.fromhex(answer[3:]))[3] for answer in sent]
    assert numbers == list(range(1, len(sent) + 1))
