"""The values of an axis of a study, as its file writes them: one value, a list, or a range in equal steps or ratios."""

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Final, TypeAlias, TypeVar

from pydantic import AfterValidator, BeforeValidator

from hapticnet.channel.settings import BernoulliLoss, format_time, parse_jitter, parse_loss, parse_time_us
from hapticnet.channel.spec import parse_channel
from hapticnet.errors import HapticnetError

MOST_VALUES: Final = 10_000
RANGE_KEYS: Final = ("from", "to", "count", "spacing")
SPACINGS: Final = ("linear", "ratio")
FORMS: Final = "one value, a list of values, or a range such as { from = 1, to = 4, count = 7 }"
NONE: Final = "none"

Value = TypeVar("Value")


def _as_list(given: Any) -> list[Any]:
    """Return the values of an axis, without a range's. Raise ValueError with words for a person."""
    if isinstance(given, Mapping):
        return _range(given)
    values = given if isinstance(given, list) else [given]
    if not values:
        raise ValueError(f"an axis needs at least one value; write {FORMS}")
    if len(values) > MOST_VALUES:
        raise ValueError(f"an axis has at most {MOST_VALUES} values, and this one has {len(values)}")
    return values


def _range(given: Mapping[str, Any]) -> list[Any]:
    unknown = [key for key in given if key not in RANGE_KEYS]
    missing = [key for key in RANGE_KEYS[:3] if key not in given]
    if unknown or missing:
        wrong = f"has no key {unknown[0]!r}" if unknown else f"needs {missing[0]!r}"
        raise ValueError(f"a range {wrong}; write {{ from = 1, to = 4, count = 7 }}, and spacing = 'ratio' if wanted")
    first, last, count, spacing = given["from"], given["to"], given["count"], given.get("spacing", SPACINGS[0])
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_VALUES:
        raise ValueError(f"the count of a range must be a whole number from 1 to {MOST_VALUES}; it is {count!r}")
    if spacing not in SPACINGS:
        raise ValueError(f"the spacing of a range must be {' or '.join(SPACINGS)}; it is {spacing!r}")
    if isinstance(first, str) and isinstance(last, str):  # times
        first_us, last_us = _time_us(first), _time_us(last)
        return [format_time(round(each)) for each in _between(first_us, last_us, count, spacing)]
    if not (_is_number(first) and _is_number(last)):
        raise ValueError(f"the ends of a range must be two numbers or two times; they are {first!r} and {last!r}")
    return _between(first, last, count, spacing)


def _between(first: float, last: float, count: int, spacing: str) -> list[float]:
    if spacing == "ratio" and not (first > 0 and last > 0):
        raise ValueError(f"a range in equal ratios must be above 0; it is from {first:g} to {last:g}")
    shares = [step / max(count - 1, 1) for step in range(count)]
    if spacing == "ratio":
        values = [first * (last / first) ** share for share in shares]
    else:
        values = [first + (last - first) * share for share in shares]
    # Twelve digits, so that a range has 0.3 in it and not 0.30000000000000004.
    return [float(f"{value:.12g}") for value in values]


def _numbers(given: Any) -> list[float]:
    values = _as_list(given)
    for value in values:
        if not _is_number(value):
            raise ValueError(f"each value must be a number, and {value!r} is none; write {FORMS}")
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


def _time_us(text: str) -> int:
    return _in_words(parse_time_us, text)


def _in_words(parse: Callable[[str], Value], text: str) -> Value:
    """Return what a parser makes of a text; its error becomes one that the model reports with the key."""
    try:
        return parse(text)
    except HapticnetError as error:
        raise ValueError(str(error)) from error


def _times(values: list[str]) -> list[str]:
    return _without_repeats([format_time(_time_us(value)) for value in values])


def _channels(values: list[str]) -> list[str]:
    for value in values:
        _in_words(parse_channel, value)
    return values


def _jitters(values: list[str]) -> list[str]:
    return _without_repeats([NONE if each == NONE else _in_words(parse_jitter, each).describe() for each in values])


def _losses(given: Any) -> list[str]:
    """Return losses as a channel's specification writes them; a number is a share."""
    texts = []
    for value in _as_list(given):
        if _is_number(value):
            text = _in_words(lambda share: BernoulliLoss(float(share)).describe(), value)
        elif isinstance(value, str):
            text = value if value == NONE else _in_words(parse_loss, value).describe()
        else:
            raise ValueError(
                f"each value must be a share or text such as '2%' or 'gilbert:0.004,0.4', and {value!r} is neither"
            )
        texts.append(NONE if text == "0%" else text)
    return _without_repeats(texts)


def _repairs(values: list[str]) -> list[str]:
    return [value if value in ("round-trip", "never") else format_time(_time_us(value)) for value in values]


Numbers: TypeAlias = Annotated[list[float], BeforeValidator(_numbers)]
Texts: TypeAlias = Annotated[list[str], BeforeValidator(_texts)]
Times: TypeAlias = Annotated[list[str], BeforeValidator(_texts), AfterValidator(_times)]
Channels: TypeAlias = Annotated[list[str], BeforeValidator(_texts), AfterValidator(_channels)]
Jitters: TypeAlias = Annotated[list[str], BeforeValidator(_texts), AfterValidator(_jitters)]
Losses: TypeAlias = Annotated[list[str], BeforeValidator(_losses)]
Repairs: TypeAlias = Annotated[list[str], BeforeValidator(_texts), AfterValidator(_repairs)]
