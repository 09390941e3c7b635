"""Statistics of small samples of participants: intervals of shares, exact sign-flip tests, and equivalence."""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.errors import SettingsError
from hapticnet.experiment.summary import t_quantile

CONFIDENCE: Final = 0.95
Z: Final = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0)
ALPHA: Final = 0.05  # probability below which a test counts as passed
FINEST: Final = 1 / 5040  # finest grid on which differences are exact: shares of up to 10 trials and most other numbers
MOST_CELLS: Final = 500_000  # largest table of sums for exact differences
COARSE_CELLS: Final = 20_000  # the same for differences that fit no grid and are rounded to the safe side
LIMIT_SHARE: Final = 1e-12


def wilson(share: float, trials: float, z: float = Z) -> tuple[float, float]:
    """Return Wilson's interval of a share of trials; `z` is the two-sided quantile for its confidence.

    Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
    """
    centre = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    # At the ends the interval touches 0 or 1, which rounding would miss.
    return (centre - half if share > 0.0 else 0.0), (centre + half if share < 1.0 else 1.0)


def share_interval(successes: int, trials: int, shares: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Return the interval of the share that participants like these would reach; without trials, 0 to 1.

    It is Wilson's with the number of independent trials that would give the standard error over participants, no more
    than there were, and with Student's t: E. L. Korn & B. I. Graubard, "Confidence intervals for proportions with small
    expected number of positive counts estimated from survey data", Survey Methodology 24 (1998). Wilson's interval over
    all trials is too narrow, because those of one participant are similar. `shares` are the participants', shape (n,).
    """
    if trials == 0 or len(shares) < 2:
        return 0.0, 1.0
    share, error = successes / trials, standard_error(shares) or 0.0
    independent = min(trials, share * (1.0 - share) / error**2) if error else trials
    return wilson(share, independent, t_quantile(len(shares) - 1))


def standard_error(values: Sequence[float] | FloatArray) -> float | None:
    """Return the standard error of the mean over participants, with n − 1; None for fewer than two."""
    if len(values) < 2:
        return None
    return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def sign_flip(differences: Sequence[float] | FloatArray, *, shift: float = 0.0) -> tuple[float, float]:
    """Return the exact probabilities that the mean difference would be as low, and as high, as it is.

    Under the null hypothesis, the participants' differences, shape (n,), less `shift` are symmetric about 0. All 2ⁿ
    assignments of signs are counted, by adding one participant after the other to the distribution of the sum, on a
    grid so fine that scores are exact. Without a difference, both are 1. `two_sided` combines them.
    """
    values = np.asarray(differences, dtype=np.float64) - shift
    if not np.isfinite(values).all():
        raise SettingsError("a difference is not finite")
    total = float(np.abs(values).sum())
    if not len(values) or total <= LIMIT_SHARE:
        return 1.0, 1.0
    fine = np.abs(values) / FINEST
    exact = np.abs(fine - np.rint(fine)).max() < 1e-6 and 2.0 * fine.sum() < MOST_CELLS
    steps = np.rint(fine if exact else np.abs(values) * COARSE_CELLS / (2.0 * total)).astype(np.int64)
    if exact:
        steps //= np.gcd.reduce(steps)
    size = int(steps.sum())
    chances = np.zeros(2 * size + 1)
    chances[size] = 1.0
    for step in filter(None, steps.tolist()):
        part = 0.5 * chances
        chances[:-step] = part[step:]
        chances[-step:] = 0.0
        chances[step:] += part[:-step]
    seen = size + int(np.where(values < 0.0, -steps, steps).sum())
    # A sum that equals the observed one except for rounding to the grid counts on both sides.
    slack = 0 if exact else len(values)
    low_tail = float(chances[: min(seen + slack, 2 * size) + 1].sum())
    high_tail = float(chances[max(seen - slack, 0) :].sum())
    return min(low_tail, 1.0), min(high_tail, 1.0)


def two_sided(tails: tuple[float, float]) -> float:
    """Return the two-sided probability of a symmetric test: twice the smaller tail."""
    return min(1.0, 2.0 * min(tails))


def mean_interval(
    differences: Sequence[float] | FloatArray, confidence: float = CONFIDENCE, *, least_variance: float = 0.0
) -> tuple[float, float]:
    """Return Student's interval of the mean difference over participants; infinite if the spread is unknown.

    `least_variance` is that of one participant's difference by chance alone, see `chance_variance`: scores of few
    trials have ties, and their estimated spread may be much too small or zero.
    """
    values = np.asarray(differences, dtype=np.float64)
    if len(values) < 2:
        return -math.inf, math.inf
    variance = max(float(values.var(ddof=1)), least_variance)
    if variance <= LIMIT_SHARE:
        return -math.inf, math.inf
    middle = float(values.mean())
    half = t_quantile(len(values) - 1, confidence) * math.sqrt(variance / len(values))
    return middle - half, middle + half


def chance_variance(successes: int, trials: int, people: int) -> float:
    """Return the variance of one participant's share by chance alone, in one condition of all participants.

    The share is taken with two more successes and two more failures, so that it is never 0 or 1: A. Agresti & B. A.
    Coull, The American Statistician 52 (1998).
    """
    share = (successes + 2) / (trials + 4)
    return share * (1.0 - share) * people / trials


def equivalence(
    differences: Sequence[float] | FloatArray, margin: float, *, least_variance: float = 0.0
) -> tuple[float, tuple[float, float], bool]:
    """Test whether a mean difference is within a margin that was stated beforehand; two one-sided tests at 5 %.

    Schuirmann, "A comparison of the two one-sided tests procedure and the power approach", Journal of Pharmacokinetics
    and Biopharmaceutics 15 (1987), here with sign-flip tests.

    Return the probability of the tests, the 90 % interval (`mean_interval`, which explains `least_variance`), and
    whether equivalence is shown: the tests pass, and the interval, which allows for chance ties, is within the margin.
    """
    probability = max(sign_flip(differences, shift=-margin)[1], sign_flip(differences, shift=margin)[0])
    low, high = mean_interval(differences, 0.90, least_variance=least_variance)
    return probability, (low, high), probability < ALPHA and -margin <= low and high <= margin


def holm(probabilities: Sequence[float]) -> list[float]:
    """Return probabilities adjusted for several tests (Holm, Scandinavian Journal of Statistics 6, 1979)."""
    order = np.argsort(probabilities)
    adjusted, worst = [0.0] * len(probabilities), 0.0
    for place, index in enumerate(order.tolist()):
        worst = max(worst, min(1.0, (len(probabilities) - place) * probabilities[index]))
        adjusted[index] = worst
    return adjusted
