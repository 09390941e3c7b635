from dataclasses import replace

import pytest

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings, parse_jitter
from hapticnet.errors import SettingsError
from hapticnet.experiment.stability import SMALL_SWING_M, Setup, outcomes, press
from hapticnet.measure.stability import onset
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.yielding import HANDS, GroundedSettings
from hapticnet.scene.sources import find_source

RAW = Setup(master=MasterSettings(codec="raw"))
ARM = HANDS["arm"]


@pytest.mark.parametrize(
    ("hand", "rate_hz", "delay_ms"), [("arm", 1000.0, 0), ("arm", 1000.0, 50), ("stiff-arm", 500.0, 20)]
)
def test_a_hand_begins_to_swing_where_the_closed_form_says(hand, rate_hz, delay_ms):
    setup = replace(RAW, hand=HANDS[hand], master=replace(RAW.master, rate_hz=rate_hz))
    exact, of_hand = setup.expected(1e-3 * delay_ms).stiffness_n_per_m, HANDS[hand]
    assert press(setup, 0.98 * exact, 1e-3 * delay_ms, gentle=True).stable
    assert not press(setup, 1.02 * exact, 1e-3 * delay_ms, gentle=True).stable
    late_s = 1e-3 * delay_ms + 1.5 / rate_hz
    continuous = onset(of_hand.mass_kg, of_hand.damping_n_s_per_m, of_hand.stiffness_n_per_m, late_s)
    assert exact == pytest.approx(continuous.stiffness_n_per_m, rel=0.03)


def test_a_late_spring_is_displayed_with_negative_damping_and_some_mass():
    found = press(RAW, 100.0, 0.02)  # Hirche and Buss: K − K·T·s + K·T²/2·s², with a tick for the loop
    assert found.stable
    assert found.transparent
    assert found.failure is None
    assert found.true == pytest.approx((100.0, 0.0, 0.0), abs=1e-9)
    assert found.displayed == (
        pytest.approx(100.0, rel=0.01),
        pytest.approx(-2.1, rel=0.05),
        pytest.approx(0.02, abs=0.03),
    )
    assert found.lag_s == pytest.approx(0.021, abs=0.001)
    assert 0.0 < found.position_error_m < 1e-3
    assert 0.0 < found.force_error_n < 0.2
    assert found.forward_packets == pytest.approx(found.feedback_packets, rel=0.01)
    assert found.forward_bytes > 28 * found.forward_packets
    assert found.created_j > 0.0


def test_a_hand_that_settles_slowly_is_stable_and_one_that_swings_for_ever_is_not():
    exact = RAW.expected(0.02).stiffness_n_per_m
    slowly, swinging = press(RAW, 0.85 * exact, 0.02), press(RAW, 1.1 * exact, 0.02)
    assert slowly.stable
    assert slowly.settles
    assert SMALL_SWING_M < slowly.swing_m < 0.01
    assert not swinging.stable
    assert not swinging.settles
    assert swinging.swing_m > 0.01
    assert swinging.displayed is None
    assert swinging.stiffness_share is None
    assert not swinging.transparent
    assert swinging.active_j > 10.0 * slowly.active_j


def test_motion_predictive_holds_a_wall_that_throws_the_hand_without_it():
    link = ChannelSettings(loss=BernoulliLoss(0.05), jitter=parse_jitter("normal:5ms"))
    thrown, held = (
        press(Setup(master=MasterSettings(codec=codec), channel=link), 1000.0, 0.05)
        for codec in ("deadband", "motion-predictive")
    )
    assert thrown.swing_m > 1.0
    assert not thrown.stable
    assert held.stable
    assert held.swing_m < SMALL_SWING_M
    assert held.feedback_packets < thrown.feedback_packets


def test_a_device_pushes_with_no_more_than_it_can():
    setup = replace(RAW, device=GroundedSettings(mass_kg=0.1, friction_n=0.2, max_force_n=2.0, resolution_m=50e-6))
    found = press(setup, 300.0, 0.05)
    assert found.largest_n == pytest.approx(2.0)
    assert found.swing_m < press(RAW, 300.0, 0.05).swing_m


def test_a_given_scene_is_pressed_at_its_surface_and_does_not_break():
    found = press(replace(RAW, scene=find_source("paper:1")), None, 0.0)
    assert found.stable
    assert found.true is not None
    assert found.true[0] in map(pytest.approx, (200.0, 350.0, 500.0))
    assert found.largest_n > 2.9


@pytest.mark.parametrize(
    ("scene", "message"),
    [("phantom", r"axes; a map presses on one axis"), (None, "a press needs a stiffness or a scene")],
)
def test_what_cannot_be_pressed_is_refused(scene, message):
    with pytest.raises(SettingsError, match=message):
        press(replace(RAW, scene=scene and find_source(scene)), None, 0.0)


def test_a_link_that_loses_all_is_refused():
    with pytest.raises(SettingsError, match="no session begins within 10 s over a round trip of 0 s with loss=100%"):
        press(replace(RAW, channel=ChannelSettings(loss=BernoulliLoss(1.0))), 100.0, 0.0)


def test_a_map_is_in_order_and_does_not_depend_on_the_number_of_processes():
    setup = replace(RAW, channel=ChannelSettings(loss=BernoulliLoss(0.1)), seed=3)
    cells = [(100.0, 0.0), (300.0, 0.0), (100.0, 0.01)]
    one, two = (list(outcomes(setup, cells, jobs=jobs)) for jobs in (1, 2))
    assert one == two
    assert [(each.stiffness_n_per_m, each.round_trip_s) for each in one] == cells
    assert one[0] != press(replace(setup, seed=4), *cells[0])


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
@pytest.mark.parametrize("mass_kg", [1e-5, 0.5])
@pytest.mark.parametrize("codec", ["deadband", "motion-predictive"])
def test_no_wall_mass_or_rate_breaks_the_energy_bound(codec, mass_kg, rate_hz):
    setup = Setup(
        hand=replace(HANDS["arm"], mass_kg=mass_kg),
        device=GroundedSettings(max_force_n=8.0, resolution_m=1e-5),
        master=MasterSettings(codec=codec, coupling="energy-bounded", rate_hz=rate_hz),
    )
    found = press(setup, 1e6, 0.1)
    assert found.stable
    assert found.largest_n <= 8.0
