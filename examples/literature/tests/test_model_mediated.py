"""Model-mediated teleoperation: a wall is learned, sent when it changes, and rendered at the hand's own position."""

import numpy as np
import pytest

from hapticnet.api.link import virtual_link
from hapticnet.codec.recording import encode_array
from hapticnet.errors import PeerError
from hapticnet.operator.yielding import HANDS, YieldingOperator
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample
from hapticnet.scene.settings import SceneSettings, Tissue
from hapticnet.scene.sources import make_scene
from hapticnet_literature.model_mediated import ModelMediated

LAW = WeberLaw(weber_fraction=0.05, floor_n=0.025)
MS = 1000


def pressed(stiffness, axes=1, samples=6000, breach_m=np.inf):
    """Return times, forces and positions of a hand that presses a wall 2 mm away at 0.8 Hz, 6 mm deep."""
    normal = np.array([1.0, -0.5, 0.2])[:axes] / np.linalg.norm(np.array([1.0, -0.5, 0.2])[:axes])
    depth = -0.002 + 0.008 * np.sin(2 * np.pi * 0.8e-3 * np.arange(samples)) ** 2
    force = np.where(depth < breach_m, stiffness * np.clip(depth, 0.0, None), 0.0)
    return MS * np.arange(samples), force[:, None] * normal, (depth + 0.002)[:, None] * normal


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("stiffness", [100.0, 800.0])
def test_a_wall_is_learned_and_then_costs_little(axes, stiffness):
    t_us, force, position = pressed(stiffness, axes)
    encoding = encode_array(ModelMediated(law=LAW, gain=20.0), t_us, force, position)
    assert len(encoding.sent) < 50
    error = np.abs(encoding.decoded - force)[2000:].max()
    assert error < 0.15 * force.max()


def test_a_wall_that_gives_way_is_gone():
    t_us, force, position = pressed(500.0, breach_m=0.004, samples=700)
    encoding = encode_array(ModelMediated(law=LAW), t_us, force, position)
    first = np.flatnonzero(np.diff((force[:, 0] > 0.0).astype(int)) == -1)[0] + 1
    assert first in encoding.sent
    assert encoding.decoded[first, 0] == 0.0


def test_the_published_gain_and_deadband_decide_what_is_sent():
    encoder = ModelMediated(law=LAW, gain=0.1).encoder(1)
    assert encoder.encode(0, (0.0,), (0.0,)).hex() == "00" + "00000000"
    assert encoder.encode(1 * MS, (1.0,), (0.005,)).hex() == "01" + "00000000" + "43480000"  # 200 N/m, 1 N at 5 mm
    assert encoder.encode(2 * MS, (5.0,), (0.01,)) is None  # k += 0.1 · (5 − 2) is no 10 %
    encoder.refresh()
    assert np.frombuffer(encoder.encode(3 * MS, (5.0,), (0.01,))[1:], ">f4") == pytest.approx([0.0, 200.6], abs=0.01)


def test_a_wall_that_pushes_harder_is_blended_in_and_one_that_pushes_less_comes_at_once():
    decoder = ModelMediated(law=LAW, blend_ms=50.0).decoder(1)
    decoder.reconstruct(0, (0.01,))
    decoder.decode(0, b"\1" + np.array([0.0, 400.0], ">f4").tobytes())
    assert decoder.reconstruct(0, (0.01,)) == (0.0,)
    assert decoder.reconstruct(50 * MS, (0.01,)) == (pytest.approx(2.0),)
    decoder.decode(50 * MS, b"\1" + np.array([0.0, 100.0], ">f4").tobytes())
    assert decoder.reconstruct(50 * MS, (0.01,)) == (pytest.approx(1.0),)
    assert decoder.reconstruct(50 * MS, (-0.01,)) == (0.0,)


@pytest.mark.parametrize(
    "payload", [b"", b"\0", b"\2" + bytes(8), b"\1" + bytes(7), b"\1" + bytes.fromhex("000000007fc00000")]
)
def test_bad_payloads_change_nothing(payload):
    decoder = ModelMediated(law=LAW).decoder(1)
    decoder.decode(0, b"\0" + np.array([1.5], ">f4").tobytes())
    with pytest.raises(PeerError):
        decoder.decode(MS, payload)
    assert decoder.reconstruct(MS, (0.0,)) == (1.5,)


class Press:
    axes, duration_us = 1, 10_000_000

    def sample(self, t_us):
        return PositionSample(t_us, (min(t_us * 1e-6, 1.0) * 0.03 - 0.005,))


@pytest.mark.parametrize("round_trip_ms", [0, 100])
def test_an_arm_on_a_wall_is_at_rest_over_a_delay(round_trip_ms):
    wall = Tissue(name="wall", rest_position_m=0.0, stiffness_n_per_m=500.0, breach_force_n=1e6)
    link = virtual_link(
        scene=make_scene(SceneSettings(name="wall", tissues=(wall,))), codec=ModelMediated(law=LAW),
        forward=f"delay={round_trip_ms / 2}ms", feedback=f"delay={round_trip_ms / 2}ms",
        operator=YieldingOperator(Press(), HANDS["arm"]),
    )  # fmt: skip
    link.run(seconds=5.0)
    assert np.ptp(link.master_samples()["position_m"][-500:]) < 1e-3
    assert link.report().sent < 60
