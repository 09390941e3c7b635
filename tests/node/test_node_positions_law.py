"""One JND over both directions, for hands and scenes that find the gaps: vibration, viscous layers, lines that end."""

import math

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.vectors import single

TICK_US = 1_000


class Vibrating:
    """A hand that vibrates with 2 mm at 150 Hz, around a place that wanders by 10 mm."""

    axes = 1

    def __init__(self, centre_m):
        self._centre_m = centre_m

    def sample(self, t_us):
        t_s = 1e-6 * t_us
        wander_m = 0.01 * math.sin(2.0 * math.pi * 0.7 * t_s)
        return PositionSample(t_us, (self._centre_m + wander_m + 0.002 * math.sin(2.0 * math.pi * 150.0 * t_s),))


class Wandering:
    """A hand that is pushed about at random, and drawn to a place."""

    axes = 1

    def __init__(self, centre_m):
        self._centre_m, self._rng = centre_m, np.random.default_rng(1)
        self._x_m, self._v_m_per_s = centre_m - 0.005, 0.0

    def sample(self, t_us):
        drawn = 0.02 * self._v_m_per_s + 0.05 * (self._x_m - self._centre_m)
        self._v_m_per_s += float(self._rng.normal(0.0, 0.02)) - drawn
        self._x_m += 1e-3 * self._v_m_per_s
        return PositionSample(t_us, (self._x_m,))


def layers(**properties):
    return tuple(
        Tissue(
            name=f"layer {rest_m}",
            rest_position_m=rest_m,
            stiffness_n_per_m=stiffness,
            breach_force_n=3.0,
            **properties,
        )
        for rest_m, stiffness in ((0.02, 800.0), (0.026, 500.0))
    )


SCENES = {
    "elastic": layers(),
    "friction": layers(shaft_friction_n=0.3),
    "viscous": layers(viscosity_n_s_per_m=4.0),
    "viscous and stiffening": layers(viscosity_n_s_per_m=4.0, stiffening_per_m=100.0),
}


def applied_n(master, t_us):
    """Return the force that the master's decoder gives now at the position of the newest tick [N]."""
    return master._applied._stream.decoder.reconstruct(t_us, master.position_m, t_us)[0]


def exceeding(scene, hand, law, **settings):
    """Return at how many ticks, of how many, the answer leaves a force that is not within the JND of the true one."""
    rng = np.random.default_rng(1)
    master = MasterNode(hand, None, MasterSettings(law=law, positions="line", **settings), rng)
    channels = {each: Emulator[bytes](parse_channel("perfect"), rng) for each in ("forward", "feedback")}
    loop = Loopback(master, SlaveNode(lambda _: Scene(scene), SlaveSettings(), rng), **channels)
    touched, ticks, wrong = Scene(scene), 0, 0
    loop.run(TICK_US)
    for _ in range(1200):
        loop.run(TICK_US)
        t_us, at_m = loop.now_us - TICK_US, single(master.position_m)
        true_n = touched.step(PositionSample(t_us, at_m)).force_n[0]
        felt_n = applied_n(master, t_us)
        ticks += true_n > 0.1
        wrong += abs(felt_n - true_n) > law.threshold_n(abs(felt_n)) * (1.0 + 1e-6)
    assert touched.breaches == loop.slave.contexts[0].scene.breaches
    return wrong, ticks


@pytest.mark.parametrize("codec", ["deadband", "adaptive-predictive", "motion-predictive"])
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("hand", [Vibrating, Wandering])
def test_the_felt_force_is_within_one_jnd(hand, scene, codec):
    wrong, ticks = exceeding(SCENES[scene], hand(0.024), WeberLaw(multiplier=2.0), codec=codec, position_share=0.9)
    assert ticks > 50
    assert wrong == 0


@pytest.mark.parametrize("scene", SCENES)
def test_it_holds_with_announced_contact(scene):
    wrong, ticks = exceeding(SCENES[scene], Vibrating(0.024), WeberLaw(), codec="deadband", announced=True)
    assert ticks > 50
    assert wrong == 0
