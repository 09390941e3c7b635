"""Power of a study and widths of its intervals, by simulation of many experiments. Nothing here is of people."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final, TypeAlias

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_integer, check_parameter
from hapticnet.errors import SettingsError
from hapticnet.experiment.workers import workers
from hapticnet.study.analysis import MARGIN
from hapticnet.study.library import Felt
from hapticnet.study.observers import ObserverSettings, judged
from hapticnet.study.statistics import (
    ALPHA,
    chance_variance,
    equivalence,
    leaving_point,
    mean_interval,
    shows_equivalence,
    sign_flip,
    two_sided,
)

SHARE_SPREAD: Final = 0.7
"""Standard deviation over participants of the log odds of a correct order. An assumption; the paper's standard errors
(5 to 7.5 % of 8 participants) are a little above what 10 trials each give without any."""

WIDTHS: Final = 100
"""Experiments in which intervals are computed; they take longer than tests."""

CHUNK: Final = 100
"""Experiments that one process simulates at a time."""


LEAST_EFFECT: Final = 0.03
NO_EFFECT: Final = (
    "These answers hardly differ between conditions, so no number of participants finds a difference. Choose the number"
    " with --shares and the smallest fall that matters to you."
)


@dataclass(frozen=True, slots=True)
class ObserverAnswers:
    """Scores of a simulated observer who feels what was played through the chain."""

    library: tuple[Felt, ...]
    observer: ObserverSettings

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the conditions."""
        return tuple(felt.condition for felt in self.library)

    @property
    def multipliers(self) -> tuple[float, ...]:
        """Their thresholds in JNDs."""
        return tuple(felt.multiplier for felt in self.library)

    def scores(self, experiments: int, people: int, trials: int, rng: np.random.Generator) -> FloatArray:
        """Return the share of correct orders, shape (experiments, people, conditions)."""
        factor = np.exp(rng.normal(0.0, self.observer.spread, (experiments, people)))
        factor = np.repeat(factor.reshape(-1, 1), trials, axis=0)
        shares = [
            right_orders(self.observer, felt, len(factor), rng, factor=factor)
            .reshape(experiments, people, trials)
            .mean(axis=2)
            for felt in self.library
        ]
        return np.stack(shares, axis=2)


@dataclass(frozen=True, slots=True)
class ShareAnswers:
    """Scores of participants who are right in given shares of the trials, such as the paper's."""

    conditions: tuple[str, ...]
    multipliers: tuple[float, ...]
    shares: tuple[float, ...]
    spread: float = SHARE_SPREAD

    def __post_init__(self) -> None:
        if not len(self.conditions) == len(self.multipliers) == len(self.shares):
            raise SettingsError(f"{len(self.shares)} shares are given for {len(self.conditions)} conditions")
        for share in self.shares:
            check_parameter("share of correct orders", share, 0.01, 0.99)

    def scores(self, experiments: int, people: int, trials: int, rng: np.random.Generator) -> FloatArray:
        """Return the share of correct orders, shape (experiments, people, conditions)."""
        own = rng.normal(0.0, self.spread, (experiments, people, 1))
        chances = 1.0 / (1.0 + np.exp(-(own + [_log_odds(share, self.spread) for share in self.shares])))
        scores: FloatArray = rng.binomial(trials, chances) / trials
        return scores


Answers: TypeAlias = ObserverAnswers | ShareAnswers
"""Where simulated scores come from; the first condition is the reference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Power:
    """What a design of a study finds about one condition. `left_at` is the same for every condition."""

    participants: int
    trials: int  # of each condition
    condition: str
    share: float  # mean share of correct orders over experiments
    low: float  # range of 95 % of the experiments
    high: float
    difference: float  # mean difference to the reference; 0 for the reference itself
    power: float  # share of experiments in which the sign-flip test finds a difference at 5 %
    equivalent: float  # share of experiments that show equivalence within the margin
    half_width: float  # mean, of the 95 % interval of the difference
    left_at: float  # median of the point at which the curve leaves the margin; NaN unless most experiments find one
    left_spread: float  # half the range of 95 % of these points


def right_orders(
    observer: ObserverSettings,
    felt: Felt,
    trials: int,
    rng: np.random.Generator,
    *,
    factor: FloatArray | float = 1.0,
) -> FloatArray:
    """Return for each of so many trials of a condition 1 if the whole order is right, else 0, shape (trials,)."""
    drawn = rng.integers(len(felt.steps), size=trials)
    cues = felt.cues[observer.cue][drawn]
    orders = judged(observer, cues, felt.updates[drawn], felt.steps[drawn], felt.counts[drawn], rng, factor=factor)
    right: FloatArray = (orders == np.arange(cues.shape[1])).all(axis=1).astype(np.float64)
    return right


def power(
    answers: Answers,
    designs: Sequence[tuple[int, int]],
    *,
    experiments: int = 2000,
    margin: float = MARGIN,
    seed: int = 1,
    jobs: int = 1,
    on_design: Callable[[int, int], None] = lambda _participants, _trials: None,
) -> list[Power]:
    """Simulate experiments of each design and return what they find.

    Parameters
    ----------
    designs
        Pairs of participants and trials of each condition.
    jobs
        Processes; the result does not depend on it.
    on_design
        Called with each design before it is simulated.

    Raises
    ------
    SettingsError
        If a number is out of range.
    """
    check_integer("number of experiments", experiments, 100, 1_000_000)
    check_parameter("margin", margin, 0.001, 1.0)
    for participants, trials in designs:
        check_integer("number of participants", participants, 2, 1000)
        check_integer("number of trials", trials, 1, 1000)
    found: list[Power] = []
    with workers(jobs, (answers, margin, seed)) as run:
        for participants, trials in designs:
            on_design(participants, trials)
            chunks = [(participants, trials, chunk) for chunk in range((experiments + CHUNK - 1) // CHUNK)]
            found += _summary(answers, participants, trials, list(run(_simulate, chunks)))
    return found


@dataclass(frozen=True, slots=True)
class _Chunk:
    shares: FloatArray
    found: FloatArray
    equivalent: FloatArray
    half_widths: FloatArray
    left_at: FloatArray


def _simulate(shared: tuple[Answers, float, int], task: tuple[int, int, int]) -> _Chunk:
    (answers, margin, seed), (participants, trials, chunk) = shared, task
    rng = np.random.default_rng([seed, participants, trials, chunk])
    scores = answers.scores(CHUNK, participants, trials, rng)
    differences = scores - scores[:, :, :1]
    conditions = scores.shape[2]
    found, equal = np.zeros((CHUNK, conditions)), np.zeros((CHUNK, conditions))
    widths = max(WIDTHS // 20, 1) if chunk < 20 else 0
    half_widths = np.full((widths, conditions), np.nan)
    for experiment in range(CHUNK):
        for condition in range(1, conditions):
            own = differences[experiment, :, condition]
            found[experiment, condition] = two_sided(sign_flip(own)) < ALPHA
            right = np.rint(trials * scores[experiment].sum(axis=0)).astype(int).tolist()
            least = sum(chance_variance(right[each], participants * trials, participants) for each in (0, condition))
            within, interval_90 = equivalence(own, margin, least_variance=least)
            equal[experiment, condition] = shows_equivalence(within, interval_90, margin)
            if experiment < widths:
                low, high = mean_interval(own, least_variance=least)
                half_widths[experiment, condition] = 0.5 * (high - low)
    left_at = np.full(widths, np.nan)
    along = np.argsort(answers.multipliers)
    values = np.array(answers.multipliers)[along]
    if len(values) > 2 and (np.diff(values) > 0.0).all():
        for experiment in range(widths):
            point = leaving_point(values.tolist(), scores[experiment][:, along], margin, rng, resamples=2)
            left_at[experiment] = np.inf if point.at is None else point.at
    return _Chunk(scores.mean(axis=1), found, equal, half_widths, left_at)


def _summary(answers: Answers, participants: int, trials: int, chunks: Sequence[_Chunk]) -> list[Power]:
    shares = np.concatenate([chunk.shares for chunk in chunks])
    found, equal = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in ("found", "equivalent"))
    half_widths = np.concatenate([chunk.half_widths for chunk in chunks])
    left_at = np.concatenate([chunk.left_at for chunk in chunks])
    low, high = np.quantile(shares, [0.025, 0.975], axis=0)
    left = np.quantile(left_at, [0.025, 0.5, 0.975], method="inverted_cdf") if len(left_at) else np.full(3, np.nan)
    mean = shares.mean(axis=0)
    return [
        Power(
            participants=participants,
            trials=trials,
            condition=name,
            share=float(mean[index]),
            low=float(low[index]),
            high=float(high[index]),
            difference=float(mean[index] - mean[0]),
            power=float(found[:, index].mean()) if index else 0.0,
            equivalent=float(equal[:, index].mean()) if index else 0.0,
            half_width=float(half_widths[:, index].mean()) if index else 0.0,
            left_at=float(left[1]) if np.isfinite(left[1]) else float("nan"),
            left_spread=float(0.5 * (left[2] - left[0])) if np.isfinite(left[1]) else float("nan"),
        )
        for index, name in enumerate(answers.conditions)
    ]


def _log_odds(share: float, spread: float) -> float:
    """Return the mean log odds of participants whose mean share is given."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(31)
    weights = weights / weights.sum()
    low, high = -10.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        mean = float((weights / (1.0 + np.exp(-(middle + spread * nodes)))).sum())
        low, high = (middle, high) if mean < share else (low, middle)
    return 0.5 * (low + high)


def lines(found: Sequence[Power], source: str) -> list[str]:
    """Return the table for a terminal, one block for each design."""
    told = [f"SIMULATED, {source}: power of exact sign-flip tests at 5 %, each condition against the first", ""]
    for (people, trials), group in groupby(found, key=lambda each: (each.participants, each.trials)):
        own = list(group)
        told.append(f"{people} participants, {trials} trials of each condition")
        told.append("  condition        correct [95 % of experiments]  difference  power  equivalent  half width")
        for each in own:
            share = f"{100 * each.share:5.1f} % [{100 * each.low:.0f}, {100 * each.high:.0f}]"
            if each is own[0]:
                told.append(f"  {each.condition:<16} {share:<28}")
                continue
            width = f"{100 * each.half_width:.1f}"
            told.append(
                f"  {each.condition:<16} {share:<28} {100 * each.difference:+9.1f}  {100 * each.power:4.0f} %"
                f"  {100 * each.equivalent:8.0f} %  {width:>10}"
            )
        if math.isfinite(own[0].left_at):
            spread = f" ± {own[0].left_spread:.1f}" if math.isfinite(own[0].left_spread) else ""
            told.append(f"  the curve leaves the margin at {own[0].left_at:.1f}{spread} JND (median, half of 95 %)")
        told.append("")
    if all(abs(each.difference) < LEAST_EFFECT for each in found):
        told += [NO_EFFECT, ""]
    return told[:-1]
