"""Random effects of a channel compared with their formulas, for fixed seeds."""

import itertools
import math

import numpy as np
import pytest

from hapticnet.channel.settings import BernoulliLoss, GilbertElliottLoss, Jitter

PACKETS = 200_000


def fates(loss, packets=PACKETS, seed=1):
    return np.fromiter(itertools.islice(loss.fates(np.random.default_rng(seed)), packets), dtype=bool)


def burst_lengths(lost):
    return np.array([len(list(group)) for is_lost, group in itertools.groupby(lost.tolist()) if is_lost])


@pytest.mark.parametrize("probability", [0.0, 0.001, 0.2, 1.0])
def test_bernoulli_loses_its_share(probability):
    # Four standard errors of a binomial share.
    tolerance = 4.0 * math.sqrt(probability * (1.0 - probability) / PACKETS)
    lost = fates(BernoulliLoss(probability))
    assert lost.mean() == pytest.approx(probability, abs=tolerance)
    if probability == 0.2:  # losses are independent
        assert burst_lengths(lost).mean() == pytest.approx(1.0 / 0.8, rel=0.02)


def test_gilbert_elliott_mean_is_its_stationary_loss_rate():
    assert GilbertElliottLoss(0.01, 0.3).mean == pytest.approx(0.01 / 0.31)
    assert GilbertElliottLoss(0.01, 0.3, 0.5).mean == pytest.approx(0.5 * 0.01 / 0.31)
    assert GilbertElliottLoss(0.01, 0.3, 0.5, 0.99).mean == pytest.approx((0.5 * 0.01 + 0.01 * 0.3) / 0.31)


@pytest.mark.parametrize("parameters", [(0.01, 0.3), (0.05, 0.1, 0.4), (0.02, 0.5, 0.2, 0.97), (0.9, 0.8)])
def test_gilbert_elliott_loses_its_stationary_share(parameters):
    loss = GilbertElliottLoss(*parameters)
    assert fates(loss).mean() == pytest.approx(loss.mean, rel=0.06)


def test_gilbert_elliott_bursts_last_one_over_r():
    lengths = burst_lengths(fates(GilbertElliottLoss(0.01, 0.25)))
    assert lengths.mean() == pytest.approx(4.0, rel=0.05)
    # A stay in a Markov state is geometric: the share of bursts of one packet is r.
    assert (lengths == 1).mean() == pytest.approx(0.25, abs=0.03)


def test_gilbert_elliott_starts_in_its_stationary_distribution():
    loss = GilbertElliottLoss(0.1, 0.1)
    first = [fates(loss, packets=1, seed=seed)[0] for seed in range(2000)]
    assert np.mean(first) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("loss", "lost"),
    [
        (GilbertElliottLoss(0.5, 0.0), True),
        (GilbertElliottLoss(0.0, 0.5), False),
        (GilbertElliottLoss(1.0, 0.0, 0.0), True),
    ],
)
def test_gilbert_elliott_with_a_state_that_is_never_left(loss, lost):
    assert (fates(loss, packets=5000) == lost).all()
    assert loss.mean == lost


@pytest.mark.parametrize(
    ("jitter", "mean_in_deviations"),
    [
        (Jitter(distribution="uniform", deviation_us=5000), math.sqrt(3.0)),
        (Jitter(distribution="normal", deviation_us=5000), math.sqrt(2.0 / math.pi / (1.0 - 2.0 / math.pi))),
        (Jitter(distribution="pareto", deviation_us=5000), math.sqrt(1.0 / 3.0)),
    ],
)
def test_jitter_has_its_deviation_and_mean_and_is_never_negative(jitter, mean_in_deviations):
    delays_us = np.fromiter(itertools.islice(jitter.delays_us(np.random.default_rng(1)), PACKETS), dtype=float)
    assert delays_us.min() >= 0.0
    if jitter.distribution == "uniform":
        assert delays_us.max() == pytest.approx(2.0 * math.sqrt(3.0) * 5000.0, abs=5.0)
    assert delays_us.mean() == pytest.approx(5000.0 * mean_in_deviations, rel=0.01)
    # The fourth moment of a Pareto distribution of shape 3 does not exist: its sample deviation settles slowly.
    assert delays_us.std() == pytest.approx(5000.0, rel=0.15 if jitter.distribution == "pareto" else 0.02)


def test_pareto_jitter_has_the_tail_of_its_shape():
    jitter = Jitter(distribution="pareto", deviation_us=5000)
    delays_us = np.fromiter(itertools.islice(jitter.delays_us(np.random.default_rng(1)), PACKETS), dtype=float)
    scale_us = 5000.0 * 2.0 * math.sqrt(1.0 / 3.0)
    for multiple in (1.0, 3.0, 10.0):
        assert (delays_us > multiple * scale_us).mean() == pytest.approx((1.0 + multiple) ** -3.0, rel=0.1)
