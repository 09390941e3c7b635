"""Simulated observers, who answer instead of a participant. Their results are titled "simulated".

An observer decides from what reaches the finger: the forces of two stimuli, or the cues of each contact with a tissue
(`Look`). `ObserverSettings` has the sources, extras/experiment/observers.md says what observers can show.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist, fmean
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.checks import check_parameter, meant
from hapticnet.errors import SettingsError
from hapticnet_experiment.trial import Played

# A JND is the difference recognised in 75 % of forced choices: 0.954 standard deviations of one judgement.
SIGMAS_PER_JND: Final = NormalDist().inv_cdf(0.75) * math.sqrt(2.0)
LEAST_FORCE_N: Final = 0.01  # smaller peaks are raised to this before the logarithm: a tissue hardly felt is very soft
RATING_SD: Final = 0.7
RESPONSE_SPREAD: Final = 0.4

LARGEST: Final = {  # largest value of each parameter
    "force_jnd": 1.0, "force_floor_n": 1.0, "stiffness_jnd": 10.0, "criterion": 10.0, "spread": 2.0, "lapse": 1.0,
    "step_masking": 100.0, "step_lapses": 100.0, "rhythm": 100.0, "annoyance": 10.0, "response_s": 1000.0,
}  # fmt: skip

LEAST_DEPTH_M: Final = 1e-3  # a contact with less indentation [m] does not count: tremor grazes a surface
STEP_FROM_N: Final = 0.3  # held force [N] above which steps are measured; below it the threshold's floor enlarges them


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """Cues from one contact with one tissue."""

    tissue: int  # number from front to back, from 0
    # Largest felt force. People order by it: Fu, van Paassen & Mulder 2017; Tan, Durlach, Beauregard & Srinivasan 1995.
    peak_n: float
    updates: int  # changes of the held force
    step: float  # median of |ln(after / before)| of the held force over updates; 0 without one


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverSettings:
    """Perception of an observer. JNDs are relative differences recognised in 75 % of forced choices."""

    name: str = "literature"  # in tables and reports
    # Of one force: Pang, Tan & Durlach 1991, active pinch, 2.5-10 N. About 10 % at the index finger at 2-5 N.
    force_jnd: float = 0.07
    # Noise [N] of a felt force as the force vanishes, an assumption: JNDs are 15-27 % below 0.5 N (quoted
    # in Scientific Reports 2022, s41598-022-12010-0).
    force_floor_n: float = 0.0125
    # Of two tissues touched once: between Tan and others 1995 (22 %) and Jones & Hunter 1990 (23 %). The part above the
    # noise of force does not shrink with more contacts, because it belongs to memory.
    stiffness_jnd: float = 0.225
    criterion: float = 1.64  # standard deviations of the felt difference that are called "different": an assumption
    # Standard deviation over participants of the logarithm of all noise: an assumption, within which the paper's
    # standard errors fall.
    spread: float = 0.35
    lapse: float = 0.0  # share of answers that are guesses: an assumption; 0 to 5 % is common
    step_masking: float = 0.0  # noise that a step adds, in multiples of the step: fitted, see `OBSERVERS`
    step_lapses: float = 0.0  # share of guesses for each unit of the step: fitted
    rhythm: float = 0.0  # share of trials, for each unit of the step, ordered by the number of updates: fitted
    annoyance: float = 1.0  # fall of a rating for a step of one `force_jnd`: an assumption
    response_s: float = 2.0  # median time to an answer: an assumption

    def __post_init__(self) -> None:
        for name, largest in LARGEST.items():
            check_parameter(f"observer {self.name!r}: {name}", getattr(self, name), 0.0, largest)

    @property
    def force_sigma(self) -> float:
        """Standard deviation of the logarithm of a felt force."""
        return math.log1p(self.force_jnd) / SIGMAS_PER_JND

    @property
    def memory_sigma(self) -> float:
        """Standard deviation of the logarithm of a remembered stiffness, without the noise of the force."""
        total = math.log1p(self.stiffness_jnd) / SIGMAS_PER_JND
        return math.sqrt(max(total * total - self.force_sigma * self.force_sigma, 0.0))

    @property
    def fitted(self) -> bool:
        """Whether a mechanism or a JND that was fitted to the paper's results is on."""
        mechanism = self.step_masking or self.step_lapses or self.rhythm
        return bool(mechanism) or self.stiffness_jnd == FITTED_STIFFNESS_JND

    def of_participant(self, rng: np.random.Generator) -> "ObserverSettings":
        """Return the settings of one participant, whose noise differs by `spread`."""
        factor = math.exp(rng.normal(0.0, self.spread))
        return replace(
            self,
            force_jnd=min(self.force_jnd * factor, 1.0),
            force_floor_n=min(self.force_floor_n * factor, 1.0),
            stiffness_jnd=min(math.expm1(math.log1p(self.stiffness_jnd) * factor), 10.0),
            step_masking=min(self.step_masking * factor, 100.0),
        )


FITTED_STIFFNESS_JND: Final = 0.255  # this value gives the paper's 77.5 % without compression
OBSERVERS: Final[Mapping[str, ObserverSettings]] = {
    each.name: each
    for each in (
        ObserverSettings(),
        ObserverSettings(name="force-only", stiffness_jnd=0.07),
        ObserverSettings(name="fitted", stiffness_jnd=FITTED_STIFFNESS_JND),
        ObserverSettings(name="step-masking", stiffness_jnd=0.25, step_masking=2.1),
        ObserverSettings(name="step-lapses", stiffness_jnd=FITTED_STIFFNESS_JND, step_lapses=2.2),
        ObserverSettings(name="rhythm", stiffness_jnd=FITTED_STIFFNESS_JND, rhythm=3.5),
    )
}
"""The observers by name.

"literature" uses nothing of the paper's results. "force-only" has no memory noise. "fitted" has the JND of stiffness
that gives the paper's result without compression. "step-masking", "step-lapses" and "rhythm" also have a mechanism
fitted to the paper's results at 2 and 4 JND, so they predict nothing about them.
"""


def parse_observer(text: str) -> ObserverSettings:
    """Return the observer written as ``NAME[:KEY=VALUE,…]``, such as ``literature:force_jnd=0.1``.

    Raise SettingsError if there is no such observer or parameter, or a value is out of range.
    """
    name, _, given = text.partition(":")
    if name not in OBSERVERS:
        raise SettingsError(f"unknown observer {name!r}{meant(name, OBSERVERS)}; there are: {', '.join(OBSERVERS)}")
    values: dict[str, float] = {}
    for part in filter(None, given.split(",")):
        key, equals, value = part.partition("=")
        if not equals or key not in LARGEST:
            raise SettingsError(
                f"observer {name!r} has no parameter {key!r}{meant(key, LARGEST)}; it has: {', '.join(LARGEST)}"
            )
        try:
            values[key] = float(value)
        except ValueError:
            raise SettingsError(f"observer {name!r}: {key} is {value!r}; it must be a number") from None
    settings = replace(OBSERVERS[name], **values)  # type: ignore[arg-type]
    return replace(settings, name=text) if values else settings


def labelled(name: str) -> str:
    """Return the name of an observer for titles, which says if it was fitted to the paper's results."""
    try:
        settings = parse_observer(name)
    except SettingsError:  # data of another version
        return name
    return f"{name}, fitted to the paper" if settings.fitted else name


class Observer:
    """A simulated participant, with a perception drawn by `ObserverSettings.of_participant`."""

    def __init__(self, settings: ObserverSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self._rng = rng

    def different(self, first_n: float, second_n: float) -> bool:
        """Return whether the second force feels different from the first, as in the method of limits."""
        if self._lapses(self.settings.lapse):
            return bool(self._rng.integers(2))
        noise_n = math.hypot(self._noise_n(first_n), self._noise_n(second_n))
        felt_n = second_n - first_n + noise_n * self._rng.standard_normal()
        return bool(abs(felt_n) > self.settings.criterion * noise_n)

    def stronger(self, first_n: float, second_n: float) -> int:
        """Return which of two forces feels stronger, 1 or 2, as in a forced choice."""
        if self._lapses(self.settings.lapse):
            return int(self._rng.integers(1, 3))
        noise_n = math.hypot(self._noise_n(first_n), self._noise_n(second_n))
        return 2 if second_n - first_n + noise_n * self._rng.standard_normal() > 0.0 else 1

    def order(self, contacts: Sequence[Look], tissues: int = 3) -> tuple[int, ...]:
        """Return the tissues from softest to hardest, numbered from 0, front to back, after these contacts.

        An untouched tissue counts as the softest.
        """
        # One row for each tissue: peak, updates, step, contacts.
        felt = np.tile([LEAST_FORCE_N, 0.0, 0.0, 1.0], (tissues, 1))
        for tissue in range(tissues):
            own = [look for look in contacts if look.tissue == tissue]
            if own:
                means = [fmean(max(look.peak_n, 1e-6) for look in own), fmean(look.updates for look in own)]
                felt[tissue] = *means, fmean(look.step for look in own), len(own)
        peaks_n, updates, steps, counts = felt.T[:, None, :]
        return tuple(judged(self.settings, peaks_n, updates, steps, counts, self._rng)[0].tolist())

    def rate(self, contacts: Sequence[Look]) -> int:
        """Return the quality of experience of a block, from 1 (bad) to 7 (excellent); worse with larger steps."""
        step = float(np.mean([look.step for look in contacts])) if contacts else 0.0
        jnds = step / self.settings.force_jnd if self.settings.force_jnd else 0.0
        return int(np.clip(round(6.5 - self.settings.annoyance * jnds + RATING_SD * self._rng.standard_normal()), 1, 7))

    def takes_s(self) -> float:
        """Return the time to the next answer [s]."""
        return float(self.settings.response_s * math.exp(RESPONSE_SPREAD * self._rng.standard_normal()))

    def _noise_n(self, force_n: float) -> float:
        return math.hypot(self.settings.force_sigma * force_n, self.settings.force_floor_n) or 1e-12

    def _lapses(self, share: float) -> bool:
        return bool(self._rng.random() < share)


def judged(
    settings: ObserverSettings,
    peaks_n: FloatArray,
    updates: FloatArray,
    steps: FloatArray,
    counts: FloatArray,
    rng: np.random.Generator,
    *,
    factor: FloatArray | float = 1.0,
) -> "np.ndarray[tuple[int, ...], np.dtype[np.int64]]":
    """Return an observer's answers in many trials, from softest to hardest, shape (n, tissues).

    `peaks_n`, `updates`, `steps` and `counts` of contacts belong to each trial and tissue, shape (n, tissues);
    `factor`, shape (n, 1), scales the noise of each trial's observer.
    """
    trials = len(peaks_n)
    step = steps.mean(axis=1, keepdims=True)
    sigma = factor * np.sqrt(
        settings.force_sigma**2 / np.maximum(counts, 1.0)
        + settings.memory_sigma**2
        + (settings.step_masking * steps) ** 2
    )
    felt = np.log(np.maximum(peaks_n, 1e-6))
    if settings.rhythm:
        by_rhythm = rng.random((trials, 1)) < settings.rhythm * step
        felt = np.where(by_rhythm, np.log(np.maximum(updates, 0.5)), felt)
    felt = felt + sigma * rng.standard_normal(peaks_n.shape)
    guesses = rng.random((trials, 1)) < np.minimum(settings.lapse + settings.step_lapses * step, 1.0)
    felt = np.where(guesses, rng.random(peaks_n.shape), felt)
    return np.argsort(felt, axis=1)


def contacts(played: Played) -> list[Look]:
    """Return the cues of each contact of a trial, in order of time.

    A contact begins when the tip passes a surface inwards. It ends when the tip leaves through the same surface, or is
    as far behind the breach as there is space before the next surface, so that late forces of the device still count.
    """
    position_m, held_n, felt_n = (played.ticks[name] for name in ("position_m", "held_n", "sensed_n"))
    surfaces_m = played.stimulus.surfaces_m
    ends_m = [*surfaces_m[1:], np.inf]
    breaches_m = [tissue.breach_depth_m for tissue in played.stimulus.tissues]
    found = []
    for tissue, (surface_m, end_m, breach_m) in enumerate(zip(surfaces_m, ends_m, breaches_m, strict=True)):
        inside = (position_m >= surface_m) & (position_m < end_m)
        edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if first == 0 or position_m[first - 1] >= surface_m:
                continue  # on the way out
            span = slice(int(first), int(last))
            if position_m[span].max() - surface_m >= LEAST_DEPTH_M:
                look = _look(tissue, position_m[span] - surface_m, held_n[span], felt_n[span], breach_m)
                found.append((int(first), look))
    return [look for _, look in sorted(found, key=lambda each: each[0])]


def _look(tissue: int, depth_m: FloatArray, held_n: FloatArray, felt_n: FloatArray, breach_m: float) -> Look:
    through = np.flatnonzero(depth_m > breach_m)
    end = int(through[0]) if len(through) else len(depth_m)
    steps = np.abs(np.diff(np.log(held_n[:end][held_n[:end] > STEP_FROM_N])))
    steps = steps[steps > 0.0]
    return Look(
        tissue=tissue,
        peak_n=float(felt_n.max()),
        updates=int(np.count_nonzero(np.diff(held_n[:end]))),
        step=float(np.median(steps)) if len(steps) else 0.0,
    )
