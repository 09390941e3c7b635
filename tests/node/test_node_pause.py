"""With on_error="pause", an exception of the operator or the scene stops the force, not the session."""

import numpy as np
import pytest

from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.node.events import Paused, ScenePaused
from hapticnet.samples import ForceSample, PositionSample
from tests.conftest import linked

SECOND = 1_000_000


class Spring:
    """A scene that can be broken and mended."""

    name = "spring"

    def __init__(self, axes=1):
        self.axes, self.broken, self.calls = axes, False, 0

    def step(self, sample):
        self.calls += 1
        if self.broken:
            raise OSError("the arm does not answer")
        return ForceSample(sample.t_us, tuple(200.0 * each for each in sample.position_m))


class Hand:
    """An operator that can be broken and mended, and feels."""

    duration_us = None

    def __init__(self, *at_m):
        self.at_m, self.axes, self.broken, self.calls, self.felt = at_m, len(at_m), False, 0, []

    def feel(self, t_us, force_n):
        self.felt.append((t_us, force_n))

    def sample(self, t_us):
        self.calls += 1
        if self.broken:
            raise RuntimeError("no hand")
        return PositionSample(t_us, self.at_m)


def pausing(hand, scene, device=None, **settings):
    return linked(hand, lambda _: scene, device=device, slave={"on_error": "pause"}, on_error="pause", **settings)


def events(node, kind):
    return [event for event in iter(node.next_event, None) if isinstance(event, kind)]


def test_an_operator_that_raises_is_not_asked_again_until_it_is_resumed():
    hand = Hand(0.01)
    link = pausing(hand, Spring())
    link.run(SECOND)
    assert link.master.held_n == (2.0,)
    hand.broken = True
    link.run(SECOND)
    (paused,) = events(link.master, Paused)
    assert paused.reason.startswith("the operator failed: RuntimeError: no hand")
    assert (link.master.paused, link.master.held_n) == (paused.reason, (0.0,))
    assert link.master.session.streaming, "the session goes on"
    hand.broken, calls = False, hand.calls
    link.run(SECOND)
    assert hand.calls == calls
    link.master.resume()
    held_n = []
    for _ in range(300):
        link.run(1000)
        held_n.append(link.master.held_n[0])
    assert held_n[-1] == 2.0
    assert max(np.diff([0.0, *held_n])) < 0.15, "the force rises at the slew limit"
    assert len(link.slave.contexts) == 1


def test_a_scene_that_raises_gives_no_force_until_it_is_resumed():
    scene = Spring()
    link = pausing(Hand(0.01), scene)
    link.run(SECOND)
    scene.broken = True
    link.run(SECOND)
    (paused,) = events(link.slave, ScenePaused)
    assert "OSError: the arm does not answer" in paused.reason
    assert link.master.held_n == (0.0,)
    scene.broken, calls = False, scene.calls
    link.run(SECOND)
    assert scene.calls == calls
    link.slave.resume()
    link.run(SECOND)
    assert link.master.held_n == (2.0,)


def test_every_axis_is_felt_held_and_recorded():
    hand = Hand(0.01, 0.0, -0.005)
    link = pausing(hand, Spring(3), record=True, record_datagrams=True)
    link.run(SECOND)
    assert link.master.held_n == (2.0, 0.0, -1.0)
    assert hand.felt[-1][1] == (2.0, 0.0, -1.0)
    assert len(hand.felt) == hand.calls
    master, slave = link.master.recording.table(), link.slave.contexts[0].recording.table()
    assert (master["held_z_n"][-1], master["position_z_m"][-1]) == (-1.0, -0.005)
    assert (slave["force_z_n"][-1], slave["held_x_n"][-1]) == pytest.approx((-1.0, 2.0), rel=1e-6)
    datagrams = link.master.datagrams.table()
    sent = link.master.session.sent
    assert datagrams["datagram_bytes"][datagrams["direction"] == 1].sum() == sent.report()["payload_bytes"]


def test_both_sides_record_the_same_times_however_long_the_masters_host_has_been_up():
    hand = Hand(0.01)
    link = pausing(hand, Spring(), record=True)
    link.now_us = link._next_tick_us = 5 * (1 << 32) + 12_345
    link.run(SECOND)
    master, slave = link.master.recording.table(), link.slave.contexts[0].recording.table()
    assert slave["t_us"][0] > 5 * (1 << 32)
    assert set(slave["t_us"]) <= set(master["t_us"])


@pytest.mark.parametrize(("takes", "target_n"), [("x", 1.2), ("z", 0.5), ("norm", 1.3)])
def test_a_device_renders_the_axis_that_it_is_declared_to_take(takes, target_n):
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(1))
    link = pausing(Hand(0.006, 0.0, 0.0025), Spring(3), device, device_takes=takes)
    link.run(SECOND)
    assert link.master.target_n == pytest.approx(target_n)
