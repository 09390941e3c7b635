"""Comparison of the scene with a direct model that evaluates every layer in every step."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Contact, Tissue, front_to_back


@dataclass
class NaiveLayer:
    tissue: Tissue
    state: Contact = Contact.NONE
    breaches: int = 0
    released_m: float = 0.0
    released_us: int = 0
    friction_n: float = 0.0
    gripped_m: float = 0.0


class NaiveScene:
    def __init__(self, tissues: list[Tissue]) -> None:
        self.layers = [NaiveLayer(tissue) for tissue in front_to_back(tissues)]
        self.now_us = 0
        self.last: tuple[int, float] | None = None

    def surface_m(self, layer: NaiveLayer) -> float:
        rest_m, time_constant_us = layer.tissue.rest_position_m, 1e6 * layer.tissue.recovery_time_s
        if not time_constant_us or not layer.breaches:
            return rest_m
        elapsed_us = self.now_us - layer.released_us
        decayed = math.exp(-elapsed_us / time_constant_us)
        return min(layer.released_m, rest_m + (layer.released_m - rest_m) * decayed)

    def step(self, t_us: int, tip_m: float) -> float:
        last_us, last_m = self.last or (t_us, tip_m)
        self.last = (t_us, tip_m)
        elapsed_us = max(0, t_us - last_us)
        velocity_m_per_s = 1e6 * (tip_m - last_m) / elapsed_us if elapsed_us else 0.0
        velocity_m_per_s = max(-10.0, min(10.0, velocity_m_per_s))
        self.now_us += elapsed_us
        return sum((self.step_layer(layer, tip_m, velocity_m_per_s) for layer in self.layers), 0.0)

    def step_layer(self, layer: NaiveLayer, tip_m: float, velocity_m_per_s: float) -> float:
        tissue = layer.tissue
        surface_m = self.surface_m(layer)
        if layer.state is Contact.PENETRATED:
            if tip_m >= surface_m:
                return self.rub(layer, tip_m)
            layer.state = Contact.NONE
        if tip_m <= surface_m:
            layer.state = Contact.NONE
            return 0.0
        depth_m = tip_m - surface_m
        if tissue.stiffening_per_m:
            force_n = tissue.stiffness_n_per_m / tissue.stiffening_per_m * math.expm1(tissue.stiffening_per_m * depth_m)
        else:
            force_n = tissue.stiffness_n_per_m * depth_m
        if force_n <= tissue.breach_force_n:
            layer.state = Contact.CONTACT
            return max(0.0, force_n + tissue.viscosity_n_s_per_m * velocity_m_per_s)
        layer.state = Contact.PENETRATED
        layer.breaches += 1
        layer.gripped_m = min(surface_m + tissue.breach_depth_m, tip_m)
        layer.released_m = layer.gripped_m
        layer.released_us = self.now_us
        layer.friction_n = 0.0
        return self.rub(layer, tip_m)

    def rub(self, layer: NaiveLayer, tip_m: float) -> float:
        travel_m = tip_m - layer.gripped_m
        layer.gripped_m = tip_m
        level_n = math.copysign(layer.tissue.shaft_friction_n, travel_m)
        held = math.exp(-abs(travel_m) / layer.tissue.shaft_presliding_m)
        if travel_m:
            layer.friction_n = level_n + (layer.friction_n - level_n) * held
        return layer.friction_n

    def contacts(self) -> tuple[Contact, ...]:
        return tuple(layer.state for layer in self.layers)


def random_tissues(rng: np.random.Generator, *, layers: int, declared: float) -> list[Tissue]:
    """Return layers about 1 mm apart; each optional property is set with probability `declared`."""

    def maybe(largest: float) -> float:
        return float(rng.uniform(1e-6, largest)) if rng.random() < declared else 0.0

    return [
        Tissue(
            name=f"layer {k}",
            rest_position_m=1e-3 * (k + float(rng.uniform(0.0, 0.9))),
            stiffness_n_per_m=float(10.0 ** rng.uniform(2.0, 5.0)),
            breach_force_n=float(rng.uniform(0.1, 2.0)),
            viscosity_n_s_per_m=maybe(5.0),
            shaft_friction_n=maybe(0.2),
            stiffening_per_m=maybe(100.0),
            recovery_time_s=maybe(1.0),
        )
        for k in range(layers)
    ]


def walk_m(rng: np.random.Generator, *, steps: int, depth_m: float) -> list[float]:
    """Return a path that creeps, turns, rests and sometimes jumps to anywhere in or before the scene."""
    at_m, path_m = 0.0, []
    for _ in range(steps):
        what = rng.random()
        if what < 0.03:
            at_m = float(rng.uniform(-0.1, 1.1)) * depth_m
        elif what < 0.9:
            at_m += float(rng.normal(0.0, 2e-4))
        path_m.append(at_m)
    return path_m


def agree(rng: np.random.Generator, *, layers: int, declared: float, steps: int) -> None:
    tissues = random_tissues(rng, layers=layers, declared=declared)
    scene, naive = Scene(tissues), NaiveScene(tissues)
    t_us = 0
    for tip_m in walk_m(rng, steps=steps, depth_m=1e-3 * layers):
        t_us += int(rng.choice([1_000, 1_000, 1_000, 20_000, 0, 1, -500, 300_000]))
        assert scene.step(PositionSample(t_us, (tip_m,))).force_n[0] == naive.step(t_us, tip_m)
        assert scene.contacts() == naive.contacts()
        assert scene.breaches == sum(layer.breaches for layer in naive.layers)
        assert scene.surfaces_m() == tuple(
            tip_m if layer.state is Contact.CONTACT else naive.surface_m(layer) for layer in naive.layers
        )


@settings(deadline=None, max_examples=150)
@given(seed=st.integers(0, 2**32), declared=st.sampled_from([0.0, 0.2, 0.5, 1.0]))
def test_a_few_layers_agree_with_the_naive_model(seed: int, declared: float) -> None:
    agree(np.random.default_rng(seed), layers=5, declared=declared, steps=150)


@pytest.mark.parametrize("declared", [0.0, 0.1])
def test_a_thousand_layers_agree_with_the_naive_model(declared: float) -> None:
    agree(np.random.default_rng(1), layers=1_000, declared=declared, steps=150)
