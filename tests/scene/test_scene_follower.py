import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hapticnet as hn
from hapticnet.errors import SampleError, SettingsError
from hapticnet.samples import PositionSample
from hapticnet.scene.base import bound_method, look_ahead_of
from hapticnet.scene.follower import LONGEST_MOTION_US, Follower
from hapticnet.scene.settings import FollowerSettings, SceneSettings, Tissue
from hapticnet.scene.sources import find_scene, make_scene, parse_scene

PD = FollowerSettings(mass_kg=0.04, stiffness_n_per_m=300.0, damping_n_s_per_m=1.0)  # spebern/chai3d, 32-spring
PID = replace(PD, integral_n_per_m_s=0.15)
SURFACE_M = 0.01
RATES_HZ = (20, 100, 1000, 10_000)
TOML = """
name = "spring"
[[tissue]]
name = "spring"
rest_position_m = 0.01
stiffness_n_per_m = 800.0
breach_force_n = 1000.0
[follower]
mass_kg = 0.04
stiffness_n_per_m = 300.0
damping_n_s_per_m = 1.0
"""


def wall(stiffness, settings=PD, breach_force_n=1e6, **more):
    tissue = Tissue(
        name="wall", rest_position_m=SURFACE_M, stiffness_n_per_m=stiffness, breach_force_n=breach_force_n, **more
    )
    return make_scene(SceneSettings(name="wall", tissues=(tissue,), follower=settings))


def run(follower, at_m, rate_hz, seconds=1.0, start=0):
    """Move it along and return the force [N], the position [m] and the velocity of the mass at each sample."""
    rows = []
    for number in range(start, start + int(seconds * rate_hz) + 1):
        force = follower.step(PositionSample(round(number * 1e6 / rate_hz), (at_m(number / rate_hz),)))
        rows.append((force.force_n[0], follower.position_m[0], follower.velocity_m_per_s[0]))
    return np.array(rows).T


def wave_m(t_s):
    return 0.02 * (1.0 - math.cos(9.0 * t_s))


@pytest.mark.parametrize("stiffness", [0.001, 800.0])
@pytest.mark.parametrize("settings", [PD, PID, replace(PD, integral_n_per_m_s=500.0)])
def test_the_mass_moves_as_its_equation_says(settings, stiffness):
    def rates(t_s, state):
        off_m, slip = wave_m(t_s) - state[0], 0.18 * math.sin(9.0 * t_s) - state[1]
        pushed_n = 300.0 * off_m + slip + settings.integral_n_per_m_s * state[2]
        return [state[1], (pushed_n - stiffness * max(0.0, state[0] - SURFACE_M)) / 0.04, off_m]

    exact = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0, 0.0], rtol=1e-8, atol=1e-10, max_step=1e-3, dense_output=True)
    for rate_hz, most_m in ((100, 5e-5), (1000, 3e-5), (10_000, 2e-5)):
        contact_n, at_m, _ = run(wall(stiffness, settings), wave_m, rate_hz)
        true_m = exact.sol(np.arange(rate_hz + 1) / rate_hz)[0]
        assert np.sqrt(np.mean((at_m - true_m) ** 2)) < most_m
        assert contact_n == pytest.approx(stiffness * np.maximum(0.0, at_m - SURFACE_M), abs=1e-4)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("stiffness", [1.0, 800.0, 1e6])
@pytest.mark.parametrize("mass_kg", [1e-6, 0.04, 100.0])
def test_the_contact_never_creates_energy(mass_kg, stiffness, rate_hz):
    follower = wall(stiffness, replace(PD, mass_kg=mass_kg))
    target_m = 0.03
    run(follower, lambda t_s: min(0.5 * t_s, target_m), rate_hz, 0.1)
    rows = run(follower, lambda _: target_m, rate_hz, min(2.0, 1000 / rate_hz), start=rate_hz // 10 + 1)
    energy_j = (
        0.5 * mass_kg * rows[2] ** 2
        + 150.0 * (target_m - rows[1]) ** 2
        + 0.5 * stiffness * np.maximum(0.0, rows[1] - SURFACE_M) ** 2
    )
    assert (np.diff(energy_j) <= 1e-6 * energy_j[0]).all()
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_at_rest_contact_and_controller_balance_at_any_rate(rate_hz):
    for force in ("contact", "controller"):
        follower = wall(1e6, replace(PD, damping_n_s_per_m=5.0, force=force))
        force_n, at_m, _ = run(follower, lambda t_s: min(0.03, 0.1 * t_s), rate_hz, 2.0)
        assert force_n[-1] == pytest.approx(300.0 * 0.02, rel=1e-3)
        assert at_m[-1] == pytest.approx(SURFACE_M, abs=1e-5)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_a_surface_breaks_at_its_breach_force_and_not_before(rate_hz):
    follower = wall(500.0, breach_force_n=5.0)
    run(follower, lambda t_s: 0.03 * min(1.0, t_s), rate_hz, 2.0)  # 20 mm: 300 N/m and 500 N/m balance at 3.75 N
    assert follower.breaches == 0
    force_n, _, _ = run(follower, lambda t_s: 0.03 + 0.03 * min(1.0, t_s - 2.0), rate_hz, 2.0, start=2 * rate_hz + 1)
    assert follower.breaches == 1
    assert force_n.max() == pytest.approx(5.0, rel=0.1)
    assert force_n[-1] == 0.0


def test_what_the_scene_has_of_time_and_of_several_axes_is_kept():
    viscous = replace(find_scene("example-viscous"), follower=PID)
    force_n, _, _ = run(make_scene(viscous), lambda t_s: 0.09 * min(t_s, 2.0 - t_s), 1000, 2.0)
    assert force_n.max() > 1.0 > 0.0 > force_n.min()  # the shaft's friction holds it back
    slow, fast = (make_scene(replace(find_scene("phantom"), follower=PD)) for _ in range(2))
    for n in range(2000):  # in stretches of 10 ms that both see as even
        ends = [np.array([0.028 * min(1.0, s / 50), 0.01 * math.sin(s / 25), 0.005]) for s in (n // 10, n // 10 + 1)]
        sample = PositionSample(1000 * n, tuple(ends[0] + n % 10 / 10 * (ends[1] - ends[0])))
        fast_n = fast.step(sample).force_n
        if n % 10 == 0:
            slow_n = slow.step(sample).force_n
            assert slow_n == pytest.approx(fast_n, abs=0.02)
    assert slow.axes == 3
    assert max(slow_n) > 0.3


def test_a_copy_goes_its_own_way_and_changes_nothing():
    follower = wall(500.0, breach_force_n=3.0)
    run(follower, lambda t_s: 0.1 * t_s, 1000, 0.2)
    samples = [PositionSample(200_000 + 1000 * n, (0.02 + 1e-4 * n,)) for n in range(1, 200)]
    copy = follower.copy()
    expected_n = [copy.step(sample).force_n for sample in samples]
    assert (copy.breaches, follower.breaches) == (1, 0)
    assert [follower.step(sample).force_n for sample in samples] == expected_n


def test_pauses_repeated_times_and_times_that_go_back_are_harmless():
    follower = wall(800.0)
    run(follower, lambda _: 0.02, 1000, 0.5)
    for t_us in (500_000, 500_000, 100, 100 + 50 * LONGEST_MOTION_US, 2**62):
        force = follower.step(PositionSample(t_us, (0.02,)))
        assert force == (t_us, pytest.approx((800 * 300 / 1100 * 0.01,), rel=0.05))
    with pytest.raises(SampleError, match="2 axes; the scene has 1"):
        follower.step(PositionSample(0, (0.0, 0.0)))
    with pytest.raises(SampleError):
        follower.step(PositionSample(0, (math.nan,)))


def test_a_scene_file_can_have_a_follower():
    settings = parse_scene(TOML, "spring.toml")
    assert settings.follower == PD
    follower = make_scene(settings)
    assert isinstance(follower, Follower)
    assert (follower.name, look_ahead_of(follower), bound_method(follower)) == ("spring", None, None)
    assert follower.settings == settings
    assert parse_scene(TOML.partition("[follower]")[0], "spring.toml").follower is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("mass_kg = 0.04", ""), "mass_kg"),
        (("mass_kg", "mass"), "mass"),
        (("mass_kg = 0.04", "mass_kg = 0"), "follower: mass_kg is 0"),
        (("damping_n_s_per_m = 1.0", "damping_n_s_per_m = 0"), "damping_n_s_per_m is 0"),
        (
            ("mass_kg = 0.04", "mass_kg = 0.04\nintegral_n_per_m_s = 8000"),
            "below damping times stiffness over mass, 7500",
        ),
        (("mass_kg = 0.04", "mass_kg = 0.04\nforce = 'both'"), "force"),
    ],
)
def test_a_wrong_follower_is_refused_in_a_sentence(change, message):
    with pytest.raises(SettingsError, match=message):
        parse_scene(TOML.replace(*change), "spring.toml")


@pytest.mark.parametrize("predicted", [False, True])
def test_a_hand_feels_the_follower_over_a_link(predicted, tmp_path):
    file = tmp_path / "spring.toml"
    file.write_text(TOML)
    link = hn.virtual_link(scene=str(file), operator="hand:arm", codec="raw", predicted=predicted, announced=True)
    link.run(seconds=2.0)
    assert link.master_samples()["held_n"].max() > 1.0
