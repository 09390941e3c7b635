"""Power of a study and widths of its intervals, by simulation of many experiments. Nothing here comes from people."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_integer, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.study.analysis import MARGIN
from hapticnet.study.statistics import ALPHA, chance_variance, equivalence, mean_interval, sign_flip, two_sided

SHARE_SPREAD: Final = 0.7
"""Standard deviation over participants of the log odds of a correct order. An assumption; the paper's standard errors
(5 to 7.5 % of 8 participants) are slightly above those of 10 trials each without any."""

CHUNK: Final = 100  # experiments simulated at a time
LEAST_EFFECT: Final = 0.03
NO_EFFECT: Final = (
    "These shares hardly differ between conditions, so no number of participants finds a difference. Choose the number"
    " with --shares and the smallest fall that matters to you."
)


@dataclass(frozen=True, slots=True)
class ShareAnswers:
    """Participants who are right in given shares of the trials; the first condition is the reference."""

    conditions: tuple[str, ...]
    shares: tuple[float, ...]
    spread: float = SHARE_SPREAD

    def __post_init__(self) -> None:
        if len(self.conditions) != len(self.shares):
            raise SettingsError(f"{len(self.shares)} shares are given for {len(self.conditions)} conditions")
        for share in self.shares:
            check_parameter("share of correct orders", share, 0.01, 0.99)

    def scores(self, experiments: int, people: int, trials: int, rng: np.random.Generator) -> FloatArray:
        """Return the share of correct orders, shape (experiments, people, conditions)."""
        own = rng.normal(0.0, self.spread, (experiments, people, 1))
        chances = 1.0 / (1.0 + np.exp(-(own + [_log_odds(share, self.spread) for share in self.shares])))
        scores: FloatArray = rng.binomial(trials, chances) / trials
        return scores


def _log_odds(share: float, spread: float) -> float:
    nodes, weights = np.polynomial.hermite_e.hermegauss(31)
    weights = weights / weights.sum()
    low, high = -10.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        mean = float((weights / (1.0 + np.exp(-(middle + spread * nodes)))).sum())
        low, high = (middle, high) if mean < share else (low, middle)
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class Power:
    """A design's findings about one condition; differences are from the first one, for which they are 0."""

    participants: int
    trials: int  # of each condition
    condition: str
    share: float  # mean share of correct orders over experiments
    low: float  # range of 95 % of the experiments
    high: float
    difference: float  # mean
    power: float  # share of experiments in which the sign-flip test finds a difference at 5 %
    equivalent: float  # share of experiments that show equivalence within the margin
    half_width: float  # mean, of the 95 % interval of the difference


def power(
    answers: ShareAnswers,
    designs: Sequence[tuple[int, int]],
    *,
    experiments: int = 2000,
    margin: float = MARGIN,
    seed: int = 1,
    on_design: Callable[[int, int], None] = lambda _participants, _trials: None,
) -> list[Power]:
    """Simulate experiments of each design (participants, trials of each condition) and return the findings.

    `on_design` is called with each design before it is simulated. Raise SettingsError if a number is out of range.
    """
    check_integer("number of experiments", experiments, 100, 1_000_000)
    check_parameter("margin", margin, 0.001, 1.0)
    for people, trials in designs:
        check_integer("number of participants", people, 2, 1000)
        check_integer("number of trials", trials, 1, 1000)
    found: list[Power] = []
    for people, trials in designs:
        on_design(people, trials)
        chunks = range((experiments + CHUNK - 1) // CHUNK)
        simulated = [_simulate(answers, people, trials, margin, [seed, people, trials, each]) for each in chunks]
        shares, *others = np.concatenate(simulated, axis=1)
        mean, (low, high) = shares.mean(axis=0), np.quantile(shares, [0.025, 0.975], axis=0)
        figures = np.stack([mean, low, high, mean - mean[0], *(each.mean(axis=0) for each in others)], axis=1)
        rows = zip(answers.conditions, figures.tolist(), strict=True)
        found += [Power(people, trials, name, *figures_of_one) for name, figures_of_one in rows]
    return found


def _simulate(answers: ShareAnswers, people: int, trials: int, margin: float, seed: Sequence[int]) -> FloatArray:
    """Return mean shares, differences found, equivalences shown and half widths, shape (4, `CHUNK`, conditions)."""
    scores = answers.scores(CHUNK, people, trials, np.random.default_rng(seed))
    found = np.zeros((4, CHUNK, scores.shape[2]))
    found[0] = scores.mean(axis=1)
    right = np.rint(trials * scores.sum(axis=1)).astype(int).tolist()
    for experiment, own in enumerate(scores):
        for condition in range(1, own.shape[1]):
            differences = own[:, condition] - own[:, 0]
            least = sum(chance_variance(right[experiment][each], people * trials, people) for each in (0, condition))
            *_, shown = equivalence(differences, margin, least_variance=least)
            low, high = mean_interval(differences, least_variance=least)
            found[1:, experiment, condition] = (two_sided(sign_flip(differences)) < ALPHA, shown, 0.5 * (high - low))
    return found


def lines(found: Sequence[Power], source: str) -> list[str]:
    """Return the table for a terminal, one block for each design."""
    told = [f"SIMULATED, {source}: power of exact sign-flip tests at 5 %, each condition against the first", ""]
    for (people, trials), group in groupby(found, key=lambda each: (each.participants, each.trials)):
        told.append(f"{people} participants, {trials} trials of each condition")
        told.append("  condition        correct [95 % of experiments]  difference  power  equivalent  half width")
        for number, each in enumerate(group):
            share = f"{100 * each.share:5.1f} % [{100 * each.low:.0f}, {100 * each.high:.0f}]"
            compared = (
                f"{100 * each.difference:+9.1f}  {100 * each.power:4.0f} %  {100 * each.equivalent:8.0f} %"
                f"  {100 * each.half_width:10.1f}"
            )
            told.append(f"  {each.condition:<16} {share:<28} {compared if number else ''}".rstrip())
        told.append("")
    if all(abs(each.difference) < LEAST_EFFECT for each in found):
        told += [NO_EFFECT, ""]
    return told[:-1]
