"""The person's law: JND at each reference, Weber fraction, its interval, and how well Weber's law holds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, TypeAlias

import numpy as np
import tomli_w
from pydantic import BaseModel, Field

from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import SettingsError
from hapticnet.experiment.summary import t_quantile
from hapticnet.perception import WeberLaw
from hapticnet_experiment.plan import LimitsPlan

# JNDs [N] of the series of each reference [N]; None for a series in which no difference was large enough.
Jnds: TypeAlias = Mapping[float, Sequence[float | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class WeberFit:
    """Weber's law, fitted to a person's JNDs.

    The interval is Student's for the mean of infinitely many such series, with one relative variance of series about
    the mean of their reference. It is None if the series have no spread.
    """

    mean_of_ratios: float  # mean of JND over reference
    low: float | None  # 95 % interval of the mean of ratios
    high: float | None
    residual: float  # root mean square over references of JND / (mean of ratios · reference) − 1


def fit(found: Jnds) -> WeberFit:
    """Return the fit to the JNDs of each reference; raise SettingsError if no JND was found at any."""
    known = {reference_n: [each for each in series if each is not None] for reference_n, series in found.items()}
    known = {reference_n: series for reference_n, series in known.items() if series}
    if not known:
        raise SettingsError(
            "no pair was called different: the JND is above the largest difference of the plan; raise"
            " limits.largest or exclude the participant"
        )
    references_n = np.array(sorted(known))
    jnds_n = np.array([fmean(known[reference_n]) for reference_n in sorted(known)])
    ratio = float(np.mean(jnds_n / references_n))
    half = _half_width(known)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = float(np.sqrt(np.mean(np.square(jnds_n / (ratio * references_n) - 1.0)))) if ratio else 0.0
    return WeberFit(
        mean_of_ratios=ratio,
        low=None if half is None else max(0.0, ratio - half),
        high=None if half is None else ratio + half,
        residual=residual,
    )


def _half_width(known: Mapping[float, Sequence[float]]) -> float | None:
    """Return half of the interval of the mean of ratios; None if the series have no spread."""
    ratios = [np.array(series) / reference_n for reference_n, series in known.items()]
    freedom = sum(len(each) - 1 for each in ratios)
    squares = sum(float(np.sum((each - each.mean()) ** 2)) for each in ratios)
    if not freedom or squares <= 1e-18:
        return None
    variance = squares / freedom * sum(1.0 / len(each) for each in ratios) / len(ratios) ** 2
    return t_quantile(freedom) * math.sqrt(variance)


class ReferenceTable(BaseModel):
    """A ``[[reference]]`` of a participant's file: the JND at one reference. The mean excludes censored series."""

    model_config = STRICT

    reference_n: float
    jnd_n: float | None = None  # mean of the series; None if no series found one
    deviation_n: float | None = None  # standard deviation over the series; None with fewer than two
    series: int
    censored: int = 0  # series in which no difference was large enough, so that the mean is too small
    device_error_n: float | None = None


class ParticipantFile(BaseModel):
    """A participant's measured JND, as in ``participants/03.toml``."""

    model_config = STRICT

    participant: str
    method: str
    weber_fraction: Annotated[float, Field(ge=0.0, le=1.0)]  # the mean of ratios
    floor_n: Annotated[float, Field(ge=0.0)]  # the JND at the weakest reference
    low: float | None = None  # this and the next two are as in `WeberFit`
    high: float | None = None
    residual: float | None = None
    false_alarms: int | None = None  # pairs of catch series that were called different
    catch_pairs: int | None = None  # all of them
    excluded: list[str] = []  # rules of the plan that exclude the JND
    warnings: list[str] = []  # doubts about it
    device_error_n: float | None = None  # root mean square of delivered minus held force; a smaller JND is the device's
    simulated: str | None = None  # the simulated observer; None for a person
    device: str | None = None  # as written for ``--device``
    date: str | None = None
    version: str | None = None
    reference: list[ReferenceTable] = []

    @property
    def law(self) -> WeberLaw:
        """The participant's law at 1 JND."""
        return WeberLaw(weber_fraction=self.weber_fraction, floor_n=self.floor_n)

    def measured_differently(self, other: "ParticipantFile") -> bool:
        """Return whether two files differ in more than date and version."""
        same = {"date": None, "version": None}
        return self.model_copy(update=same) != other.model_copy(update=same)

    def to_toml(self) -> str:
        """Return the file's text."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))


def participant_file(
    participant: str,
    plan: LimitsPlan,
    found: Jnds,
    *,
    device_errors_n: Mapping[float, Sequence[float]],
    false_alarms: int | None = None,
    catch_pairs: int | None = None,
    **further: Any,
) -> ParticipantFile:
    """Return the file of a participant whose series gave these JNDs; raise SettingsError if there is none.

    `device_errors_n` are sensed minus held forces [N] of every stimulus, by reference; `false_alarms` and `catch_pairs`
    are None for a method without catch series; `further` are further attributes of the file.
    """
    fitted = fit(found)
    tables = [_reference(each, found[each], device_errors_n.get(each, ())) for each in sorted(found)]
    return ParticipantFile(
        participant=participant,
        method=plan.method,
        weber_fraction=min(_written(fitted.mean_of_ratios), 1.0),
        floor_n=_written(fitted.mean_of_ratios * min(found)),
        low=fitted.low,
        high=fitted.high,
        residual=fitted.residual,
        false_alarms=false_alarms,
        catch_pairs=catch_pairs,
        excluded=_excluded(plan, tables, false_alarms, catch_pairs),
        warnings=_warnings(plan, tables, catch_pairs),
        device_error_n=_root_mean_square([error_n for errors_n in device_errors_n.values() for error_n in errors_n]),
        reference=tables,
        **further,
    )


def _reference(reference_n: float, series: Sequence[float | None], errors_n: Sequence[float]) -> ReferenceTable:
    known = [each for each in series if each is not None]
    return ReferenceTable(
        reference_n=reference_n,
        jnd_n=fmean(known) if known else None,
        deviation_n=float(np.std(known, ddof=1)) if len(known) > 1 else None,
        series=len(series),
        censored=len(series) - len(known),
        device_error_n=_root_mean_square(errors_n),
    )


def _excluded(
    plan: LimitsPlan, tables: Sequence[ReferenceTable], false_alarms: int | None, catch_pairs: int | None
) -> list[str]:
    told = []
    if catch_pairs and false_alarms is not None and false_alarms > plan.most_false_alarms * catch_pairs:
        told.append(
            f"{false_alarms} of {catch_pairs} pairs of equal forces were called different, more than"
            f" {100 * plan.most_false_alarms:g} %: the answers may not follow the forces"
        )
    told += [
        f"{each.censored} of {each.series} series at {each.reference_n:g} N ended without a JND, more than"
        f" {plan.most_censored}: the mean is too small"
        for each in tables
        if each.censored > plan.most_censored
    ]
    return told


def _warnings(plan: LimitsPlan, tables: Sequence[ReferenceTable], catch_pairs: int | None) -> list[str]:
    told = [
        f"the JND at {each.reference_n:g} N, {each.jnd_n:.3f} N, is below the error of the device,"
        f" {each.device_error_n:.3f} N: it is a property of the device"
        for each in tables
        if each.jnd_n is not None and each.device_error_n is not None and each.jnd_n < each.device_error_n
    ]
    if plan.method == "ascending" and not catch_pairs:
        told.append("there was no catch series, so random answers would go unnoticed")
    return told


def load_participant(path: Path) -> ParticipantFile:
    """Return the measurement of a participant; raise FileError or SettingsError if the file cannot be used."""
    return parse_document(read_document(path), str(path), ParticipantFile)


def _root_mean_square(errors_n: Sequence[float]) -> float | None:
    return math.sqrt(fmean(error_n**2 for error_n in errors_n)) if errors_n else None


def _written(value: float) -> float:
    """Return a number with six digits, so that tables give the law exactly."""
    return float(f"{value:.6g}")
