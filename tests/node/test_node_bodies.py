"""Sessions on two and three axes: a hand palpates a body with friction over a network."""

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.experiment.analysis import vectors
from hapticnet.scene.bodies import BodyScene
from hapticnet.scene.settings import Plane


def slope(axes):
    plane = Plane(
        name="slope",
        point_m=(0.02, 0.0, 0.0)[:axes],
        inward=(0.95, 0.25, -0.15)[:axes],
        stiffness_n_per_m=300.0,
        friction=0.3,
        static_friction=0.5,
    )
    return BodyScene([plane], name="slope")


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("codec", ["deadband", "adaptive-predictive"])
def test_what_the_master_applies_is_within_a_jnd_on_all_axes(axes, codec):
    link = hn.virtual_link(scene=slope(axes), codec=codec, seed=2)
    link.run(seconds=2.5)
    samples = link.slave_samples()
    true, held = vectors(samples, "force", "n"), vectors(samples, "held", "n")
    assert true.shape == held.shape == (len(true), axes)
    assert (np.abs(true).max(axis=0) > 0.3).all()
    assert hn.error_report(true, held).exceed_jnd_fraction == 0.0
    assert samples["transmitted"].mean() < 0.3
