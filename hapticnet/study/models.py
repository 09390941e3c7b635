"""Models of single answers, for those who expect one: GEE. It needs statsmodels.

There is no mixed model: the intervals of statsmodels' variational fit are much too narrow with few participants,
because they neglect what the random effects leave open.
"""

import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hapticnet.errors import UnavailableError
from hapticnet.study.rows import OrderRow

LEAST_PARTICIPANTS: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One coefficient of a model.

    Attributes
    ----------
    model
        Name of the model.
    condition, reference
        The two conditions that are compared.
    log_odds, low, high
        Difference of the log odds of a correct order, with its 95 % interval.
    probability
        Two-sided probability.
    note
        What to know when reading it.
    """

    model: str
    condition: str
    reference: str
    log_odds: float
    low: float
    high: float
    probability: float
    note: str


GEE_NOTE: Final = (
    "logit, exchangeable correlation within participants, bias-reduced errors (Mancl & DeRouen 2001), Student's t"
)


def fit_models(trials: Sequence[OrderRow], conditions: Sequence[str]) -> list[Effect]:
    """Fit all models to answered trials; a model that fails is left out.

    Parameters
    ----------
    conditions
        Names of the conditions; the first is the reference.

    Raises
    ------
    UnavailableError
        If statsmodels is missing.
    """
    try:
        import statsmodels.api  # noqa: F401
    except ImportError as error:
        raise UnavailableError("the models need statsmodels (extra stats): pip install statsmodels") from error
    people = sorted({row.participant for row in trials})
    if len(people) < LEAST_PARTICIPANTS or len(conditions) < 2:
        return []
    # Columns: intercept, then one for each condition but the reference.
    design = np.array([[1.0] + [float(row.condition == name) for name in conditions[1:]] for row in trials])
    correct = np.array([float(row.correct or 0) for row in trials])
    groups = np.array([people.index(row.participant) for row in trials])
    found: list[Effect] = []
    with suppress(ValueError, ArithmeticError, np.linalg.LinAlgError):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # convergence is judged by what comes out
            effects = _gee(correct, design, groups)
        found = [
            Effect(model="GEE", condition=condition, reference=conditions[0], **values, note=GEE_NOTE)
            for condition, values in zip(conditions[1:], effects, strict=True)
            if all(math.isfinite(value) for value in values.values())
        ]
    return found


def _gee(correct: Any, design: Any, groups: Any) -> list[dict[str, float]]:
    """Return the coefficient of each condition with an interval of Student's t over participants."""
    from scipy.stats import t
    from statsmodels.genmod.cov_struct import Exchangeable
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_estimating_equations import GEE

    model = GEE(correct, design, groups=groups, family=Binomial(), cov_struct=Exchangeable())
    fitted = model.fit(cov_type="bias_reduced")
    freedom = int(groups.max())  # with few participants the normal distribution is too narrow
    return [
        {
            "log_odds": (estimate := float(fitted.params[index])),
            "low": estimate - float(t.ppf(0.975, freedom)) * (error := float(fitted.bse[index])),
            "high": estimate + float(t.ppf(0.975, freedom)) * error,
            "probability": 2.0 * float(t.sf(abs(estimate) / error, freedom)) if error else math.nan,
        }
        for index in range(1, design.shape[1])
    ]
