"""Code whose steps take longer than its rate leaves is named, once, where it runs and at the masters it serves."""

import sys
from functools import partial

import numpy as np
import pytest

from hapticnet.device.user import UserActuator
from hapticnet.node.hand_predictor import ForceAhead
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.node.step_times import StepsTooSlow, StepTimes
from hapticnet.protocol.messages import Code
from hapticnet.protocol.states import Noticed
from hapticnet.samples import ForceSample, PositionSample

MS = 1000
SECOND = 1000 * MS


class Clock:
    """Virtual time, which passes while a step runs."""

    def __init__(self):
        self.now_us = 10 * SECOND

    def __call__(self):
        return self.now_us


class Spring:
    name, axes, what = "spring", 1, "scene own.py:Spring"

    def __init__(self, clock, takes_us):
        self.clock, self.takes_us, self.calls = clock, takes_us, 0

    def step(self, sample):
        self.calls += 1
        self.clock.now_us += self.takes_us(self.calls) if callable(self.takes_us) else self.takes_us
        return ForceSample(sample.t_us, (200.0 * sample.position_m[0],))


class Hand:
    axes, duration_us, what = 1, None, "operator own.py:Hand"

    def __init__(self, clock, takes_us=0):
        self.clock, self.takes_us = clock, takes_us

    def sample(self, t_us):
        self.clock.now_us += self.takes_us
        return PositionSample(t_us, (0.01,))


def play(takes_us, seconds, *, make=SlaveNode, others=None, loses=lambda _: False):
    """Run a slave that reads its socket when it has time, and a master on another machine; return both."""
    clock = Clock()
    rng = np.random.default_rng(1)
    slave = make(lambda _: Spring(clock, takes_us), SlaveSettings(), rng, clock=clock, **(others or {}))
    master = MasterNode(Hand(Clock()), None, MasterSettings(), rng)
    queue, due_us = [], 0
    start_us = now_us = clock.now_us
    while now_us < start_us + seconds * SECOND:
        master.tick(now_us)
        queue += [(data, ("h", 1)) for data in master.datagrams_to_send()]
        if clock.now_us <= now_us:
            clock.now_us = now_us
            slave.receive_datagrams(queue, now_us)
            queue = []
            slave.account_sent(now_us)
            if now_us >= due_us:
                due_us = now_us + SECOND // 2
                slave.check(now_us)
            for data, _ in slave.datagrams_to_send():
                if not loses(data[2]):
                    master.receive_datagram(data, now_us)
        now_us += MS
    return slave, master


def events(node, kind):
    return [event for event in iter(node.next_event, None) if isinstance(event, kind)]


def test_a_slow_scene_is_named_once_with_what_it_leaves_unanswered():
    slave, _ = play(20 * MS, 8)
    (told,) = events(slave, StepsTooSlow)
    assert told.what == "scene own.py:Spring"
    assert told.mean_us == 20 * MS
    assert told.unanswered > 0.9 * told.positions > 800
    assert str(told).startswith("scene own.py:Spring is too slow: a step takes 20 ms, at most 20 ms, and is due every")
    times = slave.report()["step_times"]["scene own.py:Spring"]
    assert (times["max_us"], times["too_slow"]) == (20 * MS, True)


@pytest.mark.plain
def test_a_slow_copy_of_a_scene_is_named(monkeypatch):
    def copy(self):
        self.clock.now_us += 1300

    monkeypatch.setattr(Spring, "copy", copy, raising=False)
    monkeypatch.setattr(ForceAhead, "answer", lambda self, *_: self._copy())
    monkeypatch.setattr(sys.modules[__name__], "MasterSettings", partial(MasterSettings, predicted=True))
    slave, _ = play(50, 5)
    assert [each.what for each in slave.times.reported] == ["the copy of scene own.py:Spring"]


def test_its_master_is_told_and_goes_on():
    slave, master = play(20 * MS, 8)
    (noticed,) = events(master, Noticed)
    assert noticed.code is Code.SLOW
    assert noticed.reason == str(slave.times.reported[0])
    assert master.report()["notices"] == [noticed.reason]
    assert master.session.streaming
    assert master.session.received.lost == 0


def test_a_master_is_told_although_the_first_notices_are_lost():
    lost = []

    def loses(kind):
        lost.append(kind == 10 and lost.count(True) < 2)
        return lost[-1]

    _, master = play(20 * MS, 10, loses=loses)
    assert lost.count(True) == 2
    assert len(master.report()["notices"]) == 1


@pytest.mark.parametrize(
    "takes_us",
    [
        200,
        lambda call: 500 * MS if call == 1 else 200,  # as a class that loads something at its first step
    ],
)
def test_a_scene_that_keeps_up_is_not_named(takes_us):
    slave, master = play(takes_us, 8)
    assert slave.times.reported == []
    assert master.report()["notices"] == []


def test_a_scene_that_is_slow_now_and_then_is_named():
    slave, _ = play(lambda call: 30 * MS if call % 300 == 0 else 300, 8)
    (told,) = slave.times.reported
    assert told.longest_us == 30 * MS


@pytest.mark.parametrize(("lost", "named"), [(0, True), (1000, False)])
def test_steps_that_a_busy_machine_interrupts_are_not_blamed(lost, named):
    """Of a second, steps and other processes take as long; a step that was interrupted seems to take 30 ms."""
    times, waited_us = StepTimes(clock := Clock()), 0
    for number in range(4000):
        clock.now_us += MS
        time = times.of("scene a")
        time.begin()
        interruption_us = 30 * MS if number % 50 == 0 else 0
        clock.now_us += 20 + interruption_us
        time.end(MS)
        waited_us += interruption_us * lost // 1000
        times.check(clock.now_us, lambda waited_us=waited_us: waited_us)
    assert bool(times.reported) is named


def test_scenes_that_keep_up_alone_and_not_together_are_named():
    times, news = StepTimes(clock := Clock()), []
    for _ in range(4000):
        for what, takes_us in (("scene a", 300), ("scene b", 600)):
            times.of(what).begin()
            clock.now_us += takes_us
            times.of(what).end(MS)
        news += times.check(clock.now_us) or []
    assert [each.what for each in news] == ["scene b"]
    assert times.explains_delay


class Motor:
    def __init__(self, clock, takes_us):
        self.clock, self.takes_us = clock, takes_us

    def apply(self, _force_n, _now_us):
        self.clock.now_us += self.takes_us


@pytest.mark.parametrize("slow", ["operator own.py:Hand", "device own.py:Motor"])
def test_the_master_names_its_own_slow_code(slow):
    clock, rng = Clock(), np.random.default_rng(1)
    slave = SlaveNode(lambda _: Spring(Clock(), 0), SlaveSettings(), rng)
    hand, motor = (3 * MS, 10) if "Hand" in slow else (10, 3 * MS)
    device = UserActuator(Motor(clock, motor), "device own.py:Motor")
    master = MasterNode(Hand(clock, hand), device, MasterSettings(), rng, clock)
    for _ in range(2000):
        master.tick(clock.now_us)
        for data in master.datagrams_to_send():
            slave.receive_datagram(data, "h", clock.now_us)
        for data, _ in slave.datagrams_to_send():
            master.receive_datagram(data, clock.now_us)
        master.drive(clock.now_us)
        master.check(clock.now_us)
        clock.now_us += MS
    assert [(told.what, told.mean_us) for told in events(master, StepsTooSlow)] == [(slow, 3 * MS)]
    assert slave.times.report() == {}
    assert master.report()["step_times"][slow]["too_slow"]


def test_a_notice_does_not_stand_for_an_answer():
    """A slave that tells something must not put off the keepalive that shows the master that its positions arrive."""
    clock, rng = Clock(), np.random.default_rng(1)
    slave = SlaveNode(lambda _: Spring(clock, 0), SlaveSettings(), rng)
    master = MasterNode(Hand(clock), None, MasterSettings(), rng)
    answered_us = []
    for _ in range(1000):
        clock.now_us += MS
        master.tick(clock.now_us)
        for data in master.datagrams_to_send():
            slave.receive_datagram(data, "h", clock.now_us)
        for context in slave.contexts:
            slave._notify(context, "each millisecond", Code.SLOW, clock.now_us)
        for data, _ in slave.datagrams_to_send():
            if data[2] in (5, 6):
                answered_us.append(clock.now_us)
            master.receive_datagram(data, clock.now_us)
    assert max(np.diff(answered_us)) <= 50 * MS
