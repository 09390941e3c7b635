import math

import pytest

from hapticnet.errors import SettingsError
from hapticnet.scene.settings import SceneSettings, Tissue, front_to_back

PLAIN = {"name": "skin", "rest_position_m": 0.02, "stiffness_n_per_m": 200.0, "breach_force_n": 2.0}
POSITIVE = ("stiffness_n_per_m", "breach_force_n", "shaft_presliding_m")
OPTIONAL = ("viscosity_n_s_per_m", "shaft_friction_n", "stiffening_per_m", "recovery_time_s")


def tissue(**changes: float | str) -> Tissue:
    return Tissue(**(PLAIN | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("key", [*POSITIVE, *OPTIONAL, "rest_position_m"])
def test_a_value_out_of_range_is_refused_by_name(key: str) -> None:
    wrong = [math.nan, math.inf, -math.inf, 1e300, -1e300, 1e6 + 1.0]
    wrong += [] if key == "rest_position_m" else [-1.0, 5e-324, -5e-324]
    for value in [*wrong, 0.0] if key in POSITIVE else wrong:
        with pytest.raises(SettingsError, match=f"'skin': {key} is "):
            tissue(**{key: value})
    assert getattr(tissue(**{key: 1e6}), key) == 1e6


@pytest.mark.parametrize("key", OPTIONAL)
def test_zero_disables_an_optional_property(key: str) -> None:
    assert tissue(**{key: 0.0}) == tissue()


def test_breach_depth_is_where_the_spring_reaches_the_breach_force() -> None:
    assert tissue().breach_depth_m == pytest.approx(0.01)
    stiffening = tissue(stiffening_per_m=50.0)
    assert 200.0 / 50.0 * math.expm1(50.0 * stiffening.breach_depth_m) == pytest.approx(2.0)


def test_tissues_are_ordered_from_front_to_back() -> None:
    back, front = tissue(name="back", rest_position_m=0.1), tissue(name="front", rest_position_m=-0.1)
    assert front_to_back([back, front]) == (front, back)
    assert SceneSettings(name="two", tissues=(back, front)).tissues == (front, back)


@pytest.mark.parametrize("position_m", [(0.02, 0.02), (0.0, -0.0)])
def test_a_gap_without_thickness_is_refused_and_names_both_tissues(position_m: tuple[float, float]) -> None:
    twins = [tissue(name=name, rest_position_m=at) for name, at in zip(("skin", "fat"), position_m, strict=True)]
    with pytest.raises(SettingsError, match="'skin' and 'fat'"):
        front_to_back([twins[0], tissue(rest_position_m=0.5), twins[1]])
    with pytest.raises(SettingsError, match="no tissue"):
        front_to_back([])
