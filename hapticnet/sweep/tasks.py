"""The tasks of a study: from its file to a plan, and from a plan to the measures of a run.

"felt" compares the force that a hand feels over a network with the true one. In "ordering", simulated observers order
three tissues that were felt through the whole chain.
"""

import dataclasses
import hashlib
import json
import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from hapticnet.channel.settings import parse_time_us
from hapticnet.checks import check_integer
from hapticnet.codec.recording import encode_array
from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import SettingsError
from hapticnet.experiment.comparison import REPAIR_US, felt_report
from hapticnet.experiment.trials import Trial
from hapticnet.files import read_bytes
from hapticnet.measure.quality import perceptual_distances
from hapticnet.node.offline import cost_report
from hapticnet.scene.sources import PAPER_BREACH_FORCES_N, PAPER_GAP_M
from hapticnet.study.observers import Look, Observer, ObserverSettings, contacts, parse_observer
from hapticnet.study.rig import play_trial
from hapticnet.study.trial import Played, Stimulus
from hapticnet.sweep.runs import Columns, Grid, Plan, Row, Runner, rng_of_repeat
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
from hapticnet.sweep.study import MOST_REPEATS, MOST_RUNS, FeltStudy, OrderingStudy, Reading, StudyFile

if TYPE_CHECKING:
    from hapticnet.codec.base import Codec

DEFAULT_SCENES: Final = ("paper:1",)
NEVER_US: Final = 2**61  # later than the end of any recording [µs]
SHOWN_ONLY: Final = {"show", "name", "repeats"}  # keys that a study may change without changing the numbers of a run
KEPT_TRIALS: Final = 16  # trials that a worker caches; combinations that share one are adjacent
ORDERS: Final = tuple(permutations(PAPER_BREACH_FORCES_N))
LIMIT_S: Final = 180.0
LARGEST_SEED: Final = 2**31


def plan_of(file: StudyFile, repeats: int | None = None) -> Plan:
    """Return a study's plan, with `repeats` instead of its own; SettingsError or FileError if it cannot be used."""
    study = file.study
    if repeats is not None:
        check_integer("repeats", repeats, 1, MOST_REPEATS)
        study = study.model_copy(update={"repeats": repeats})
    axes = study.axes.model_copy(update={"codec": [_located(text, file.folder) for text in study.axes.codec]})
    study = study.model_copy(update={"axes": axes})
    try:
        plan = _felt(study, file.folder) if isinstance(study, FeltStudy) else _ordering(study)
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


def _digest(file: StudyFile, plan: Plan) -> str:
    content: dict[str, Any] = {"study": file.study.model_dump(mode="json", exclude=SHOWN_ONLY), "code": {}}
    for text in file.study.axes.codec:
        name, separator, _ = text.partition(".py:")
        if separator:
            path = file.folder / f"{name}.py"
            content["code"][name] = hashlib.sha256(read_bytes(path, LARGEST_DOCUMENT)).hexdigest()
    if isinstance(plan, FeltPlan):
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
class FeltPlan(Plan):
    """A study of the task "felt"; its grid has the sources, codecs, links, repairs, and whether hands are predicted."""

    task: ClassVar[str] = "felt"
    measured: ClassVar[Columns] = {
        "samples": "int", "seconds": "float", "sent": "int", "received": "int", "packets_per_s": "float",
        "wire_bytes_per_s": "float", "felt_rmse_n": "float", "felt_max_error_n": "float", "felt_exceed_jnd": "float",
        "felt_above_2_jnd": "float", "felt_above_4_jnd": "float", "felt_above_8_jnd": "float",
        "felt_p99_error_n": "float",
        "felt_rms_jnd": "float", "felt_created_share": "float", "coded_rmse_n": "float", "coded_exceed_jnd": "float",
    }  # fmt: skip
    sources: tuple[Source, ...]

    @property
    def settings(self) -> Columns:
        """Columns that distinguish combinations."""
        return {**SOURCE_COLUMNS, **coder_columns(self.swept), **LINK_COLUMNS, "repair": "text", "predicted": "text"}

    def runner(self) -> Runner:
        """Return a runner that computes its runs in this process."""
        return FeltRunner(self)


def _felt(study: FeltStudy, folder: Path) -> FeltPlan:
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
        sources = [recorded(folder / name, name, study.reading or Reading()) for name in axes.recording]
    repairs = tuple(Repair(text, _repair_us(text)) for text in axes.repair)
    return FeltPlan(
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


class FeltRunner(Runner):
    """Computes runs of the task "felt"."""

    def __init__(self, plan: FeltPlan) -> None:
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
        """Return the measures of a run."""
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
            self._trials[key] = self._plan.sources[number].trial(rng_of_repeat(self._plan.seed, repeat))
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


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderingPlan(Plan):
    """A study of the task "ordering"; its grid has codecs, links, rates [Hz] and observers."""

    task: ClassVar[str] = "ordering"
    measured: ClassVar[Columns] = {
        "order": "text", "answers": "int", "correct": "float", "contacts": "int", "updates": "float", "step": "float",
        "packets": "int", "wire_bytes": "int", "penetrations": "int", "bytes_per_penetration": "float",
        "perceptual_error": "float",
    }  # fmt: skip
    answers: int  # observers who answer about one trial

    @property
    def sharing(self) -> int:
        """The number of observers, because all feel the same trial."""
        return len(self.grid.axes[-1])

    @property
    def settings(self) -> Columns:
        """Columns that distinguish combinations."""
        return {**coder_columns(self.swept), **LINK_COLUMNS, "rate_hz": "float", "observer": "text"}

    def runner(self) -> Runner:
        """Return a runner that computes its runs in this process."""
        return OrderingRunner(self)


def _ordering(study: OrderingStudy) -> OrderingPlan:
    axes = study.axes
    for rate_hz in axes.rate_hz:
        if not 100.0 <= rate_hz <= 10_000.0:
            raise SettingsError(f"axes: rate_hz is {rate_hz:g}; it must be between 100 and 10000")
    return OrderingPlan(
        name=study.name,
        seed=study.seed,
        repeats=study.repeats,
        grid=Grid((coders(axes), links(axes), tuple(axes.rate_hz), tuple(map(parse_observer, axes.observer)))),
        swept=tuple(axes.parameters),
        answers=study.answers,
    )


class OrderingRunner(Runner):
    """Computes runs of the task "ordering"."""

    def __init__(self, plan: OrderingPlan) -> None:
        self._plan = plan
        self._last: tuple[Any, Played, Sequence[Look]] | None = None

    def settings(self, cell: int) -> Row:
        """Return the columns that identify a combination."""
        coder, link, rate_hz, observer = self._plan.grid[cell]
        return {**coder.row(self._plan.swept), **link.row(), "rate_hz": rate_hz, "observer": observer.name}

    def measure(self, repeat: int, cell: int, rng: np.random.Generator) -> Row:
        """Return the measures of a run."""
        coder, link, rate_hz, observer = self._plan.grid[cell]
        played, looks = self._trial(repeat, coder, link, rate_hz)
        forces_n = played.stimulus.breach_forces_n
        right = tuple(sorted(range(len(forces_n)), key=forces_n.__getitem__))
        measures = played.measures
        return {
            "order": "".join(str(tissue + 1) for tissue in right),
            "answers": self._plan.answers,
            "correct": _share_right(observer, looks, right, self._plan.answers, rng),
            "contacts": len(looks),
            "updates": float(np.mean([look.updates for look in looks])) if looks else 0.0,
            "step": float(np.mean([look.step for look in looks])) if looks else 0.0,
            "packets": measures.force_packets,
            "wire_bytes": measures.wire_bytes,
            "penetrations": measures.penetrations,
            "bytes_per_penetration": measures.penetration_bytes / max(measures.penetrations, 1),
            "perceptual_error": measures.perceptual_error,
        }

    def _trial(self, repeat: int, coder: Coder, link: Link, rate_hz: float) -> tuple[Played, Sequence[Look]]:
        """Return a trial and its contacts. Observers who feel the same trial are adjacent."""
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
            self._last = key, played, contacts(played)
        return self._last[1:]


def _share_right(
    observer: ObserverSettings, looks: Sequence[Look], right: tuple[int, ...], answers: int, rng: np.random.Generator
) -> float:
    """Return the share of observers, each with their own perception, who find the whole order."""
    good = sum(Observer(observer.of_participant(rng), rng).order(looks) == right for _ in range(answers))
    return good / answers
