import math

import pytest

from hapticnet.errors import SampleError, SettingsError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.samples import checked_vector


def test_the_papers_subjects_give_five_percent_and_a_floor_at_the_weakest_force_tested():
    assert pytest.approx(0.05) == PAPER_WEBER_FRACTION
    assert pytest.approx(0.025) == PAPER_FLOOR_N


def test_threshold_follows_webers_law_above_the_floor_and_the_multiplier_scales_both():
    law = WeberLaw(weber_fraction=0.1, floor_n=0.05, multiplier=2.0)
    assert law.threshold_n(1.0) == pytest.approx(0.2)
    assert law.threshold_n(0.1) == pytest.approx(0.1)
    assert law.jnd_n(1.0) == pytest.approx(0.1)


@pytest.mark.parametrize("field", ["weber_fraction", "floor_n", "multiplier"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1, 1e300])
def test_a_law_that_cannot_be_is_refused_with_the_value_seen(field, value):
    with pytest.raises(SettingsError, match="must be 0 or between 1e-12 and"):
        WeberLaw(**{field: value})


@pytest.mark.parametrize("values", [[], [1.0] * 4, [math.nan], [0.0, math.inf], [1e300]])
def test_vectors_that_must_not_enter_are_refused(values):
    with pytest.raises(SampleError):
        checked_vector(values, "force")


def test_denormal_vectors_enter():
    assert checked_vector([5e-324], "force") == (5e-324,)
