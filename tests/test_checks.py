"""Range checks, vectors and Weber's law: what they accept and what their messages say."""

import math

import numpy as np
import pytest

from hapticnet.checks import check_above, check_integer, check_parameter
from hapticnet.errors import SampleError, SettingsError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.samples import checked_vector


def test_limits_of_a_range_are_accepted():
    check_parameter("gain", 0.5, 0.5, 2.0)
    check_parameter("gain", 2.0, 0.5, 2.0)
    check_integer("count", 3.0, 1, 3)
    check_above("rate", 5.0, 0.0, 5.0)
    check_parameter("step", 0.0, 1e-6, 1.0, zero_allowed=True)


@pytest.mark.parametrize("value", [0.0, 2.1, math.nan, math.inf, -math.inf])
def test_a_value_out_of_range_is_reported_with_the_range_and_the_unit(value):
    with pytest.raises(SettingsError, match=rf"^gain is {value} N; it must be between 0\.5 and 2 N$"):
        check_parameter("gain", value, 0.5, 2.0, "N")


@pytest.mark.parametrize("value", [-1.0, 1e-7, math.nan])
def test_a_value_out_of_range_is_reported_with_zero_if_zero_is_allowed(value):
    with pytest.raises(SettingsError, match=rf"^step is {value}; it must be 0 or between 1e-06 and 1$"):
        check_parameter("step", value, 1e-6, 1.0, zero_allowed=True)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1.5, "a whole number"), (4, "between 1 and 3 samples"), (math.nan, "between 1 and 3 samples")],
)
def test_a_value_that_is_not_a_whole_number_in_range_is_reported(value, expected):
    with pytest.raises(SettingsError, match=rf"^count is {value}( samples)?; it must be {expected}$"):
        check_integer("count", value, 1, 3, "samples")


@pytest.mark.parametrize("value", [0.0, 5.1, math.nan])
def test_an_open_lower_bound_is_reported_as_above(value):
    with pytest.raises(SettingsError, match=rf"^rate is {value}; it must be above 0 and at most 5$"):
        check_above("rate", value, 0.0, 5.0)


@pytest.mark.parametrize("value", ["1.0", None, [1.0], np.ones(2), 1j])
def test_what_is_not_a_number_is_reported(value):
    with pytest.raises(SettingsError, match=r"^gain is of type \w+; it must be a number$"):
        check_parameter("gain", value, 0.5, 2.0)


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


@pytest.mark.parametrize("values", [[], [1.0] * 25, [math.nan], [0.0, math.inf], [1e300]])
def test_vectors_that_must_not_enter_are_refused(values):
    with pytest.raises(SampleError):
        checked_vector(values, "force")


def test_denormal_vectors_enter():
    assert checked_vector([5e-324], "force") == (5e-324,)
