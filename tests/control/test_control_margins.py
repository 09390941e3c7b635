"""Computed margins of the force loop."""

import pytest

from hapticnet.control.finger import FingerSettings
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.control.margins import Actuator, loop_margins

SETTINGS = ForceControlSettings()


def test_on_a_finger_like_the_model_the_loop_has_large_margins() -> None:
    margins = loop_margins(SETTINGS, Actuator(), force_n=2.0, stiffness=1.0)
    assert margins.gain > 2.0  # 6 dB
    assert margins.phase_deg > 45.0
    assert 0.1 < margins.crossover_hz < 10.0


def test_delay_reduces_the_margins() -> None:
    margins = [
        loop_margins(SETTINGS, Actuator(transport_s=0.005 + delay_s), force_n=2.0, stiffness=1.0)
        for delay_s in (0.0, 0.01, 0.02, 0.04)
    ]
    gains = [each.gain for each in margins]
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] > 2.0
    unseen = loop_margins(SETTINGS, Actuator(unseen_s=0.04), force_n=2.0, stiffness=1.0)
    assert unseen.gain < margins[0].gain


@pytest.mark.parametrize("stiffness", [0.5, 2.0, 3.0])
def test_a_finger_stiffer_than_the_model_reduces_the_gain_margin(stiffness: float) -> None:
    as_believed = loop_margins(SETTINGS, Actuator(), force_n=2.0, stiffness=1.0)
    other = loop_margins(SETTINGS, Actuator(), force_n=2.0, stiffness=stiffness)
    assert other.gain == pytest.approx(as_believed.gain / stiffness)


def test_the_margins_do_not_depend_on_the_stiffness_of_the_model() -> None:
    margins = [
        loop_margins(
            ForceControlSettings(finger=FingerSettings(stiffness_n_m=n_per_m, uncertainty=0.0, change_m_n=0.0)),
            Actuator(),
            force_n=2.0,
            stiffness=1.0,
        )
        for n_per_m in (300.0, 3000.0)
    ]
    assert margins[0].gain == pytest.approx(margins[1].gain, rel=0.05)


def test_the_phase_margin_is_the_smallest_of_all_crossings_however_far_the_phase_has_turned() -> None:
    soft = ForceControlSettings(finger=FingerSettings(stiffness_n_m=300.0))
    margins = loop_margins(soft, Actuator(transport_s=0.1), force_n=2.0, stiffness=1.0)
    assert 45.0 < margins.phase_deg < 90.0
    assert margins.crossover_hz < 2.0
    assert 1.5 < margins.gain < 4.0
