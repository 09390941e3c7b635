"""Checks of settings, and the messages that say what is wrong and what is allowed."""

from collections.abc import Iterable
from difflib import get_close_matches

from hapticnet.errors import SettingsError


def check_parameter(
    name: str, value: float, smallest: float, largest: float, unit: str = "", *, zero_allowed: bool = False
) -> None:
    """Check that ``smallest <= value <= largest``, or that `value` is 0 where `zero_allowed`.

    Raises SettingsError if the value is out of range or NaN. The message has the form "NAME is VALUE; it must be
    between A and B".
    """
    try:
        # NaN compares false with everything, so this form rejects it too.
        good = bool(smallest <= value <= largest or (zero_allowed and value == 0))
    except (TypeError, ValueError):  # text, or an array
        raise SettingsError(f"{name} is of type {type(value).__name__}; it must be a number") from None
    if not good:
        zero = "0 or " if zero_allowed else ""
        raise _out_of_range(name, value, f"{zero}between {_text(smallest)} and {_text(largest)}", unit)


def check_integer(name: str, value: float, smallest: int, largest: int, unit: str = "") -> None:
    """Check that `value` is a whole number from `smallest` to `largest`. Raises SettingsError if it is not."""
    check_parameter(name, value, smallest, largest, unit)
    if value != int(value):
        raise _out_of_range(name, value, "a whole number", "")


def check_above(name: str, value: float, bound: float, largest: float, unit: str = "") -> None:
    """Check that ``bound < value <= largest``. Raises SettingsError if the value is out of range or NaN."""
    if not bound < value <= largest:
        raise _out_of_range(name, value, f"above {_text(bound)} and at most {_text(largest)}", unit)


def axes_of(count: int) -> str:
    """Return a number of axes in words: "1 axis", "3 axes"."""
    return "1 axis" if count == 1 else f"{count} axes"


def meant(name: str, known: Iterable[str]) -> str:
    """Return the suggestion of a similar known name, to follow an unknown one; empty if there is none."""
    close = get_close_matches(name, known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _out_of_range(name: str, value: float, expected: str, unit: str) -> SettingsError:
    unit = unit and f" {unit}"
    return SettingsError(f"{name} is {value}{unit}; it must be {expected}{unit}")


def _text(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
