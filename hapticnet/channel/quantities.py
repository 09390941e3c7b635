"""Times, shares and rates as written in a channel specification: 20ms, 2%, 1Mbit/s.

Formatted quantities are read back as exactly the same number.
"""

import re
from collections.abc import Mapping
from typing import Final

from hapticnet.errors import SettingsError

LONGEST_US: Final = 3_600_000_000
"""Longest time [µs] in a channel's settings: one hour, far beyond any link that carries touch."""

FASTEST_BIT_PER_S: Final = 10**12
"""Fastest bottleneck [bit/s]: 1 Tbit/s, where a packet takes less than a nanosecond."""

_TIME_UNITS: Final = {"us": 1, "µs": 1, "ms": 1_000, "s": 1_000_000}
_RATE_UNITS: Final = {"bit/s": 1, "kbit/s": 10**3, "mbit/s": 10**6, "gbit/s": 10**9}
_QUANTITY: Final = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(\D*)", re.ASCII | re.IGNORECASE)


def parse_time_us(text: str) -> int:
    """Return a time such as 20ms in whole microseconds."""
    return _whole(
        text, _TIME_UNITS, LONGEST_US, f"a time such as 20ms, in us, ms or s, up to {format_time(LONGEST_US)}"
    )


def parse_rate_bit_per_s(text: str) -> int:
    """Return a rate such as 1Mbit/s in whole bits per second."""
    expected = f"a rate such as 1Mbit/s, in bit/s, kbit/s, Mbit/s or Gbit/s, up to {format_rate(FASTEST_BIT_PER_S)}"
    return _whole(text, _RATE_UNITS, FASTEST_BIT_PER_S, expected)


def parse_share(text: str) -> float:
    """Return a share such as 2% or 0.02 as a fraction of 1."""
    number, unit = _number_and_unit(text)
    # float("7") / 100 is the double nearest to 0.07; 7 * 0.01 is not.
    share = number / 100.0 if unit == "%" else number
    if unit not in ("", "%") or not 0.0 <= share <= 1.0:
        raise SettingsError(f'"{text[:60]}" is not a share such as 2% or 0.02, from 0% to 100%')
    return share


def parse_number(text: str) -> float:
    """Return a bare number."""
    number, unit = _number_and_unit(text)
    if unit:
        raise SettingsError(f'"{text[:60]}" is not a bare number such as 3')
    return number


def format_time(time_us: int) -> str:
    """Return a time as a whole number in the largest possible unit."""
    return _in_largest_unit(time_us, {"s": 1_000_000, "ms": 1_000, "us": 1})


def time_in_words(time_us: int) -> str:
    """Return a time as `format_time` does, with a space before the unit, for sentences."""
    return re.sub(r"(?<=\d)(?=[a-z])", " ", format_time(time_us))


def format_rate(rate_bit_per_s: int) -> str:
    """Return a rate as a whole number in the largest possible unit."""
    return _in_largest_unit(rate_bit_per_s, {"Gbit/s": 10**9, "Mbit/s": 10**6, "kbit/s": 10**3, "bit/s": 1})


def format_share(share: float) -> str:
    """Return a share in percent if that reads back as the same number, else as a fraction of 1."""
    percent = f"{share * 100.0:.12g}"
    return f"{percent}%" if float(percent) / 100.0 == share else repr(share)


def _number_and_unit(text: str) -> tuple[float, str]:
    match = _QUANTITY.fullmatch(text.strip())
    return (float(match[1]), match[2].strip().lower()) if match else (float("nan"), "")


def _whole(text: str, units: Mapping[str, int], largest: int, expected: str) -> int:
    number, unit = _number_and_unit(text)
    value = number * units.get(unit, float("nan"))
    # NaN compares false with everything, so this form rejects it too.
    if not 0.0 <= value <= largest:
        raise SettingsError(f'"{text[:60]}" is not {expected}')
    return round(value)


def _in_largest_unit(value: int, units: Mapping[str, int]) -> str:
    unit = next(unit for unit, size in units.items() if value % size == 0)
    return f"{value // units[unit]}{unit}"
