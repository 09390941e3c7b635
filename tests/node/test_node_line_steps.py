"""Steps between positions that are few: bounded for each identity and in all, however few datagrams ask for them."""

import numpy as np
import pytest

from hapticnet.codec.positions import PromisedLine, pack_line
from hapticnet.node.admission import ALL_HZ, EACH_HZ, MOST_AT_ONCE
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.messages import Close
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import Kind
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene
from tests.peers import HandMaster

SECOND = 1_000_000
PRESSING_M = 0.025


class Hall:
    """A slave, and masters that send a line each 100 ms, those of a host one after another."""

    def __init__(self, **session):
        self.slave = SlaveNode(
            lambda _: Scene(paper_scene(1).tissues), SlaveSettings(session=SessionSettings(**session)),
            np.random.default_rng(1), host_of=lambda address: address[0],
        )  # fmt: skip
        self.masters = []
        self.now_us = SECOND
        self.positions = 0
        self.most_at_once = 0

    def join(self, host, count=1, **request):
        """Let masters of a host join; return them."""
        joined = []
        for _ in range(count):
            self.now_us += SECOND // 4  # as often as requests of a host are read
            number = len(self.masters)
            master = HandMaster(
                self.slave, (host, number), nonce=1 + number, position_share=0.25, name=f"{host} {number}",
                **({"rate_hz": 10_000.0} | request),
            ).join(self.now_us)  # fmt: skip
            assert master.grant.position_share == 0.25
            self.masters.append(master)
            joined.append(master)
        return joined

    def play(self, seconds, masters=None):
        """Let masters send their lines, all at once each time; return the steps between positions of each session."""
        masters = self.masters if masters is None else masters
        before = self.between()
        for _ in range(round(10 * seconds)):
            for master in masters:
                self.positions += 1
                line = pack_line(PromisedLine(0, (PRESSING_M,), (0.001,)))
                master.say(Kind.POSITION, self.positions, (self.now_us, 1, line), self.now_us)
            end_us = self.now_us + SECOND // 10
            while (next_us := self.slave.next_timer_us()) is not None and next_us < end_us:
                self.now_us = max(self.now_us + 1, next_us)
                steps = self.slave.totals()[0]
                self.slave.tick(self.now_us)
                self.most_at_once = max(self.most_at_once, self.slave.totals()[0] - steps)
                self.slave.account_sent(self.now_us)
                self.slave.datagrams_to_send()
            self.now_us = end_us
        after = self.between()
        return [after[each] - before.get(each, 0) for each in after]

    def between(self):
        return {each["session"]: each["between"] for each in self.slave.report()["sessions"]}


@pytest.mark.parametrize("rate_hz", [1000.0, 4000.0])
def test_a_usual_session_is_stepped_at_each_of_its_times(rate_hz):
    hall = Hall()
    hall.join("good", rate_hz=rate_hz)
    hall.play(0.3)
    (steps,) = hall.play(2.0)
    assert steps == pytest.approx(2.0 * rate_hz, rel=0.02)


@pytest.mark.parametrize("codec", ["deadband", "linear-predictive"])
def test_ten_datagrams_a_second_do_not_buy_ten_thousand_steps(codec):
    hall = Hall()
    hall.join("bad", codec=codec)
    hall.play(0.3)
    (steps,) = hall.play(2.0)
    assert 0.0 < steps <= 2.0 * EACH_HZ


def test_an_identity_gets_so_many_steps_with_as_many_sessions_as_it_may_have():
    hall = Hall()
    hall.join("bad", 16)
    hall.play(0.3)
    steps = hall.play(1.0)
    assert 0.5 * EACH_HZ < sum(steps) <= EACH_HZ
    assert min(steps) > 0.9 * max(steps), "all are served alike"


def test_all_together_get_so_many_and_who_asks_for_little_is_served_beside_them():
    hall = Hall()
    hall.join("good", rate_hz=1000.0)
    for host in ("bad", "worse"):
        hall.join(host, 16)
    hall.play(0.3)
    good, *others = hall.play(1.0)
    assert good == pytest.approx(1000, abs=20)
    assert sum(others) <= 2 * EACH_HZ
    hall.join("worst", 16)
    hall.play(0.3)
    good, *others = hall.play(1.0)
    assert good + sum(others) <= ALL_HZ
    assert good > 400
    assert hall.most_at_once <= MOST_AT_ONCE


def test_what_sessions_do_not_use_any_more_is_there_for_others():
    hall = Hall()
    first, *others = hall.join("lab", 8, rate_hz=1000.0)
    hall.play(0.3)
    assert hall.play(1.0)[0] == pytest.approx(500, abs=20)
    hall.play(0.3, [first])  # the others are silent
    assert hall.play(1.0, [first])[0] == pytest.approx(1000, abs=20)
    assert len(others) == 7
    hall.play(0.3)
    assert hall.play(1.0)[0] == pytest.approx(500, abs=20), "they are back"
    for master in others:
        master.say(Kind.CLOSE, hall.positions + 1, Close("done"), hall.now_us)
    assert hall.slave.session_count == 1
    hall.play(0.3, [first])
    assert hall.play(1.0, [first])[-1] == pytest.approx(1000, abs=20)
