"""From the file of a study to a plan, which is pickled for workers, and from a plan to the measures of a run.

A run compares the force that a hand feels over a network with the true one.
"""

import dataclasses
import hashlib
import json
import math
from collections import OrderedDict
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.channel.settings import parse_time_us
from hapticnet.checks import check_integer
from hapticnet.codec.recording import encode_array
from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import SettingsError, in_words
from hapticnet.experiment.comparison import REPAIR_US, felt_report
from hapticnet.experiment.trials import Trial
from hapticnet.files import read_bytes
from hapticnet.measure.quality import perceptual_distances
from hapticnet.node.offline import cost_report
from hapticnet.sweep.runs import Columns, Grid, Row, Shard
from hapticnet.sweep.sources import (
    LINK_COLUMNS,
    SOURCE_COLUMNS,
    Coder,
    Link,
    Source,
    coder_columns,
    coders,
    links,
    recorded,
    touched,
)
from hapticnet.sweep.study import MOST_REPEATS, MOST_RUNS, Reading, Study, StudyFile

if TYPE_CHECKING:
    from hapticnet.codec.base import Codec

DEFAULT_SCENES: Final = ("paper:1",)
NEVER_US: Final = 2**61  # later than the end of any recording [µs]
SHOWN_ONLY: Final = {"show", "name", "repeats"}  # what a study may change without changing the numbers of a run
KEPT_TRIALS: Final = 16  # trials that a worker keeps; the combinations that need one come together
RUN_COLUMNS: Final[Columns] = {"run": "int", "repeat": "int"}
ERROR_COLUMNS: Final[Columns] = {"error": "text"}
MEASURED: Final[Columns] = {  # measures of a run; docs/use/compare.md explains each
    "samples": "int", "seconds": "float", "sent": "int", "received": "int", "packets_per_s": "float",
    "wire_bytes_per_s": "float", "felt_rmse_n": "float", "felt_max_error_n": "float", "felt_exceed_jnd": "float",
    "felt_above_2_jnd": "float", "felt_above_4_jnd": "float", "felt_above_8_jnd": "float",
    "felt_p99_error_n": "float",
    "felt_rms_jnd": "float", "felt_created_share": "float", "coded_rmse_n": "float", "coded_exceed_jnd": "float",
}  # fmt: skip
FOR_REPEAT: Final = 1  # spawn key of random numbers shared by a repeat's combinations, such as the hand's motion


def plan_of(file: StudyFile, repeats: int | None = None) -> "Plan":
    """Return a study's plan, with `repeats` in place of its own; SettingsError or FileError if it cannot be used."""
    study = file.study
    if repeats is not None:
        check_integer("repeats", repeats, 1, MOST_REPEATS)
        study = study.model_copy(update={"repeats": repeats})
    axes = study.axes.model_copy(update={"codec": [_located(text, file.folder) for text in study.axes.codec]})
    study = study.model_copy(update={"axes": axes})
    try:
        plan = _planned(study, file.folder)
    except SettingsError as error:
        raise SettingsError(f"{file.source}: {error}") from error
    if plan.runs > MOST_RUNS:
        raise SettingsError(
            f"{file.source}: {plan.cells:,} combinations × {plan.repeats:,} repeats are {plan.runs:,} runs; at most"
            f" {MOST_RUNS:,} are possible"
        )
    return dataclasses.replace(plan, digest=_digest(file, plan))


def _located(codec: str, folder: Path) -> str:
    """Return a codec with the path of a user's file relative to the folder of the study."""
    file, separator, rest = codec.partition(".py:")
    return f"{folder / file}.py:{rest}" if separator else codec


def _digest(file: StudyFile, plan: "Plan") -> str:
    content: dict[str, Any] = {"study": file.study.model_dump(mode="json", exclude=SHOWN_ONLY), "code": {}}
    for text in file.study.axes.codec:
        name, separator, _ = text.partition(".py:")
        if separator:
            path = file.folder / f"{name}.py"
            content["code"][name] = hashlib.sha256(read_bytes(path, LARGEST_DOCUMENT)).hexdigest()
    content["sources"] = [source.fingerprint() for source in plan.sources]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Repair:
    """When a lost update is replaced [µs], and its text in the study; None: `REPAIR_US` and one round trip."""

    text: str
    after_us: int | None

    def of(self, link: Link) -> int:
        """Return the time [µs] on a link."""
        if self.after_us is not None:
            return self.after_us
        return REPAIR_US + link.forward.delay_us + link.feedback.delay_us


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A study with its files read and its combinations counted."""

    name: str
    seed: int
    repeats: int  # how often every combination is run
    sources: tuple[Source, ...]
    grid: Grid  # the numbers of sources, codecs, links and repairs
    swept: tuple[str, ...]  # parameters of codecs that the study varies
    digest: str = ""  # SHA-256 of all that determines the numbers, except how often the study is repeated

    @property
    def cells(self) -> int:
        """Number of combinations."""
        return len(self.grid)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.cells * self.repeats

    @property
    def columns(self) -> Columns:
        """All columns of a row: the run, what distinguishes combinations, the measures and the error."""
        settings = {**SOURCE_COLUMNS, **coder_columns(self.swept), **LINK_COLUMNS}
        return {**RUN_COLUMNS, **settings, "repair": "text", "predicted": "text", **MEASURED, **ERROR_COLUMNS}


def _planned(study: Study, folder: Path) -> Plan:
    axes = study.axes
    if axes.recording is None:
        if study.reading is not None:
            raise SettingsError("[reading] says how recordings are read, and axes.recording names none")
        combinations = product(axes.scene or DEFAULT_SCENES, axes.hand or (None,), axes.rate_hz)
        sources: list[Source] = [touched(scene, hand, rate_hz, folder) for scene, hand, rate_hz in combinations]
    else:
        for key in ("scene", "hand", "rate_hz"):
            if key in axes.model_fields_set:
                raise SettingsError(f"axes: recording replaces {key}; remove one of them")
        if any(axes.predicted):
            raise SettingsError("axes: predicted needs a scene, of which the slave steps a copy; a recording has none")
        sources = [recorded(folder / name, name, study.reading or Reading()) for name in axes.recording]
    repairs = tuple(Repair(text, _repair_us(text)) for text in axes.repair)
    return Plan(
        name=study.name,
        seed=study.seed,
        repeats=study.repeats,
        sources=tuple(sources),
        grid=Grid((tuple(range(len(sources))), coders(axes), links(axes), repairs, tuple(axes.predicted))),
        swept=tuple(axes.parameters),
    )


def _repair_us(text: str) -> int | None:
    if text == "round-trip":
        return None
    return NEVER_US if text == "never" else parse_time_us(text)


class Runner:
    """Computes runs. It may cache shared work, but no result may depend on earlier runs."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._codecs: dict[Coder, Codec] = {}
        self._trials: OrderedDict[tuple[int, int], Trial] = OrderedDict()
        self._coded: tuple[tuple[int, int, Coder], Row] | None = None

    def settings(self, cell: int) -> Row:
        """Return the columns that identify a combination."""
        number, coder, link, repair, predicted = self._plan.grid[cell]
        row = {**self._plan.sources[number].row(), **coder.row(self._plan.swept), **link.row()}
        return {**row, "repair": repair.text, "predicted": "yes" if predicted else "no"}

    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return the measures of a run. The generator belongs to this run alone."""
        number, coder, link, repair, predicted = self._plan.grid[cell]
        if coder not in self._codecs:
            self._codecs[coder] = coder.make()
        codec, trial = self._codecs[coder], self._trial(number, repeat)
        felt, error, created_share = felt_report(
            codec,
            trial,
            forward=link.forward,
            feedback=link.feedback,
            repair_us=repair.of(link),
            rng=rng,
            predicted=predicted,
        )
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
            "felt_above_2_jnd": error.above_2_jnd_fraction,
            "felt_above_4_jnd": error.above_4_jnd_fraction,
            "felt_above_8_jnd": error.above_8_jnd_fraction,
            "felt_p99_error_n": error.p99_error_n,
            "felt_rms_jnd": None if distances is None else math.sqrt(float(np.mean(distances * distances))),
            "felt_created_share": created_share,
            **self._coded_alone(number, repeat, coder),
        }

    def _trial(self, number: int, repeat: int) -> Trial:
        key = number, repeat
        if key not in self._trials:
            # All combinations of a repeat share it, so that they meet the same hand.
            seed = np.random.SeedSequence(entropy=self._plan.seed, spawn_key=(repeat, FOR_REPEAT))
            self._trials[key] = self._plan.sources[number].trial(np.random.default_rng(seed))
            if len(self._trials) > KEPT_TRIALS:
                self._trials.popitem(last=False)
        return self._trials[key]

    def _coded_alone(self, number: int, repeat: int, coder: Coder) -> Row:
        """Return the part that does not depend on the network; combinations that share it are adjacent."""
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


def rows_of(plan: Plan, runner: Runner, shard: Shard) -> list[Row]:
    """Return the rows of a shard: the same in any shard, worker and order. A run that fails has its error instead."""
    nothing: Row = dict.fromkeys(plan.columns)
    rows = []
    for run in range(shard.first, shard.end):
        repeat, cell = divmod(run, plan.cells)
        row = nothing | {"run": run, "repeat": repeat} | runner.settings(cell)
        rng = np.random.default_rng(np.random.SeedSequence(entropy=plan.seed, spawn_key=(run,)))
        try:
            row |= runner.measure(repeat, cell, rng)
        except (MemoryError, OSError):  # of this machine, not of this run
            raise
        except Exception as error:  # a user's codec may raise anything
            row["error"] = in_words(error)
        rows.append(row)
    return rows
