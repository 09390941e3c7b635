"""A scene in another program, asked by datagrams, in virtual time."""

import json
import re

import msgpack
import numpy as np
import pytest

from hapticnet.errors import SettingsError
from hapticnet.samples import PositionSample
from hapticnet.scene.remote import (
    DECAY_US,
    LINES_EVERY_US,
    MOST_UNANSWERED,
    RISE_US,
    RemoteScene,
    RemoteSettings,
    parse_remote,
)

DEADLINE_US = 20_000


class Played:
    """A remote scene, and a program that answers after `delay_us` with the number of newtons that `t_us` has ms."""

    def __init__(self, delay_us=300, echoes=True, period_us=1000):
        self.scene = RemoteScene(RemoteSettings(), "there:1")
        self.delay_us, self.echoes, self.period_us, self.now_us = delay_us, echoes, period_us, 1_000_000
        self.answers_at = []

    def step(self):
        """Step once; return the force."""
        self.now_us += self.period_us
        while self.answers_at and self.answers_at[0][0] <= self.now_us:
            self.scene.receive(self.answers_at.pop(0)[1], self.now_us)
        asked = json.loads(self.scene.ask(PositionSample(self.now_us, (0.01,)), self.now_us))
        if self.delay_us is not None:
            more = {"t_us": asked["t_us"]} if self.echoes else {}
            answer = json.dumps({"force_n": [asked["t_us"] / 1e6], **more}).encode()
            self.answers_at.append((self.now_us + self.delay_us, answer))
        (force_n,) = self.scene.force_n(self.now_us)
        return force_n

    def steps(self, count):
        return [self.step() for _ in range(count)]

    def lines(self):
        return list(iter(self.scene.next_line, None))


def test_the_newest_answer_is_the_force_one_step_later():
    link = Played()
    forces_n = link.steps(5)
    assert forces_n == [0.0, 1.001, 1.002, 1.003, 1.004]
    assert link.scene.report() == {"asked": 5, "answers": 4, "late": 0, "malformed": 0, "lapses": 0, "decayed": 0}
    assert link.lines() == []


def test_without_an_answer_within_the_deadline_the_force_decays_to_zero_and_one_line_says_so():
    link = Played()
    (*_, whole_n) = link.steps(10)
    link.delay_us = None
    forces_n = link.steps(60)
    late = [n for n, each in enumerate(forces_n) if each < whole_n]
    # The first position without an answer was asked in step 0, so its deadline is over after step 20.
    assert (late[0], forces_n[DEADLINE_US // 1000]) == (21, pytest.approx(whole_n, rel=0.01))
    assert np.all(np.diff(forces_n[20:41]) < 0.0)
    assert forces_n[(DEADLINE_US + DECAY_US) // 1000 :] == [0.0] * 20
    assert link.lines() == ["the scene at there:1 does not answer within 20 ms; the force decays to zero"]
    assert (link.scene.lapses, link.scene.decayed) == (1, 39)


def test_a_program_that_comes_back_lets_the_force_rise_without_a_jump():
    link = Played()
    link.steps(10)
    link.delay_us = None
    link.steps(100)
    link.lines()
    link.delay_us = 300
    forces_n = np.array(link.steps(150))
    assert forces_n.max() > 1.2
    assert np.abs(np.diff(forces_n)).max() < 1.3 * link.period_us / RISE_US + 0.001
    assert link.lines() == ["the scene at there:1 answers again"]


@pytest.mark.parametrize("echoes", [True, False])
def test_answers_that_are_always_late_are_withheld_if_they_say_what_they_answer(echoes):
    link = Played(delay_us=DEADLINE_US + DECAY_US + 5_000, echoes=echoes)
    link.steps(200)  # of which the first have no answer yet, and let the force rise
    before = link.scene.decayed
    forces_n = link.steps(100)
    assert (max(forces_n) == 0.0) is echoes
    assert link.scene.decayed - before == (100 if echoes else 0)


def test_few_positions_a_second_do_not_make_answers_late():
    link = Played(period_us=200_000)
    assert min(link.steps(20)[1:]) > 1.0
    assert link.scene.lapses == 0


def test_an_older_answer_that_overtakes_is_counted_and_not_used():
    scene = RemoteScene(RemoteSettings(axes=2, form="msgpack"), "there:1")
    for t_us in (1000, 2000):
        asked = msgpack.unpackb(scene.ask(PositionSample(t_us, (0.01, 0.02)), t_us))
        assert asked == {"position_m": [0.01, 0.02], "t_us": t_us}
    scene.receive(msgpack.packb({"force_n": [2.0, 1.0], "t_us": 2000}), 2100)
    scene.receive(json.dumps({"force_n": [9.0, 9.0], "t_us": 1000}).encode(), 2200)
    assert scene.force_n(2300) == (2.0, 1.0)
    assert (scene.answers, scene.late) == (2, 1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"garbage", "neither msgpack nor JSON"),
        (b"[NaN]", r"component nan is not within ±1e\+06 N"),
        (b'{"force_n": [1.0, 2.0]}', r"2 components; expected 1, such as \[1.5\]"),
        (b'{"force": 1.0}', r"force_n must be a list of 1 numbers, such as \[1.5\]"),
        (b'{"force_n": 1.0, "t_us": 5000}', "t_us is 5000; it must be that of a position, or left out"),
        (b'{"force_n": 1.0, "t_us": "now"}', "t_us is now; it must be"),
        (bytes(600), "a datagram of 600 bytes; a force has at most 512"),
    ],
)
def test_what_is_not_an_answer_is_counted_and_changes_nothing(data, message):
    scene = RemoteScene(RemoteSettings(), "there:1")
    scene.receive(b"[5.0]", 0)  # before any question
    scene.ask(PositionSample(1000, (0.0,)), 1000)
    scene.receive(b"[1.0]", 1100)
    later_us = LINES_EVERY_US
    for now_us in (later_us, 100 + later_us, 2 * later_us):
        scene.receive(data, now_us)
    assert scene.force_n(2 * later_us) == (1.0,)
    assert scene.malformed == 4
    first, second, again = iter(scene.next_line, None)
    assert first.startswith("the scene at there:1 sent what is not a force: t_us is None")
    assert second == again
    assert re.search(message, second)


def test_a_flood_of_different_garbage_makes_one_line():
    scene = RemoteScene(RemoteSettings(), "there:1")
    for number in range(1000):
        scene.receive(f"[{2_000_000 + number}]".encode(), 1000 * number)
    assert scene.malformed == 1000
    assert len(list(iter(scene.next_line, None))) == len(scene._told_us) == 1


def test_random_datagrams_never_raise_and_memory_is_bounded():
    rng = np.random.default_rng(1)
    scene, silent = RemoteScene(RemoteSettings(), "there:1"), RemoteScene(RemoteSettings(), "there:1")
    good = [msgpack.packb([1.0]), b'{"force_n": [1.0], "t_us": 1}', msgpack.packb({"force_n": [1.0]})]
    for number in range(MOST_UNANSWERED + 1000):
        for each in (scene, silent):
            each.ask(PositionSample(number, (0.0,)), number)
        data = bytearray(good[number % 3])
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
        scene.receive(bytes(data), number)
        assert np.isfinite(scene.force_n(number)[0])
    assert scene.malformed > 1000
    assert len(silent._unanswered) == MOST_UNANSWERED


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("udp:1,deadlin=1", r"has no 'deadlin' \(did you mean 'deadline'\?\); there are: axes, deadline, form"),
        ("udp:1,axes", "'axes' must be KEY=VALUE"),
        ("udp:1,axes=two", "axes and deadline must be numbers"),
        ("udp:1,axes=99", "axes of the scene is 99; it must be between 1 and"),
        ("udp:1,deadline=0", "deadline of the scene is 0.0 s; it must be between 0.001 and 10 s"),
        ("udp:1,form=jsn", r"form of the scene is 'jsn' \(did you mean 'json'\?\)"),
    ],
)
def test_invalid_options_are_refused_in_one_line(text, message):
    with pytest.raises(SettingsError, match=message):
        parse_remote(text)


def test_options_are_read():
    given = RemoteSettings(axes=3, deadline_s=0.05, form="msgpack")
    assert parse_remote("udp:far:1,axes=3,deadline=0.05,form=msgpack") == ("far:1", given)
    assert parse_remote("udp:47901") == ("127.0.0.1:47901", RemoteSettings())
