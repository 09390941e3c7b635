"""Every measure of quality against its own definition, worked out by hand or sample by sample."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hapticnet.measure.quality import (
    QualityReport,
    created_energy_j,
    fechner_scale,
    perceptual_distances,
    quality_report,
)
from hapticnet.perception import WeberLaw

LAW = WeberLaw(weber_fraction=0.1, floor_n=0.05)  # F₀ = 0.5 N
T_US = np.arange(4, dtype=np.int64) * 1000
NONE_SENT = np.empty(0, dtype=np.int64)

components = st.floats(-9.0, 9.0, allow_subnormal=False)
pairs = st.integers(1, 3).flatmap(
    lambda axes: npst.arrays(np.float64, st.tuples(st.just(2), st.integers(0, 12), st.just(axes)), elements=components)
)


def column(*values):
    return np.array(values)[:, np.newaxis]


def report(true, applied, sent=(0,), **others) -> QualityReport:
    t_us = np.arange(len(true), dtype=np.int64) * 1000
    return quality_report(LAW, t_us, true, applied, np.array(sent, dtype=np.int64), **others)


def test_psnr_is_of_the_largest_true_norm():
    result = report(np.array([[3.0, 4.0], [0.0, 0.0]]), np.array([[3.0, 3.9], [0.0, 0.3]]))
    assert result.peak_n == 5.0
    assert result.psnr_db == pytest.approx(10 * math.log10(25.0 / ((0.01 + 0.09) / 2)))


def test_hpw_psnr_equals_psnr_where_nothing_can_be_felt_and_falls_below_it_by_what_can():
    unfelt = report(column(1.0, 2.0), column(1.05, 2.1))
    assert unfelt.exceed_jnd_fraction == 0.0
    assert unfelt.hpw_psnr_db == unfelt.psnr_db
    # Three JNDs from 1 N once, so that error counts three times.
    felt = report(column(1.3, 2.0), column(1.0, 2.0))
    assert felt.psnr_db - felt.hpw_psnr_db == pytest.approx(10 * math.log10(3.0))


def test_ratios_are_infinite_where_nothing_differs_and_without_a_signal():
    assert report(column(1.0, 2.0), column(1.0, 2.0)).psnr_db == math.inf
    assert report(column(0.0, 0.0), column(0.0, 0.0)).hpw_psnr_db == math.inf
    assert report(column(0.0, 0.0), column(0.0, 1.0)).psnr_db == -math.inf


@given(st.floats(0.0, 9.0), st.floats(1e-9, 1e-3))
def test_the_scale_grows_by_one_per_jnd(magnitude, share):
    low, high = fechner_scale(LAW, np.array([magnitude, magnitude + share * LAW.jnd_n(magnitude)]))
    assert high - low == pytest.approx(share, rel=1e-3, abs=1e-12)


def test_the_scale_is_linear_to_where_floor_and_weber_meet_and_fechners_logarithm_beyond():
    scale = fechner_scale(LAW, np.array([0.0, 0.25, 0.5, 0.5 * math.e]))
    assert scale == pytest.approx([0.0, 5.0, 10.0, 20.0])
    assert fechner_scale(WeberLaw(weber_fraction=0.0, floor_n=0.5), np.array([3.0])).tolist() == [6.0]


@given(pairs)
def test_perceptual_distance_is_symmetric_and_zero_only_where_nothing_differs(pair):
    there, back = perceptual_distances(LAW, *pair), perceptual_distances(LAW, *pair[::-1])
    assert there.tolist() == pytest.approx(back.tolist())
    differ = np.abs(pair[0] - pair[1]).max(axis=1, initial=0.0)
    # A change of direction is computed from squared norms, which have half the digits.
    assert (there[differ == 0.0] <= 1e-5).all()
    assert (there[differ > 1e-5] > 0.0).all()


@pytest.mark.parametrize("size", [0.2, 3.0])
@pytest.mark.parametrize("angle", [0.0, 1.0, math.pi / 2, math.pi])
def test_one_jnd_is_about_one_unit_in_any_direction(size, angle):
    reference = np.array([[size, 0.0]])
    moved = reference + LAW.jnd_n(size) * np.array([[math.cos(angle), math.sin(angle)]])
    assert perceptual_distances(LAW, moved, reference)[0] == pytest.approx(1.0, rel=0.06)


def test_perceptual_mse_of_one_axis_is_of_the_difference_on_the_scale():
    result = report(column(0.5 * math.e, 0.1), column(0.5, 0.0))
    assert result.perceptual_mse == pytest.approx((10.0**2 + 2.0**2) / 2)
    # Across zero both are counted from it.
    assert report(column(0.1), column(-0.1)).perceptual_mse == pytest.approx(4.0**2)
    bare = quality_report(WeberLaw(floor_n=0.0), T_US, *[np.ones((4, 1))] * 2, NONE_SENT)
    assert bare.perceptual_mse is None


def test_jumps_are_in_jnds_of_what_was_felt_before_and_apart_at_updates():
    applied = column(5.0, 1.0, 1.2, 1.2, 1.0)
    result = report(applied, applied, [0, 1, 4])
    assert result.jump_max_jnd == pytest.approx(8.0)
    assert result.jump_mean_jnd == pytest.approx((8.0 + 2.0 + 0.0 + 0.2 / 0.12) / 4)
    assert result.send_jump_mean_jnd == pytest.approx((8.0 + 0.2 / 0.12) / 2)
    assert result.send_jump_max_jnd == result.send_jump_p999_jnd == result.jump_p999_jnd == result.jump_max_jnd


def test_a_jump_from_where_the_jnd_is_zero_is_infinite_and_staying_there_is_none():
    law = WeberLaw(floor_n=0.0)
    still = quality_report(law, T_US, np.zeros((4, 1)), np.zeros((4, 1)), np.array([0]))
    assert (still.jump_max_jnd, still.hpw_psnr_db) == (0.0, math.inf)
    rising = quality_report(law, T_US, column(0.0, 1.0, 1.0, 1.0), column(0.0, 0.0, 1.0, 1.0), np.array([0, 2]))
    assert (rising.jump_max_jnd, rising.hpw_psnr_db) == (math.inf, -math.inf)


def test_age_counts_from_the_newest_update_that_was_received():
    zeros = np.zeros((6, 1))
    result = report(zeros, zeros, [1, 3, 4])
    assert result.age_mean_us == pytest.approx((0 + 1000 + 0 + 0 + 1000) / 5)
    assert result.age_max_us == result.age_p99_us == 1000.0
    lossy = report(zeros, zeros, [1, 3, 4], received=np.array([1, 4]))
    assert lossy.age_max_us == 2000.0
    assert lossy.packet_rate_p999_hz == result.packet_rate_p999_hz


def test_packet_rate_is_of_100_ms():
    samples = 2000
    steady = np.arange(0, samples, 10)
    burst = np.concatenate([steady[steady < 1000], np.arange(1000, 1020), steady[steady >= 1020]])
    zeros = np.zeros((samples, 1))
    assert report(zeros, zeros, steady).packet_rate_p999_hz == 100.0
    result = report(zeros, zeros, burst)
    assert result.worst_100ms_packets == 28
    assert result.packet_rate_p999_hz == 280.0


def test_energy_is_created_where_pushing_in_meets_less_force_and_pulling_out_more():
    position = column(0.0, 0.01, 0.02, 0.01, 0.0)
    spring = 100.0 * position
    weaker_in_stronger_out = spring + column(-0.1, -0.1, 0.1, 0.1, 0.1)
    energy = created_energy_j(spring, weaker_in_stronger_out, position)
    assert energy == pytest.approx([1e-3, 2e-3, 3e-3, 4e-3])
    result = report(spring, weaker_in_stronger_out, positions=position)
    assert (result.energy_final_j, result.energy_peak_j) == pytest.approx((4e-3, 4e-3))
    assert report(spring, spring).energy_final_j is report(spring, spring).energy_peak_j is None
    reverse = report(spring, 2 * spring - weaker_in_stronger_out, positions=position)
    assert (reverse.energy_final_j, reverse.energy_peak_j) == pytest.approx((-4e-3, 0.0))


@given(pairs, st.integers(0, 2**32 - 1))
def test_energy_is_the_work_of_the_applied_force_less_that_of_the_true_one(pair, seed):
    true, applied = pair
    position = np.random.default_rng(seed).normal(0.0, 0.1, true.shape)

    def work_on_operator(force):
        return sum(
            -float(f @ (after - before)) for f, before, after in zip(force, position, position[1:], strict=False)
        )

    result = report(true, applied, sent=[0] if len(true) else [], positions=position)
    assert result.energy_final_j == pytest.approx(work_on_operator(applied) - work_on_operator(true), abs=1e-9)
    assert result.energy_peak_j >= max(result.energy_final_j, 0.0)


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("samples", [0, 1])
def test_hardly_any_samples_make_a_whole_report(samples, axes):
    true = np.ones((samples, axes))
    result = report(true, true, range(samples), positions=true)
    assert result.psnr_db == math.inf
    others = dataclasses.asdict(dataclasses.replace(result, psnr_db=0.0, hpw_psnr_db=0.0, peak_n=0.0))
    assert set(others.values()) <= {0, 10.0, 1}
