"""From a study to a plan: read its scenes and recordings, count its combinations, and take its fingerprint."""

import dataclasses
import hashlib
import json
from itertools import product
from pathlib import Path
from typing import Any, Final, TypeAlias

from hapticnet.channel.settings import parse_time_us
from hapticnet.checks import check_integer
from hapticnet.documents import LARGEST_DOCUMENT
from hapticnet.errors import SettingsError
from hapticnet.files import read_bytes
from hapticnet.study.observers import parse_observer
from hapticnet.sweep.felt import FeltPlan, Repair
from hapticnet.sweep.grid import Grid
from hapticnet.sweep.link import coders, links
from hapticnet.sweep.ordering import OrderingPlan
from hapticnet.sweep.sources import Source, recorded, touched
from hapticnet.sweep.study import MOST_REPEATS, MOST_RUNS, FeltStudy, OrderingStudy, Reading, StudyFile

DEFAULT_SCENES: Final = ("paper:1",)
NEVER_US: Final = 2**61
"""Later than the end of any recording [µs]."""

SHOWN_ONLY: Final = {"show", "name", "repeats"}
"""What a study may change without changing the numbers of a run."""

AnyPlan: TypeAlias = FeltPlan | OrderingPlan


def plan_of(file: StudyFile, repeats: int | None = None) -> AnyPlan:
    """Return the plan of a study.

    Parameters
    ----------
    repeats
        In the place of the study's own.

    Raises
    ------
    SettingsError
        If a value cannot be used, or there are too many runs.
    FileError
        If a file that the study names cannot be used.
    """
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
    runs = plan.cells * plan.repeats
    if runs > MOST_RUNS:
        raise SettingsError(
            f"{file.source}: {plan.cells:,} combinations × {plan.repeats:,} repeats are {runs:,} runs; at most"
            f" {MOST_RUNS:,} are possible"
        )
    return dataclasses.replace(plan, digest=_digest(file, plan))


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
                raise SettingsError(f"axes: recording takes the place of {key}; remove one of them")
        sources = [recorded(folder / name, name, study.reading or Reading()) for name in axes.recording]
    repairs = tuple(Repair(text, _repair_us(text)) for text in axes.repair)
    return FeltPlan(
        name=study.name,
        digest="",
        seed=study.seed,
        repeats=study.repeats,
        sources=tuple(sources),
        grid=Grid((tuple(range(len(sources))), coders(axes), links(axes), repairs)),
        swept=tuple(axes.parameters),
    )


def _ordering(study: OrderingStudy) -> OrderingPlan:
    axes = study.axes
    for rate_hz in axes.rate_hz:
        if not 100.0 <= rate_hz <= 10_000.0:
            raise SettingsError(f"axes: rate_hz is {rate_hz:g}; it must be between 100 and 10000")
    return OrderingPlan(
        name=study.name,
        digest="",
        seed=study.seed,
        repeats=study.repeats,
        grid=Grid((coders(axes), links(axes), tuple(axes.rate_hz), tuple(map(parse_observer, axes.observer)))),
        swept=tuple(axes.parameters),
        answers=study.answers,
    )


def _repair_us(text: str) -> int | None:
    if text == "round-trip":
        return None
    return NEVER_US if text == "never" else parse_time_us(text)


def _located(codec: str, folder: Path) -> str:
    """Return a codec with the path of a file of the user relative to the folder of the study."""
    file, separator, rest = codec.partition(".py:")
    return f"{folder / file}.py:{rest}" if separator else codec


def _digest(file: StudyFile, plan: AnyPlan) -> str:
    """Return a SHA-256 of all that determines the numbers of a run: settings, scenes, recordings, files of codecs."""
    content: dict[str, Any] = {"study": file.study.model_dump(mode="json", exclude=SHOWN_ONLY), "code": {}}
    for text in file.study.axes.codec:
        name, separator, _ = text.partition(".py:")
        if separator:
            path = file.folder / f"{name}.py"
            content["code"][name] = hashlib.sha256(read_bytes(path, LARGEST_DOCUMENT)).hexdigest()
    if isinstance(plan, FeltPlan):
        content["sources"] = [source.fingerprint() for source in plan.sources]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()
