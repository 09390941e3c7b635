import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.device.calibration import Calibration, fit_calibration
from hapticnet.device.simulated import Sensor, loading_calibration
from hapticnet.errors import SettingsError
from hapticnet.hardware import SENSOR_THRESHOLD_N

SENSOR = Sensor()
CALIBRATION = loading_calibration(SENSOR)


@given(st.integers(-5, 1030), st.integers(-5, 1030), st.floats(0.2, 20.0))
def test_force_is_monotone_in_counts_and_inverts_the_sensor(a: int, b: int, force_n: float) -> None:
    low, high = sorted((a, b))
    assert 0.0 <= CALIBRATION.force_n(low) <= CALIBRATION.force_n(high) <= 20.0
    assert CALIBRATION.force_n(SENSOR.counts(force_n)) == pytest.approx(force_n, rel=0.04)


@pytest.mark.parametrize("exponent", [0.9, 1.0, 1.1])
def test_is_exact_at_the_calibrated_forces(exponent: float) -> None:
    sensor = Sensor(exponent=exponent)
    calibration = loading_calibration(sensor)
    for force_n in calibration.forces_n:
        assert calibration.force_n(sensor.counts(force_n)) == pytest.approx(force_n, rel=1e-12)


def test_the_table_falls_to_zero_below_its_range_and_is_constant_above() -> None:
    calibration = Calibration(counts=(100.0, 200.0), forces_n=(0.5, 2.5))
    counts = (-1, 0, 50, 100, 200, 1023, math.nan)
    assert [calibration.force_n(adc) for adc in counts] == [0.0, 0.0, 0.25, 0.5, 2.5, 2.5, 2.5]


@pytest.mark.parametrize(
    ("counts", "forces_n"),
    [
        ((), ()), ((100.0,), (1.0,)), ((100.0, 200.0), (1.0,)), ((200.0, 100.0), (1.0, 2.0)),
        ((100.0, 100.0), (1.0, 2.0)), ((100.0, 200.0), (2.0, 1.0)), ((0.0, 200.0), (1.0, 2.0)),
        ((100.0, math.nan), (1.0, 2.0)), ((100.0, 200.0), (1.0, math.inf)),
    ],
)  # fmt: skip
def test_refuses_a_table_that_is_not_monotone(counts: tuple[float, ...], forces_n: tuple[float, ...]) -> None:
    with pytest.raises(SettingsError, match="calibration"):
        Calibration(counts, forces_n)


KNOWN_FORCES_N = (0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)

pairs_of_any_kind = st.lists(
    st.tuples(st.floats(0.0, 1023.0) | st.integers(0, 1023), st.floats(0.0, 100.0) | st.integers(0, 10)), max_size=30
)


@given(pairs_of_any_kind, st.randoms(use_true_random=False))
def test_a_fit_is_strictly_increasing_or_refused_and_independent_of_order(pairs, random) -> None:
    shuffled = list(pairs)
    random.shuffle(shuffled)
    try:
        # A calibration that is not strictly increasing would raise.
        fit = fit_calibration([adc for adc, _ in pairs], [force_n for _, force_n in pairs])
    except SettingsError:
        with pytest.raises(SettingsError):
            fit_calibration([adc for adc, _ in shuffled], [force_n for _, force_n in shuffled])
        return
    again = fit_calibration([adc for adc, _ in shuffled], [force_n for _, force_n in shuffled])
    assert (again.calibration, again.rms_n, again.max_n) == (fit.calibration, fit.rms_n, fit.max_n)
    assert dict(zip(shuffled, again.residuals_n, strict=True)) == dict(zip(pairs, fit.residuals_n, strict=True))
    assert 2 <= len(fit.calibration.counts) <= 8
    for (adc, force_n), residual_n in zip(pairs, fit.residuals_n, strict=True):
        if residual_n is None:
            assert adc > 1022.0
        else:
            assert residual_n == pytest.approx(fit.calibration.force_n(adc) - force_n, abs=1e-12)
            assert abs(residual_n) <= fit.max_n


@given(
    st.lists(st.integers(100, 1000), min_size=2, max_size=8, unique=True),
    st.lists(st.floats(0.05, 0.5), min_size=8, max_size=8),
)
def test_few_exact_pairs_are_reproduced(counts, steps_n) -> None:
    counts.sort()
    forces_n = [float(force_n) for force_n in SENSOR_THRESHOLD_N + np.cumsum(steps_n)[: len(counts)]]
    fit = fit_calibration(counts, forces_n)
    assert fit.calibration.counts == tuple(counts)
    assert fit.calibration.forces_n == pytest.approx(forces_n, rel=1e-6)
    assert fit.max_n < 1e-6


@given(st.floats(0.9, 1.1), st.floats(7000.0, 12000.0))
def test_many_exact_pairs_are_approximated_by_eight_knots(exponent, ohm_at_1_n) -> None:
    sensor = Sensor(exponent=exponent, ohm_at_1_n=ohm_at_1_n)
    forces_n = np.geomspace(0.2, 10.0, 100)
    fit = fit_calibration([sensor.counts(force_n) for force_n in forces_n.tolist()], forces_n.tolist())
    assert len(fit.calibration.counts) == 8
    assert (
        max(abs(residual_n or 0.0) / force_n for residual_n, force_n in zip(fit.residuals_n, forces_n, strict=True))
        < 0.06
    )


@pytest.mark.parametrize("seed", range(5))
def test_noisy_pairs_up_and_down_give_the_mean_curve_and_the_hysteresis(seed) -> None:
    rng = np.random.default_rng(seed)
    forces_n = [*KNOWN_FORCES_N, *reversed(KNOWN_FORCES_N)]
    gains = [1.0] * len(KNOWN_FORCES_N) + [SENSOR.unloading_gain] * len(KNOWN_FORCES_N)
    counts = [
        round(SENSOR.counts(force_n * gain) + rng.normal()) for force_n, gain in zip(forces_n, gains, strict=True)
    ]
    fit = fit_calibration(counts, forces_n)
    assert fit.hysteresis == pytest.approx(SENSOR.unloading_gain - 1.0, abs=0.03)
    middle = 0.5 * (1.0 + SENSOR.unloading_gain)
    for force_n in KNOWN_FORCES_N[1:-1]:
        assert fit.calibration.force_n(SENSOR.counts(force_n)) == pytest.approx(force_n / middle, rel=0.05)
    assert fit_calibration(counts[:9], forces_n[:9]).hysteresis is None


def test_the_fit_is_optimal_even_if_noise_would_make_it_decrease() -> None:
    counts, forces_n = [100.0, 200.0, 300.0, 400.0], [1.0, 2.0, 1.8, 3.0]
    fit = fit_calibration(counts, forces_n)

    def cost(heights_n):
        table = Calibration(fit.calibration.counts, tuple(heights_n))
        return sum(
            ((table.force_n(adc) - force_n) / force_n) ** 2 for adc, force_n in zip(counts, forces_n, strict=True)
        )

    best = fit.calibration.forces_n
    # The smallest permitted slope, between the two contradictory pairs.
    assert best[2] - best[1] == pytest.approx(0.01 * 3.0 / 400.0 * 100.0)
    for other in ([0, 1e-3, 1e-3, 0], [0, -1e-3, -1e-3, 0], [1e-3, 0, 0, 0], [0, 0, 0, -1e-3], [0, -1e-3, 1e-3, 0]):
        assert cost(best) < cost([height_n + change for height_n, change in zip(best, other, strict=True)])


def test_pairs_without_force_flatten_the_foot() -> None:
    fit = fit_calibration([0, 20, 25, 200, 400], [0.0, 0.0, 0.0, 0.5, 1.5])
    assert fit.calibration.force_n(25) < 0.02
    assert fit.calibration.force_n(200) == pytest.approx(0.5, abs=0.01)
    assert fit.residuals_n[0] == 0.0


def test_saturated_pairs_are_ignored_and_outliers_have_large_residuals() -> None:
    clean = fit_calibration([200, 400], [0.5, 1.5])
    fit = fit_calibration([1023, 200, 400, 1022.5], [40.0, 0.5, 1.5, 30.0])
    assert fit.calibration == clean.calibration
    assert fit.residuals_n[::3] == (None, None)
    assert fit.max_n < 1e-9
    assert fit_calibration([200, 400, 0], [0.5, 1.5, 5.0]).max_n == 5.0


@pytest.mark.parametrize(
    ("counts", "forces_n", "message"),
    [
        ([], [], r"0 pairs are usable"),
        ([200, 200.2], [1.0, 2.0], "different forces at different counts"),
        ([200, 300], [1.0, 1.0], "two or more different forces"),
        ([0, 0, 300], [0.0, 0.1, 1.0], "1 pairs are usable"),
        ([200, 300], [1.0], "2 counts and 1 forces; it needs a force for each"),
        ([800, 500, 200], [0.5, 1.0, 2.0], "connect the sensor between 5 V and A0"),
        ([200, math.nan], [1.0, 2.0], "pair 2: adc is nan counts; it must be between 0 and 1023 counts"),
        ([200, 1024], [1.0, 2.0], "pair 2: adc is 1024"),
        ([-1, 300], [1.0, 2.0], "pair 1: adc is -1"),
        ([200, 300], [50.0, 200.0], "pair 2: force is 200.0 N; it must be between 0 and 100 N"),
        ([200, 300], [5e-324, 1e-300], "largest force is 1e-300 N; the sensor detects nothing below 0.2 N"),
    ],
)
def test_unusable_pairs_are_refused(counts, forces_n, message) -> None:
    with pytest.raises(SettingsError, match=message):
        fit_calibration(counts, forces_n)
