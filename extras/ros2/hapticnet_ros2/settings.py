"""Options of robots and leaders, as text or numbers."""

import math
import os
import re
from typing import Final, TypedDict

from hapticnet.errors import SettingsError

AXES: Final = re.compile(r"(?:[+-]?[xyz]){1,3}")
NAMES: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)*")


class DdsOptions(TypedDict, total=False):
    """Options that robots and leaders share, all of them optional."""

    message: str
    """Kind of the positions: PoseStamped (default) or TransformStamped."""
    frame_id: str
    """Frame in the messages sent; empty by default."""
    domain: int | None
    """Domain of DDS. Default: ROS_DOMAIN_ID, or 0."""
    interface: str
    """Network interface. Default: as CYCLONEDDS_URI says."""
    reliable: bool
    """Whether messages are also offered to subscribers that ask for reliable ones; true by default."""
    fresh_ms: float
    """Age [ms] from which the newest message counts less, down to nothing at twice this age; 20 by default."""


def axes_from(axes: str | float) -> list[tuple[int, float]]:
    """Return index and sign of each axis named, such as ``-zxy``; the number 2 means ``xy``."""
    text = "xyz"[: int(axes)] if axes in (1, 2, 3) else str(axes)
    found = re.findall(r"([+-]?)([xyz])", text)
    if not AXES.fullmatch(text) or len({axis for _, axis in found}) < len(found):
        raise SettingsError(f"axes is {text!r}; it must be 1, 2, 3, or one to three of x, y, z, each with or without -")
    return [("xyz".index(axis), -1.0 if sign == "-" else 1.0) for sign, axis in found]


def numbers_from(name: str, text: str, count: int) -> tuple[float, ...]:
    """Return `count` finite numbers, written with ``/`` between them; SettingsError if invalid."""
    try:
        values = tuple(map(float, str(text).split("/")))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise SettingsError(f"{name} is {text!r}; it must be {count} numbers, as in {name}={'/'.join('0' * count)}")
    return values


def topic_from(namespace: str, name: str) -> str:
    """Return the name of a topic in a namespace, with a leading slash; SettingsError if ROS allows no such name."""
    topic = name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")
    if not NAMES.fullmatch(topic):
        raise SettingsError(f"{topic!r} cannot be the name of a topic of ROS: letters, digits and _ between slashes")
    return topic


def domain_from(domain: float | None) -> float:
    """Return the domain given, or else ROS_DOMAIN_ID, as ROS does; SettingsError if that is no number."""
    if domain is not None:
        return domain
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    try:
        return int(text)
    except ValueError:
        raise SettingsError(f"ROS_DOMAIN_ID is {text!r}; it must be a number") from None
