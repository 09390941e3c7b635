"""Options of robots and leaders, as text or numbers."""

import math
import os
import re
from typing import Final

from hapticnet.errors import SettingsError

AXES: Final = re.compile(r"(?:[+-]?[xyz]){1,3}")
NAMES: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)*")


def axes_from(axes: str | float) -> list[tuple[int, float]]:
    """Return index and sign of each axis named, such as ``-zxy``; of a number, the first so many of x, y and z."""
    text = "xyz"[: int(axes)] if axes in (1, 2, 3) else str(axes)
    found = re.findall(r"([+-]?)([xyz])", text)
    if not AXES.fullmatch(text) or len({axis for _, axis in found}) < len(found):
        raise SettingsError(f"axes is {text!r}; it must be 1, 2, 3, or one to three of x, y, z, each with or without -")
    return [("xyz".index(axis), -1.0 if sign == "-" else 1.0) for sign, axis in found]


def numbers_from(name: str, text: str, count: int) -> tuple[float, ...]:
    """Return so many finite numbers that are separated by ``/``."""
    try:
        values = tuple(map(float, str(text).split("/")))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise SettingsError(f"{name} is {text!r}; it must be {count} numbers, as in {name}={'/'.join('0' * count)}")
    return values


def topic_from(namespace: str, name: str) -> str:
    """Return the name of a topic in a namespace, with a leading slash."""
    topic = name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")
    if not NAMES.fullmatch(topic):
        raise SettingsError(f"{topic!r} cannot be the name of a topic of ROS: letters, digits and _ between slashes")
    return topic


def domain_from(domain: float | None) -> float:
    """Return the domain asked for, or that of the environment as in ROS."""
    if domain is not None:
        return domain
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    try:
        return int(text)
    except ValueError:
        raise SettingsError(f"ROS_DOMAIN_ID is {text!r}; it must be a number") from None
