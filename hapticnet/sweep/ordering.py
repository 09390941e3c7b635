"""The task "ordering": simulated observers order three tissues that were felt through the whole chain."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np

from hapticnet.scene.sources import PAPER_BREACH_FORCES_N, PAPER_GAP_M
from hapticnet.study.library import play_trial
from hapticnet.study.observers import Look, Observer, ObserverSettings, contacts
from hapticnet.study.trial import Played, Stimulus
from hapticnet.sweep.grid import Grid
from hapticnet.sweep.link import LINK_COLUMNS, Coder, Columns, Link, Row, coder_columns
from hapticnet.sweep.runs import rng_of_repeat

ORDERS: Final = tuple(permutations(PAPER_BREACH_FORCES_N))
LIMIT_S: Final = 180.0
LARGEST_SEED: Final = 2**31

MEASURES: Final[Columns] = {
    "order": "text",
    "answers": "int",
    "correct": "float",
    "contacts": "int",
    "updates": "float",
    "step": "float",
    "packets": "int",
    "wire_bytes": "int",
    "penetrations": "int",
    "bytes_per_penetration": "float",
    "perceptual_error": "float",
}
"""What a run measures; docs/use/compare.md explains each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderingPlan:
    """A study of the task "ordering"; see `runs.Plan`.

    Attributes
    ----------
    grid
        Codecs, links, rates [Hz] and observers.
    swept
        Parameters of codecs that the study varies.
    answers
        Observers who answer about one trial.
    """

    name: str
    digest: str
    seed: int
    repeats: int
    grid: Grid
    swept: tuple[str, ...]
    answers: int

    @property
    def cells(self) -> int:
        """Number of combinations."""
        return len(self.grid)

    @property
    def sharing(self) -> int:
        """As many as there are observers, who feel the same trial."""
        return len(self.grid.axes[-1])

    @property
    def columns(self) -> Columns:
        """Columns of a row."""
        own: Columns = {"rate_hz": "float", "observer": "text"}
        return {**coder_columns(self.swept), **LINK_COLUMNS, **own, **MEASURES}

    @property
    def measures(self) -> tuple[str, ...]:
        """Those of the columns that a run measures."""
        return tuple(MEASURES)

    def runner(self) -> "OrderingRunner":
        """Return what computes its runs in this process."""
        return OrderingRunner(self)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial that was played, and the contacts in it."""

    played: Played
    looks: Sequence[Look]


class OrderingRunner:
    """Computes runs of the task "ordering"; see `runs.Runner`."""

    def __init__(self, plan: OrderingPlan) -> None:
        self._plan = plan
        self._last: tuple[tuple[int, Coder, Link, float], _Trial] | None = None

    def settings(self, cell: int) -> Row:
        """Return the columns that tell a combination from others."""
        coder, link, rate_hz, observer = self._plan.grid[cell]
        return {**coder.row(self._plan.swept), **link.row(), "rate_hz": rate_hz, "observer": observer.name}

    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return what a run finds."""
        coder, link, rate_hz, observer = self._plan.grid[cell]
        trial = self._trial(repeat, coder, link, rate_hz)
        forces_n = trial.played.stimulus.breach_forces_n
        right = tuple(sorted(range(len(forces_n)), key=forces_n.__getitem__))
        measures = trial.played.measures
        return {
            "order": "".join(str(tissue + 1) for tissue in right),
            "answers": self._plan.answers,
            "correct": _share_right(observer, trial.looks, right, self._plan.answers, rng),
            "contacts": len(trial.looks),
            "updates": float(np.mean([look.updates for look in trial.looks])) if trial.looks else 0.0,
            "step": float(np.mean([look.step for look in trial.looks])) if trial.looks else 0.0,
            "packets": measures.force_packets,
            "wire_bytes": measures.wire_bytes,
            "penetrations": measures.penetrations,
            "bytes_per_penetration": measures.penetration_bytes / max(measures.penetrations, 1),
            "perceptual_error": measures.perceptual_error,
        }

    def _trial(self, repeat: int, coder: Coder, link: Link, rate_hz: float) -> _Trial:
        """Return a trial. Observers do not change it, and those who feel the same one follow each other."""
        key = repeat, coder, link, rate_hz
        if self._last is None or self._last[0] != key:
            rng = rng_of_repeat(self._plan.seed, repeat)
            stimulus = Stimulus(
                number=1,
                breach_forces_n=ORDERS[int(rng.integers(len(ORDERS)))],
                gap_m=PAPER_GAP_M,
                codec=coder.text,
                law=coder.law,
                rate_hz=rate_hz,
                forward=link.forward.describe(),
                feedback=link.feedback.describe(),
                seed=int(rng.integers(LARGEST_SEED)),
                limit_s=LIMIT_S,
            )
            played = play_trial(stimulus)
            self._last = key, _Trial(played, contacts(played))
        return self._last[1]


def _share_right(
    observer: ObserverSettings, looks: Sequence[Look], right: tuple[int, ...], answers: int, rng: np.random.Generator
) -> float:
    """Return the share of observers, each with a perception of their own, who find the whole order."""
    good = sum(Observer(observer.of_participant(rng), rng).order(looks) == right for _ in range(answers))
    return good / answers
