"""What a device can do, as it declares it once, and how a master adapts the force to it."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from numbers import Real
from typing import Any, Final

from hapticnet.checks import axes_of, check_above, check_integer
from hapticnet.errors import SettingsError
from hapticnet.samples import MAX_AXES, Vector
from hapticnet.user_code import attribute_of, short

LARGEST: Final = {
    "max_force_n": (1e4, "N"),
    "slew_n_per_s": (1e6, "N/s"),
    "rate_hz": (1e6, "Hz"),
    "travel_m": (10.0, "m"),
}
"""Largest values that a device may declare, and their units; infinite ones mean that there is no such limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capabilities:
    """What a device can do. SettingsError if a value is invalid.

    A cutaneous device presses the skin; a grounded one moves the hand, so that a late force can make it swing.
    """

    axes: int = 1  # of the force that it renders
    max_force_n: float = math.inf  # largest magnitude of the force [N]
    slew_n_per_s: float = math.inf  # largest rate [N/s] at which the magnitude may rise; it falls without a limit
    rate_hz: float = math.inf  # how often it takes a new force; faster than the ticks: with each
    travel_m: float = math.inf  # how far it moves
    grounded: bool = False

    def __post_init__(self) -> None:
        check_integer("axes of the device", self.axes, 1, MAX_AXES)
        for name, (largest, unit) in LARGEST.items():
            if getattr(self, name) != math.inf:
                check_above(f"{name} of the device", getattr(self, name), 0.0, largest, unit)
        if type(self.grounded) is not bool:
            raise SettingsError(f"grounded of the device is {short(self.grounded)}; it must be true or false")

    def limited(self, wanted_n: Vector, applied_n: Vector, elapsed_us: int, share: float = 1.0) -> Vector:
        """Return the force [N] nearest to the wanted one that the limits allow.

        `applied_n` is the force now, which may rise during `elapsed_us` [µs]; `share` of the largest force is allowed.
        Falling is free, and so is turning away: only what grows along the wanted direction could strike. A force that
        is not finite becomes zero.
        """
        size_n = math.hypot(*wanted_n)
        if not 0.0 < size_n < math.inf:
            return (0.0,) * len(wanted_n)
        if len(wanted_n) == 1:
            along_n = math.copysign(applied_n[0], applied_n[0] * wanted_n[0])
        else:
            along_n = sum([a * w for a, w in zip(applied_n, wanted_n, strict=True)]) / size_n
        most_n = self.max_force_n * share
        if self.slew_n_per_s != math.inf:
            most_n = min(max(along_n, 0.0) + self.slew_n_per_s * 1e-6 * elapsed_us, most_n)
        if size_n <= most_n:
            return wanted_n
        if len(wanted_n) == 1:
            return (math.copysign(most_n, wanted_n[0]),)
        return tuple([most_n / size_n * each for each in wanted_n])

    def adaptation(self, whose: str, axes: int, shown: Sequence[int] | None, largest_n: float) -> str:
        """Return in words how a force of so many axes is adapted to this device; `whose` names it.

        `shown` are the axes that it renders, None: the norm; `largest_n` is the largest force [N] requested of it.
        """
        takes = f"{whose} takes {axes_of(self.axes)}"
        takes += f" and {largest_n:.3g} N" if largest_n != math.inf else ""
        takes += f", rising by at most {self.slew_n_per_s:g} N/s" if self.slew_n_per_s != math.inf else ""
        takes += f", {self.rate_hz:g} times a second" if self.rate_hz != math.inf else ""
        does = []
        if shown is None:
            does.append("the size of the force is shown")
        elif len(shown) < axes:
            does.append(f"the force along {' and '.join('xyz'[axis] for axis in shown)} is shown")
        if largest_n != math.inf:
            does.append(f"above that {'it' if does else 'the force'} is clipped")
        return f"{takes}: {', '.join(does)}" if does else takes

    def report(self) -> dict[str, Any]:
        """Return these values for JSON; None: no limit."""
        return {name: None if value == math.inf else value for name, value in asdict(self).items()}


def capabilities_of(made: Any, what: str, default: Capabilities) -> Capabilities:
    """Return what a user's object declares by attributes with the names of `Capabilities`, otherwise `default`.

    The axes are those of `default`. Raise SettingsError if a value is invalid; `what` names the object.
    """
    values: dict[str, Any] = {}
    for field in fields(Capabilities):
        if field.name == "axes":
            continue
        value = attribute_of(made, field.name, getattr(default, field.name), what)
        if field.name in LARGEST:
            if not isinstance(value, Real) or isinstance(value, bool):
                unit = LARGEST[field.name][1]
                raise SettingsError(f"{what}: {field.name} is {short(value)}; it must be a number [{unit}]")
            value = float(value)
        values[field.name] = value
    try:
        return replace(default, **values)
    except SettingsError as error:
        raise SettingsError(f"{what}: {error}") from error
