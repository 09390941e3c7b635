"""A study as its file states it: STUDY.toml with the values of its axes, and the number of repeats."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field

from hapticnet.channel.settings import BernoulliLoss, format_time, parse_jitter, parse_loss, parse_time_us
from hapticnet.channel.spec import parse_channel
from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import HapticnetError
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION

MOST_RUNS: Final = 10**9
MOST_REPEATS: Final = 10**8
MOST_VALUES: Final = 10_000
FORMS: Final = "one value or a list of values"
NONE: Final = "none"
Value = TypeVar("Value")


def _as_list(given: Any) -> list[Any]:
    """Return the values of an axis. Raise ValueError with a message for a person."""
    values = given if isinstance(given, list) else [given]
    if not values:
        raise ValueError(f"an axis needs at least one value; write {FORMS}")
    if len(values) > MOST_VALUES:
        raise ValueError(f"an axis has at most {MOST_VALUES} values, and this one has {len(values)}")
    return values


def _numbers(given: Any) -> list[float]:
    values = _as_list(given)
    for value in values:
        if not _is_number(value):
            raise ValueError(f"each value must be a number, and {value!r} is not; write {FORMS}")
    return _without_repeats([float(value) for value in values])


def _texts(given: Any) -> list[str]:
    values = _as_list(given)
    for value in values:
        if not isinstance(value, str) or not value:
            raise ValueError(f"each value must be text in quotes, and {value!r} is not")
    return _without_repeats(values)


def _without_repeats(values: list[Value]) -> list[Value]:
    return list(dict.fromkeys(values))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _in_words(parse: Callable[[Any], Value], text: Any) -> Value:
    """Return a text parsed; an error of the parser becomes one that the model reports with the key."""
    try:
        return parse(text)
    except HapticnetError as error:
        raise ValueError(str(error)) from error


def _time(text: str) -> str:
    return format_time(_in_words(parse_time_us, text))


def _channel(text: str) -> str:
    _in_words(parse_channel, text)
    return text


def _jitter(text: str) -> str:
    return text if text == NONE else _in_words(parse_jitter, text).describe()


def _repair(text: str) -> str:
    return text if text in ("round-trip", "never") else _time(text)


def _loss(value: Any) -> str:
    if _is_number(value):
        text = _in_words(lambda share: BernoulliLoss(float(share)).describe(), value)
    elif isinstance(value, str):
        text = value if value == NONE else _in_words(parse_loss, value).describe()
    else:
        raise ValueError(
            f"each value must be a share or text such as '2%' or 'gilbert:0.004,0.4', and {value!r} is neither"
        )
    return NONE if text == "0%" else text


def _each(convert: Callable[[Any], str]) -> AfterValidator:
    return AfterValidator(lambda values: _without_repeats(list(map(convert, values))))


Numbers: TypeAlias = Annotated[list[float], BeforeValidator(_numbers)]
Texts: TypeAlias = Annotated[list[str], BeforeValidator(_texts)]
Times: TypeAlias = Annotated[Texts, _each(_time)]
Channels: TypeAlias = Annotated[Texts, _each(_channel)]
Jitters: TypeAlias = Annotated[Texts, _each(_jitter)]
Losses: TypeAlias = Annotated[list[Any], BeforeValidator(_as_list), _each(_loss)]
Repairs: TypeAlias = Annotated[Texts, _each(_repair)]
Flags: TypeAlias = Annotated[list[bool], BeforeValidator(_as_list), AfterValidator(_without_repeats)]


class Axes(BaseModel):
    """What is touched; codecs and their law; the rate of positions; the networks; when a lost update is replaced."""

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
    scene: Texts | None = None
    hand: Texts | None = None
    recording: Texts | None = None
    repair: Repairs = ["round-trip"]
    predicted: Flags = [False]


class Reading(BaseModel):
    """How recordings are read, as by the options of ``hapticnet compare``."""

    model_config = STRICT

    column: str | None = None
    position: str | None = None
    position_scale: float | None = None
    time: str | None = None
    rate_hz: float | None = None
    missing: Literal["refuse", "drop", "hold"] = "refuse"


class Shown(BaseModel):
    """Defaults of ``hapticnet sweep show``, by names of columns; they do not change the results."""

    model_config = STRICT

    by: Texts | None = None
    of: Texts | None = None
    x: str | None = None
    y: str | None = None
    line: Texts | None = None
    panel: Texts | None = None
    where: str | None = None


class Study(BaseModel):
    """Forces felt over a network beside the true ones; see `node.closed_loop`. More repeats only add runs."""

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    repeats: Annotated[int, Field(ge=1, le=MOST_REPEATS)] = 1
    show: Shown = Field(default_factory=Shown)
    axes: Axes = Field(default_factory=Axes)
    reading: Reading | None = None


@dataclass(frozen=True, slots=True)
class StudyFile:
    """A study with its text and its folder, to which its paths are relative."""

    study: Study
    text: str
    source: str
    folder: Path


def read_study(path: Path) -> StudyFile:
    """Return the study in a TOML file; FileError if it is not TOML, SettingsError for a wrong key or value."""
    text = read_document(path)
    return StudyFile(parse_document(text, str(path), Study), text, str(path), path.parent)
