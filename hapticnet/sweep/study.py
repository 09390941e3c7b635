"""A study as its file states it: STUDY.toml with a task, its axes, and how often all of it is repeated."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BaseModel, Field

from hapticnet.checks import meant
from hapticnet.documents import STRICT, parse_document, parse_tables, read_document
from hapticnet.errors import SettingsError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION
from hapticnet.sweep.axes import Channels, Jitters, Losses, Numbers, Repairs, Texts, Times

MOST_RUNS: Final = 10**9
MOST_REPEATS: Final = 10**8


class LinkAxes(BaseModel):
    """The axes that every task has.

    Attributes
    ----------
    codec
        Codecs as written for ``--codec``.
    parameters
        Values of the codecs' parameters; each applies to the codecs that have it.
    multiplier, weber_fraction, floor_n
        The law; see `perception.WeberLaw`. "raw" has no threshold and comes once.
    rate_hz
        Positions a second.
    forward, feedback
        Networks from master to slave and back, as for ``--channel-out``.
    delay, jitter, loss
        Parts of both networks, as in a channel's specification.
    """

    model_config = STRICT

    codec: Texts = ["deadband"]
    parameters: dict[str, Numbers] = {}
    multiplier: Numbers = [1.0]
    weber_fraction: Numbers = [PAPER_WEBER_FRACTION]
    floor_n: Numbers = [PAPER_FLOOR_N]
    rate_hz: Numbers = [1000.0]
    forward: Channels = ["perfect"]
    feedback: Channels = ["perfect"]
    delay: Times | None = None
    jitter: Jitters | None = None
    loss: Losses | None = None


class FeltAxes(LinkAxes):
    """The axes of the task "felt".

    Attributes
    ----------
    scene
        Scenes as for ``--scene``: paper:SEED, a preset or a TOML file.
    hand
        Hands that touch them: "scripted" (insertions) or "palpation", or one of them with ":KEY=VALUE,…", whose keys
        are those of `InsertionSettings` and `PalpationSettings`. By default the one that suits each scene, once.
    recording
        Recordings of force and, if possible, position, in the place of scene and hand.
    repair
        Time after which a lost update is replaced; "round-trip": that of `comparison.compare`; "never".
    """

    scene: Texts | None = None
    hand: Texts | None = None
    recording: Texts | None = None
    repair: Repairs = ["round-trip"]


class OrderingAxes(LinkAxes):
    """The axes of the task "ordering".

    Attributes
    ----------
    observer
        Simulated observers, as for ``--simulate``.
    """

    observer: Texts = ["literature"]


class Reading(BaseModel):
    """How recordings are read, as by the options of ``hapticnet encode``."""

    model_config = STRICT

    column: str | None = None
    position: str | None = None
    position_scale: float | None = None
    time: str | None = None
    rate_hz: float | None = None
    missing: Literal["refuse", "drop", "hold"] = "refuse"


class Shown(BaseModel):
    """What ``hapticnet sweep show`` shows without options; it changes no number.

    Attributes
    ----------
    by
        Columns by which rows are grouped.
    of
        Columns whose mean and quantiles are shown.
    x, y
        Columns of the axes of the figure.
    line, panel
        Columns with one line, and one panel, for each combination of their values.
    where
        A condition on rows, in SQL.
    """

    model_config = STRICT

    by: Texts | None = None
    of: Texts | None = None
    x: str | None = None
    y: str | None = None
    line: Texts | None = None
    panel: Texts | None = None
    where: str | None = None


class Study(BaseModel):
    """What the files of all tasks have.

    Attributes
    ----------
    name
        Name of the study, for tables and figures.
    seed
        Seed of all random numbers.
    repeats
        How often every combination is run. More repeats add runs and change none.
    """

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    repeats: Annotated[int, Field(ge=1, le=MOST_REPEATS)] = 1
    show: Shown = Field(default_factory=Shown)


class FeltStudy(Study):
    """Forces felt over a network beside the true ones; see `node.closed_loop`."""

    task: Literal["felt"]
    axes: FeltAxes = Field(default_factory=FeltAxes)
    reading: Reading | None = None


class OrderingStudy(Study):
    """Trials in which simulated observers order three tissues; see `study.trial`.

    Attributes
    ----------
    answers
        Observers of each kind who answer about one trial. Each has a perception of their own.
    """

    task: Literal["ordering"]
    axes: OrderingAxes = Field(default_factory=OrderingAxes)
    answers: Annotated[int, Field(ge=1, le=100_000)] = 1


AnyStudy: TypeAlias = FeltStudy | OrderingStudy

TASKS: Final[dict[str, type[FeltStudy] | type[OrderingStudy]]] = {"felt": FeltStudy, "ordering": OrderingStudy}


@dataclass(frozen=True, slots=True)
class StudyFile:
    """A study with the text and the folder that it was read from, to which its paths are relative."""

    study: AnyStudy
    text: str
    source: str
    folder: Path


def read_study(path: Path) -> StudyFile:
    """Return the study in a TOML file.

    Raises
    ------
    FileError
        If the file cannot be read or is not TOML.
    SettingsError
        If a key is unknown or missing, or a value cannot be used.
    """
    text = read_document(path)
    return StudyFile(parse_study(text, str(path)), text, str(path), path.parent)


def parse_study(text: str, source: str) -> AnyStudy:
    """Return the study in a text; messages name `source` as its origin."""
    task: Any = parse_tables(text, source).get("task")
    if not isinstance(task, str) or task not in TASKS:
        if task is None:
            raise SettingsError(f"{source}: task is missing; choose from {', '.join(TASKS)}")
        raise SettingsError(f"{source}: task is {task!r}{meant(str(task), TASKS)}; choose from {', '.join(TASKS)}")
    return parse_document(text, source, TASKS[task])
