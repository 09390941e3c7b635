"""The task "felt": the force that a hand feels over a network, beside the true one, and what it costs to send."""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from hapticnet.codec.recording import encode_array
from hapticnet.experiment.comparison import REPAIR_US
from hapticnet.experiment.trial import Trial
from hapticnet.measure.energy import energy_report
from hapticnet.measure.metrics import error_report
from hapticnet.measure.quality import perceptual_distances
from hapticnet.node.closed_loop import simulate_link
from hapticnet.node.offline import cost_report
from hapticnet.sweep.grid import Grid
from hapticnet.sweep.link import LINK_COLUMNS, Coder, Columns, Link, Row, coder_columns
from hapticnet.sweep.runs import rng_of_repeat
from hapticnet.sweep.sources import SOURCE_COLUMNS, Source

if TYPE_CHECKING:
    from hapticnet.codec.base import Codec

KEPT_TRIALS: Final = 16
"""Trials and encodings that a worker keeps; the combinations that need one come together."""

MEASURES: Final[Columns] = {
    "samples": "int",
    "seconds": "float",
    "sent": "int",
    "received": "int",
    "packets_per_s": "float",
    "wire_bytes_per_s": "float",
    "felt_rmse_n": "float",
    "felt_max_error_n": "float",
    "felt_exceed_jnd": "float",
    "felt_rms_jnd": "float",
    "felt_created_share": "float",
    "coded_rmse_n": "float",
    "coded_exceed_jnd": "float",
}
"""What a run measures; docs/use/compare.md explains each."""


@dataclass(frozen=True, slots=True)
class Repair:
    """When a lost update is replaced.

    Attributes
    ----------
    text
        As the study writes it.
    after_us
        Time [µs]; None: `REPAIR_US` and one round trip, as in `comparison.compare`.
    """

    text: str
    after_us: int | None

    def of(self, link: Link) -> int:
        """Return the time [µs] on a link."""
        if self.after_us is not None:
            return self.after_us
        return REPAIR_US + link.forward.delay_us + link.feedback.delay_us


@dataclass(frozen=True, slots=True, kw_only=True)
class FeltPlan:
    """A study of the task "felt"; see `runs.Plan`.

    Attributes
    ----------
    sources
        What is touched.
    grid
        Numbers of sources, codecs, links and repairs.
    swept
        Parameters of codecs that the study varies.
    """

    name: str
    digest: str
    seed: int
    repeats: int
    sources: tuple[Source, ...]
    grid: Grid
    swept: tuple[str, ...]

    @property
    def cells(self) -> int:
        """Number of combinations."""
        return len(self.grid)

    @property
    def sharing(self) -> int:
        """One: what combinations share is little beside a run."""
        return 1

    @property
    def columns(self) -> Columns:
        """Columns of a row."""
        repair: Columns = {"repair": "text"}
        return {**SOURCE_COLUMNS, **coder_columns(self.swept), **LINK_COLUMNS, **repair, **MEASURES}

    @property
    def measures(self) -> tuple[str, ...]:
        """Those of the columns that a run measures."""
        return tuple(MEASURES)

    def runner(self) -> "FeltRunner":
        """Return what computes its runs in this process."""
        return FeltRunner(self)


class FeltRunner:
    """Computes runs of the task "felt"; see `runs.Runner`."""

    def __init__(self, plan: FeltPlan) -> None:
        self._plan = plan
        self._codecs: dict[Coder, Codec] = {}
        self._trials: OrderedDict[tuple[int, int], Trial] = OrderedDict()
        self._coded: tuple[tuple[int, int, Coder], Row] | None = None

    def settings(self, cell: int) -> Row:
        """Return the columns that tell a combination from others."""
        number, coder, link, repair = self._plan.grid[cell]
        return {**self._plan.sources[number].row(), **coder.row(self._plan.swept), **link.row(), "repair": repair.text}

    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return what a run finds."""
        number, coder, link, repair = self._plan.grid[cell]
        if coder not in self._codecs:
            self._codecs[coder] = coder.make()
        codec, trial = self._codecs[coder], self._trial(number, repeat)
        felt = simulate_link(
            codec,
            trial.t_us,
            trial.stimuli,
            trial.positions,
            forward=link.forward,
            feedback=link.feedback,
            repair_us=repair.of(link),
            rng=rng,
        )
        error = error_report(codec.law, trial.stimuli, felt.applied)
        created = None
        if trial.positions is not None:
            created = energy_report(codec.law, trial.stimuli, felt.applied, trial.positions).created_share
        distances = perceptual_distances(codec.law, trial.stimuli, felt.applied)
        return {
            "samples": len(trial.t_us),
            "seconds": trial.seconds,
            "sent": felt.sent,
            "received": felt.received,
            "packets_per_s": felt.sent / trial.seconds,
            "felt_rmse_n": error.rmse_n,
            "felt_max_error_n": error.max_error_n,
            "felt_exceed_jnd": error.exceed_jnd_fraction,
            "felt_rms_jnd": None if distances is None else math.sqrt(float(np.mean(distances * distances))),
            "felt_created_share": created,
            **self._coded_alone(number, repeat, coder),
        }

    def _trial(self, number: int, repeat: int) -> Trial:
        key = number, repeat
        if key not in self._trials:
            self._trials[key] = self._plan.sources[number].trial(rng_of_repeat(self._plan.seed, repeat))
            if len(self._trials) > KEPT_TRIALS:
                self._trials.popitem(last=False)
        return self._trials[key]

    def _coded_alone(self, number: int, repeat: int, coder: Coder) -> Row:
        """Return what does not depend on the network; the combinations that share it follow each other."""
        key = number, repeat, coder
        if self._coded is None or self._coded[0] != key:
            codec, trial = self._codecs[coder], self._trial(number, repeat)
            encoding = encode_array(codec, trial.t_us, trial.stimuli, trial.positions)
            cost = cost_report(codec, trial.t_us, trial.stimuli, encoding)
            figures = {
                "wire_bytes_per_s": cost.wire_bytes / trial.seconds,
                "coded_rmse_n": cost.rmse_n,
                "coded_exceed_jnd": cost.exceed_jnd_fraction,
            }
            self._coded = key, figures
        return self._coded[1]
