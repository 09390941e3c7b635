import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticnet.scene.layer import Needle, RecoveringSurface, Shaft, contact_law
from hapticnet.scene.settings import Tissue

FRICTION_N = 0.3
PRESLIDING_M = 1e-3


def tissue(**changes: float) -> Tissue:
    plain = {"rest_position_m": 0.0, "stiffness_n_per_m": 256.0, "breach_force_n": 2.0}
    return Tissue(name="tissue", **(plain | changes))


def force_n(layer: Tissue, depth_m: float, needle: Needle | None = None) -> float | None:
    needle = needle or Needle()
    return contact_law(layer, RecoveringSurface(tissue(recovery_time_s=1.0), needle), needle)(depth_m)


def shaft(tip_m: float = 0.0) -> Shaft:
    rubbing = Shaft(tissue(shaft_friction_n=FRICTION_N, shaft_presliding_m=PRESLIDING_M))
    rubbing.grip(tip_m)
    return rubbing


def moving(velocity_m_per_s: float) -> Needle:
    needle = Needle()
    needle.velocity_m_per_s = velocity_m_per_s
    return needle


def test_stiffening_starts_at_the_stiffness_and_grows_exponentially() -> None:
    stiffening = tissue(stiffening_per_m=100.0)
    assert force_n(stiffening, 1e-9) == pytest.approx(256e-9)
    assert force_n(stiffening, 0.005) == pytest.approx(2.56 * (math.exp(0.5) - 1.0))
    assert force_n(stiffening, stiffening.breach_depth_m * 1.0001) is None


@pytest.mark.parametrize("depth_m", [8.0, 1e6, 1e15])
def test_stiffening_does_not_overflow(depth_m: float) -> None:
    assert force_n(tissue(stiffening_per_m=100.0), depth_m) is None


def test_viscosity_resists_indentation_and_does_not_pull_on_withdrawal() -> None:
    viscous = tissue(viscosity_n_s_per_m=5.0)
    assert force_n(viscous, 2.0**-8, moving(0.1)) == pytest.approx(1.5)
    assert force_n(viscous, 2.0**-8, moving(-0.1)) == pytest.approx(0.5)
    assert force_n(viscous, 2.0**-8, moving(-1.0)) == 0.0


def test_viscosity_does_not_affect_the_breach() -> None:
    viscous = tissue(viscosity_n_s_per_m=5.0)
    assert force_n(viscous, 2.0**-7, moving(1.0)) == pytest.approx(7.0)
    assert force_n(viscous, math.nextafter(2.0**-7, 1.0), moving(-1.0)) is None


def test_viscosity_does_not_act_before_the_surface_is_indented() -> None:
    assert force_n(tissue(viscosity_n_s_per_m=5.0), 0.0, moving(1.0)) == 0.0


def test_friction_rises_to_its_level_over_the_presliding_length() -> None:
    assert shaft().slide(0.0) == 0.0
    assert shaft().slide(PRESLIDING_M) == pytest.approx(FRICTION_N * (1.0 - 1.0 / math.e))
    assert shaft().slide(1.0) == pytest.approx(FRICTION_N)


def test_friction_holds_its_force_while_the_needle_is_still() -> None:
    rubbing = shaft()
    held_n = rubbing.slide(0.4e-3)
    assert [rubbing.slide(0.4e-3) for _ in range(100)] == [held_n] * 100


@given(st.lists(st.floats(-0.01, 0.01), min_size=1, max_size=50))
def test_friction_is_bounded_by_its_level(path_m: list[float]) -> None:
    rubbing = shaft()
    assert all(abs(rubbing.slide(tip_m)) <= FRICTION_N for tip_m in path_m)


@given(st.floats(-0.005, 0.005), st.integers(2, 50))
def test_friction_does_not_depend_on_the_steps_of_one_stroke(stroke_m: float, steps: int) -> None:
    at_once, stepwise = shaft(), shaft()
    for step in range(1, steps):
        stepwise.slide(stroke_m * step / steps)
    assert stepwise.slide(stroke_m) == pytest.approx(at_once.slide(stroke_m), abs=1e-12)


@settings(deadline=None)
@given(st.lists(st.floats(-0.005, 0.005), min_size=1, max_size=10))
def test_friction_returns_at_most_the_energy_stored_by_dragging_the_tissue(path_m: list[float]) -> None:
    """The stored energy is F²·δ/(2·F_c), from dF = (F_c/δ)·dz at F = 0; the rest is lost."""
    rubbing, work_j, tip_m, last_n = shaft(), 0.0, 0.0, 0.0
    for target_m in path_m:
        start_m = tip_m
        for step in range(1, 201):
            next_m = start_m + (target_m - start_m) * step / 200
            next_n = rubbing.slide(next_m)
            work_j += (last_n + next_n) / 2.0 * (next_m - tip_m)
            tip_m, last_n = next_m, next_n
    assert work_j >= last_n**2 * PRESLIDING_M / (2.0 * FRICTION_N) - 1e-9
