"""What an analysis of the ordering task finds: figures of conditions, and comparisons between them."""

from dataclasses import dataclass
from typing import Final

from hapticnet.study.statistics import Leaving

CHANCE: Final = 1 / 6
"""Share of correct orders by guessing."""

MARGIN: Final = 0.1
"""Default margin of equivalence: the plan's, which is stated before the study."""

PAPER_ERRORS: Final = {"none": 0.075, "1 JND": 0.056, "2 JND": 0.049, "4 JND": 0.065}
"""Standard errors of the share of correct orders in Fig. 5 of "Cutaneous haptic deadband compression"."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A measure of one condition.

    Attributes
    ----------
    mean
        Mean over participants; None without data.
    error
        Standard error over participants, n − 1.
    each
        The figure of each participant, in their order; NaN where missing.
    """

    mean: float | None
    error: float | None
    each: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionResult:
    """What participants did under one condition.

    Attributes
    ----------
    name, codec, multiplier
        As in the plan.
    trials, correct
        Trials answered, and those with the whole order right.
    interval
        95 % interval of that share over participants.
    figures
        The figures of `MEASURES` by name.
    pair_shares
        Share of right answers for each pair of tissues, by the rank of stiffness: softest–middle, middle–hardest,
        softest–hardest.
    pair_intervals
        Their 95 % intervals over participants.
    paper_correct, paper_error, paper_byte_reduction
        The paper's figures for the condition of this name; None without one.
    """

    name: str
    codec: str
    multiplier: float
    trials: int
    correct: int
    interval: tuple[float, float]
    figures: dict[str, Figure]
    pair_shares: tuple[float, ...]
    pair_intervals: tuple[tuple[float, float], ...]
    paper_correct: float | None
    paper_error: float | None
    paper_byte_reduction: float | None

    @property
    def share(self) -> float:
        """Share of correct orders."""
        return self.correct / self.trials if self.trials else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A condition less the reference, over participants.

    Attributes
    ----------
    measure
        The compared measure, a key of `MEASURES`.
    difference, interval
        Mean difference and its 95 % interval over participants.
    probability, adjusted
        Two-sided probability of the exact sign-flip test, and after Holm for the comparisons of this measure.
    within_margin, interval_90
        Probability of the two one-sided tests of equivalence, and the 90 % interval that belongs to them; None for a
        measure without a margin.
    equivalent
        Whether tests and interval both show equivalence; None for a measure without a margin.
    participants
        Number of participants with both conditions.
    """

    measure: str
    condition: str
    reference: str
    difference: float
    interval: tuple[float, float]
    probability: float
    adjusted: float
    within_margin: float | None
    interval_90: tuple[float, float] | None
    equivalent: bool | None
    participants: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictor:
    """How well an objective measure predicts the quality of experience.

    Attributes
    ----------
    name
        The measure.
    correlation
        Correlation with the ratings, both about the mean of their participant.
    probability
        Two-sided probability of the exact sign-flip test of each participant's covariance.
    predicted
        Share of the variance of a participant's ratings that a line fitted to the others predicts; negative if it is
        worse than the participant's mean, NaN with one participant.
    participants
        Participants with at least two ratings.
    """

    name: str
    correlation: float
    probability: float
    predicted: float
    participants: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UsedLaw:
    """What 1 JND was for a participant: Weber fraction, smallest JND [N], and where they come from."""

    participant: str
    weber_fraction: float
    floor_n: float
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """Results of a study.

    Attributes
    ----------
    simulated
        Names of the simulated observers in the data; empty if all answers are of people.
    participants
        Participants with trials.
    repeated, aborted
        Trials that were not accepted.
    curve
        Where the share of correct orders leaves the margin below that of no compression, by multiplier; None with fewer
        than two thresholds.
    predictors
        How well objective measures predict the ratings, best first.
    missing
        What is missing or uneven in the data, as sentences.
    laws
        What 1 JND was for each participant; two entries for one whose sessions had different laws.
    """

    simulated: tuple[str, ...]
    participants: tuple[str, ...]
    conditions: tuple[ConditionResult, ...]
    comparisons: tuple[Comparison, ...]
    margin: float
    curve: Leaving | None
    predictors: tuple[Predictor, ...]
    repeated: int
    aborted: int
    missing: tuple[str, ...] = ()
    laws: tuple[UsedLaw, ...] = ()
