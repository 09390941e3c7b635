import math
import sys
from types import FrameType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.errors import SampleError
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.layer import Shaft
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Contact, Tissue
from hapticnet.scene.sources import find_scene, paper_scene

NONE, CONTACT, PENETRATED = Contact
SECOND_US = 1_000_000


def tissue(rest_position_m: float = 0.0, **changes: float) -> Tissue:
    # Powers of two, so that forces at the chosen depths are exact: it breaches beyond 1/128 m.
    plain = {"stiffness_n_per_m": 256.0, "breach_force_n": 2.0}
    return Tissue(name=f"tissue at {rest_position_m}", rest_position_m=rest_position_m, **(plain | changes))


def step(scene: Scene, tip_m: float, t_us: int = 0) -> float:
    return scene.step(PositionSample(t_us, (tip_m,))).force_n[0]


# Contact, breach and healing ------------------------------------------------------------------------------


def test_a_tissue_breaks_strictly_above_its_breach_force() -> None:
    scene = Scene([tissue()])
    assert (scene.force_n, scene.contacts(), scene.surfaces_m(), scene.breaches) == (0.0, (NONE,), (0.0,), 0)
    assert scene.step(PositionSample(42, (2.0**-8,))) == ForceSample(42, (1.0,))
    assert scene.force_n == 1.0
    assert step(scene, 2.0**-7) == 2.0
    assert scene.breaches == 0
    assert step(scene, math.nextafter(2.0**-7, 1.0)) == 0.0
    assert scene.breaches == 1
    assert scene.contacts() == (PENETRATED,)
    assert scene.surfaces_m() == (0.0,)


def test_a_reset_restores_the_scene_but_not_the_count_of_breaches() -> None:
    scene = Scene([tissue(shaft_friction_n=0.2, recovery_time_s=1.0)])
    step(scene, 0.1)
    scene.reset()
    assert (scene.force_n, scene.contacts(), scene.surfaces_m()) == (0.0, (NONE,), (0.0,))
    assert step(scene, 2.0**-8) == 1.0
    assert scene.breaches == 1


# Recovery -------------------------------------------------------------------------------------------------


def breached(time_constant_s: float = 1.0, **changes: float) -> Scene:
    """Return a scene whose tissue broke at 1/128 m, at time 0, under a needle that is 0.1 m deep."""
    scene = Scene([tissue(recovery_time_s=time_constant_s, **changes)])
    step(scene, 0.1, 0)
    return scene


def test_recovery_is_exact_and_does_not_depend_on_the_steps() -> None:
    at_once, stepwise = breached(), breached()
    step(at_once, 0.1, 700_000)
    for t_us in range(1_000, 701_000, 1_000):
        step(stepwise, 0.1, t_us)
    assert stepwise.surfaces_m() == at_once.surfaces_m()
    assert at_once.surfaces_m()[0] == pytest.approx(2.0**-7 * math.exp(-0.7), rel=1e-14)


@pytest.mark.parametrize(("rest_m", "tip_m"), [(0.0, 0.033), (0.02, 0.053)])
def test_a_breach_is_not_undone_by_a_repeated_sample(rest_m: float, tip_m: float) -> None:
    """The tip is on the surface that it broke, or a rounding error before it."""
    scene = Scene([tissue(rest_m, stiffness_n_per_m=100.0, breach_force_n=3.3, recovery_time_s=1.0)])
    assert 100.0 * (tip_m - rest_m) > 3.3
    assert tip_m <= rest_m + 3.3 / 100.0
    for t_us in (0, 0, 1, 1, 2):
        step(scene, tip_m, t_us)
        assert scene.contacts() == (PENETRATED,)
    assert scene.breaches == 1


# Time -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jump_us", [3600 * SECOND_US, 10**15, 10**400])
def test_a_clock_that_jumps_ahead_finishes_recovery_and_leaves_the_spring(jump_us: int) -> None:
    scene = breached(viscosity_n_s_per_m=10.0)
    step(scene, -0.001, 1_000)
    assert step(scene, 2.0**-8, jump_us) == pytest.approx(1.0, abs=1e-4)


# What a scene says about the force near the tip ----------------------------------------------------------------


def test_a_bound_from_before_a_breach_or_a_withdrawal_is_not_given_again() -> None:
    scene = Scene([tissue()])
    step(scene, 2.0**-8)
    pressed = scene.stiffness_bound()
    assert pressed is not None
    assert pressed.stiffness_n_per_m == 256.0
    step(scene, 0.1)  # nobody asks here: the session sends every position
    step(scene, 2.0**-8)
    beyond = scene.stiffness_bound()
    assert beyond is not None
    assert beyond.stiffness_n_per_m == 0.0
    step(scene, -0.001)
    step(scene, 2.0**-8)
    assert scene.stiffness_bound() == pressed


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

tip_positions_m = st.lists(st.floats(-0.05, 0.15), min_size=1, max_size=80)


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


@settings(deadline=None)
@given(st.lists(st.floats(-0.005, 0.005), min_size=1, max_size=10))
def test_friction_returns_at_most_the_energy_stored_by_dragging_the_tissue(path_m: list[float]) -> None:
    """The stored energy is F²·δ/(2·F_c), from dF = (F_c/δ)·dz at F = 0; the rest is lost."""
    rubbing = Shaft(tissue(shaft_friction_n=0.3, shaft_presliding_m=1e-3))
    rubbing.grip(0.0)
    work_j, tip_m, last_n = 0.0, 0.0, 0.0
    for target_m in path_m:
        for next_m in np.linspace(tip_m, target_m, 201)[1:].tolist():
            next_n = rubbing.slide(next_m)
            work_j += (last_n + next_n) / 2.0 * (next_m - tip_m)
            tip_m, last_n = next_m, next_n
    assert work_j >= last_n**2 * 1e-3 / (2.0 * 0.3) - 1e-9


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
