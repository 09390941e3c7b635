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


def test_stiffening_does_not_overflow() -> None:
    for depth_m in (8.0, 1e6, 1e15):
        assert force_n(tissue(stiffening_per_m=100.0), depth_m) is None


def test_viscosity_resists_indentation_and_does_not_pull_on_withdrawal() -> None:
    viscous = tissue(viscosity_n_s_per_m=5.0)
    assert force_n(viscous, 2.0**-8, moving(0.1)) == pytest.approx(1.5)
    assert force_n(viscous, 2.0**-8, moving(-0.1)) == pytest.approx(0.5)
    assert force_n(viscous, 2.0**-8, moving(-1.0)) == 0.0


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
