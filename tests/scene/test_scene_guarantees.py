"""Guarantees of a scene for any input: refused positions, bounds, energy and cost of a step."""

import math
import sys
from types import FrameType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import SampleError
from hapticnet.samples import PositionSample
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Contact, Tissue
from hapticnet.scene.sources import find_scene, paper_scene

SECOND_US = 1_000_000


def tissue(rest_position_m: float = 0.0, **changes: float) -> Tissue:
    # Powers of two, so that forces at the chosen depths are exact: it breaches beyond 1/128 m.
    plain = {"stiffness_n_per_m": 256.0, "breach_force_n": 2.0}
    return Tissue(name=f"tissue at {rest_position_m}", rest_position_m=rest_position_m, **(plain | changes))


def step(scene: Scene, tip_m: float, t_us: int = 0) -> float:
    return scene.step(PositionSample(t_us, (tip_m,))).force_n[0]


tip_positions_m = st.lists(st.floats(-0.05, 0.15), min_size=1, max_size=80)


# Invalid positions ----------------------------------------------------------------------------------------

EVERYTHING = find_scene("example-viscous").tissues
PAPER = paper_scene(2).tissues


@pytest.mark.parametrize("tissues", [PAPER, EVERYTHING])
@pytest.mark.parametrize("position_m", [(math.nan,), (math.inf,), (-math.inf,), (1e300,), (-1e300,), (), (0.0, 0.0)])
def test_an_invalid_position_is_refused_and_changes_nothing(
    tissues: tuple[Tissue, ...], position_m: tuple[float, ...]
) -> None:
    scene, twin = Scene(tissues), Scene(tissues)
    for k, tip_m in enumerate([0.0, 0.021, 0.025, 0.1, 0.03, 0.024, 0.01, 0.022]):
        with pytest.raises(SampleError, match="position"):
            scene.step(PositionSample(k * 1_000 + 500, position_m))
        assert step(scene, tip_m, k * 1_000) == step(twin, tip_m, k * 1_000)
        assert scene.surfaces_m() == twin.surfaces_m()


@pytest.mark.parametrize("tissues", [PAPER, EVERYTHING])
def test_denormal_and_huge_positions_are_accepted(tissues: tuple[Tissue, ...]) -> None:
    scene = Scene(tissues)
    for t_us, tip_m in enumerate([5e-324, -5e-324, 1e15, -1e15, 1e15, 0.021, -1e15]):
        assert math.isfinite(step(scene, tip_m, t_us))
    assert scene.contacts() == (Contact.NONE,) * 3


# Laws -----------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    path_m=tip_positions_m, stiffening_per_m=st.sampled_from([0.0, 1e-3, 100.0]), recovery_s=st.sampled_from([0.0, 0.1])
)
def test_a_stiff_scene_at_50_hz_stays_within_its_breach_forces(
    path_m: list[float], stiffening_per_m: float, recovery_s: float
) -> None:
    declared = {"stiffening_per_m": stiffening_per_m, "recovery_time_s": recovery_s, "stiffness_n_per_m": 1e5}
    scene = Scene([tissue(k * 0.01, **declared) for k in range(5)])
    for k, tip_m in enumerate(path_m):
        assert 0.0 <= step(scene, tip_m, k * 20_000) <= 5 * 2.0


@settings(deadline=None)
@given(path_m=tip_positions_m, steps_us=st.lists(st.integers(-(10**6), 10**10), min_size=80, max_size=80))
def test_force_is_bounded_at_any_time_steps_with_all_properties(path_m: list[float], steps_us: list[int]) -> None:
    scene, t_us = Scene(EVERYTHING), 0
    friction_n = sum(layer.shaft_friction_n for layer in EVERYTHING)
    largest_n = sum(layer.breach_force_n + 10.0 * layer.viscosity_n_s_per_m for layer in EVERYTHING) + friction_n
    for tip_m, step_us in zip(path_m, steps_us, strict=False):
        t_us += step_us
        assert -friction_n <= step(scene, tip_m, t_us) <= largest_n


@settings(deadline=None)
@given(st.lists(st.integers(-3, 3), max_size=300), st.sampled_from([0.0, 200.0]))
def test_a_closed_path_through_elastic_tissue_conserves_energy(strides: list[int], stiffening_per_m: float) -> None:
    layers = [tissue(k * 0.004, breach_force_n=1e3, stiffening_per_m=stiffening_per_m) for k in range(3)]
    scene, work_j, at = Scene(layers), 0.0, 0
    last_n = step(scene, 0.0)
    # With strides of one, every stretch is passed equally often in both directions.
    for stride in [*strides, -sum(strides)]:
        for _ in range(abs(stride)):
            at += 1 if stride > 0 else -1
            force_n = step(scene, at * 0.001)
            work_j += (last_n + force_n) / 2.0 * math.copysign(0.001, stride)
            last_n = force_n
    assert scene.breaches == 0
    assert work_j == pytest.approx(0.0, abs=1e-9)


# Cost -----------------------------------------------------------------------------------------------------


def calls_in(scene: Scene, sample: PositionSample) -> int:
    """Return the number of Python functions that one step calls."""
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    try:
        scene.step(sample)
    finally:
        sys.setprofile(None)
    return calls


@pytest.mark.parametrize("declared", [{}, {"recovery_time_s": 0.1}, {"viscosity_n_s_per_m": 1.0}])
def test_a_step_evaluates_only_the_layers_the_needle_is_in(declared: dict[str, float]) -> None:
    def calls(layers: int) -> int:
        scene = Scene([tissue(float(k), **declared) for k in range(layers)])
        deep_m = layers // 2 + 2.0**-9
        step(scene, deep_m, 0)
        step(scene, deep_m, SECOND_US)
        return calls_in(scene, PositionSample(2 * SECOND_US, (deep_m + 2.0**-9,)))

    assert calls(3) == calls(2_000)


@pytest.mark.plain
def test_a_step_costs_less_with_fewer_properties() -> None:
    def calls(**declared: float) -> int:
        scene = Scene([tissue(**declared)])
        step(scene, 2.0**-9, 0)
        return calls_in(scene, PositionSample(1_000, (2.0**-8,)))

    optional = {"viscosity_n_s_per_m": 1.0, "recovery_time_s": 1.0, "shaft_friction_n": 1.0, "stiffening_per_m": 1.0}
    assert calls(shaft_friction_n=1.0) == calls(stiffening_per_m=1.0) == calls()
    assert calls() < calls(viscosity_n_s_per_m=1.0) < calls(**optional)
