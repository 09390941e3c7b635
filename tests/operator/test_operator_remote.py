"""A tool moved by datagrams of another program."""

import json

import msgpack
import numpy as np
import pytest

from hapticnet.errors import PeerError
from hapticnet.operator.remote import (
    APPROACH_M_S,
    HOLD_AFTER_US,
    WITHDRAW_AFTER_US,
    RemoteOperator,
    read_position,
    write_force,
)
from hapticnet.plain_datagrams import ARRAY, JSON_ARRAY, JSON_OBJECT, MAP, MOST_BYTES

HERE, THERE = ("127.0.0.1", 5000), ("::1", 6000, 0, 0)


@pytest.mark.parametrize(
    ("data", "form", "answer"),
    [
        (msgpack.packb([0.01]), ARRAY, msgpack.packb([2.0])),
        (msgpack.packb({"position_m": [0.01]}), MAP, {"force_n": [2.0], "position_m": [0.01], "t_us": 7}),
        (b'{"position_m": 0.01, "more": [null]}', JSON_OBJECT, {"force_n": [2.0], "position_m": [0.01], "t_us": 7}),
        (b"[1e-2]", JSON_ARRAY, b"[2.0]"),
    ],
)
def test_the_answer_has_the_form_of_the_question(data, form, answer):
    assert read_position(data, 1) == (form, (0.01,))
    assert read_position(msgpack.packb([0, -1, 0.5]), 3) == (ARRAY, (0.0, -1.0, 0.5))
    written = write_force(form, (2.0,), (0.01,), 7)
    if isinstance(answer, dict):
        written = msgpack.unpackb(written) if form is MAP else json.loads(written)
    assert written == answer


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "neither msgpack nor JSON"),
        (b"\xc1", "neither msgpack nor JSON"),
        (b"\x91" * 500, "neither msgpack nor JSON"),
        (b"\xff\xfe", "neither msgpack nor JSON"),
        (bytes(MOST_BYTES + 1), "a datagram of 513 bytes; a position has at most 512"),
        (b'{"x": 0.01}', r"position_m must be a list of 1 numbers, such as \[0.01\]"),
        (b'{"position_m": [true]}', "position_m must be a list of 1 numbers"),
        (b"[[0.01]]", "expected a list of 1 numbers"),
        (b"[1, 2]", r"2 coordinates; expected 1, such as \[0.01\]"),
        (b"[NaN]", "coordinate nan is not within ±10 m"),
        (b"[1" + b"0" * 400 + b"]", "coordinate 100000000000000000000000000000 is not within"),
        (b"[20.0]", r"coordinate 20.0 is not within ±10 m; coordinates are metres"),
        (msgpack.packb({1: 2}), "int is not allowed for map key"),
    ],
)
def test_anything_else_is_refused_with_a_reason(data, message):
    with pytest.raises(PeerError, match=message) as refused:
        read_position(data, 1)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 200


def test_random_datagrams_never_raise_out_of_the_operator():
    rng = np.random.default_rng(1)
    hand = RemoteOperator()
    good = [msgpack.packb([0.01]), b'{"position_m": [0.01]}', msgpack.packb({"position_m": [0.01]})]
    for number in range(3000):
        data = bytearray(good[number % 3])
        for _ in range(int(rng.integers(1, 4))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        hand.receive(bytes(data), HERE, number)
    assert hand.positions + hand.malformed == 3000
    assert hand.malformed > 1000
    assert sum(hand.next_line() is not None for _ in range(10)) <= 2


def play(hand, from_ms, to_ms, positions=lambda _: None, sender=HERE):
    """Run a hand for some milliseconds with a position (or None) for each; return where the tool was."""
    at = []
    for ms in range(from_ms, to_ms):
        x = positions(ms)
        if x is not None:
            hand.receive(msgpack.packb([x]), sender, 1000 * ms)
        at.append(hand.sample(1000 * ms).position_m[0])
    return np.array(at)


def test_the_tool_follows_each_position_once_it_has_reached_the_first():
    hand = RemoteOperator()
    at = play(hand, 0, 1000, lambda ms: 0.006 + 1e-6 * ms)
    assert np.abs(np.diff(at)).max() <= APPROACH_M_S * 1e-3 + 1e-9
    assert at[200:] == pytest.approx(0.006 + 1e-6 * np.arange(200, 1000), abs=1e-12)


def test_a_silent_sender_leaves_the_tool_there_and_then_it_is_withdrawn():
    hand = RemoteOperator()
    play(hand, 0, 500, lambda _: 0.02)
    at = play(hand, 500, 3000)
    moved = np.flatnonzero(at < 0.02)[0] + 500
    assert moved == pytest.approx(499 + WITHDRAW_AFTER_US / 1000, abs=2)
    assert np.abs(np.diff(at)).max() <= APPROACH_M_S * 1e-3 + 1e-9
    assert at[-1] == 0.0
    assert hand.report()["silences"] == 1
    lines = [hand.next_line(), hand.next_line()]
    assert lines == [
        "positions come from 127.0.0.1:5000, as msgpack array",
        "no positions for 1 s; the tool is withdrawn",
    ]


def test_a_tool_in_front_of_the_tissue_and_other_axes_are_not_moved_by_a_withdrawal():
    hand = RemoteOperator(axes=2)
    for ms in range(1000):
        hand.receive(b"[-0.01, 0.03]", HERE, 1000 * ms)
        hand.sample(1000 * ms)
    for ms in range(1000, 4000):
        at = hand.sample(1000 * ms).position_m
    assert at == (-0.01, 0.03)


def test_after_a_silence_the_tool_moves_to_the_sender_and_does_not_jump():
    hand = RemoteOperator()
    play(hand, 0, 500, lambda _: 0.02)
    assert play(hand, 500, 551, lambda ms: 0.018 if ms == 550 else None)[50] == 0.018, "a little apart is no silence"
    assert (play(hand, 551, 551 + HOLD_AFTER_US // 1000 + 100) == 0.018).all()
    at = play(hand, 900, 1900, lambda _: 0.01)
    assert np.abs(np.diff(at)).max() <= APPROACH_M_S * 1e-3 + 1e-9
    assert at[-1] == 0.01


def test_one_sender_at_a_time_moves_the_tool():
    hand = RemoteOperator()
    play(hand, 0, 500, lambda _: 0.02)
    for ms in range(500, 600):
        hand.receive(b"[0.0]", THERE, 1000 * ms)
        hand.receive(b"[0.02]", HERE, 1000 * ms)
        assert hand.sample(1000 * ms).position_m == (0.02,)
    assert hand.unknown_peers == 100
    play(hand, 600, 1700)
    play(hand, 1700, 1710, lambda _: 0.001, sender=THERE)
    assert hand.answer()[1] == THERE
    lines = [hand.next_line() for _ in range(4)]
    assert lines[1] == "[::1]:6000 sends positions too; it may once 127.0.0.1:5000 stops"
    assert lines[3] == "positions come from [::1]:6000, as msgpack array"


def test_each_position_is_answered_once_with_the_force_of_all_axes():
    hand = RemoteOperator(axes=3)
    assert hand.answer() is None
    hand.receive(b'{"position_m": [0, 0, 0]}', HERE, 0)
    hand.receive(b'{"position_m": [0, 0, 0.00003]}', HERE, 10)
    hand.sample(1000)
    hand.feel(1000, (1.0, 2.0, 3.0))
    data, sender = hand.answer()
    assert json.loads(data) == {"force_n": [1.0, 2.0, 3.0], "position_m": [0.0, 0.0, 3e-5], "t_us": 1000}
    assert (sender, hand.answer()) == (HERE, None)
    assert hand.report() == {"positions": 2, "malformed": 0, "unknown_peers": 0, "silences": 0, "answers": 1}
