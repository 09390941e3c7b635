"""A fingertip device of the user's: anything with a method ``exchange``."""

import json
import math
from numbers import Real
from typing import TYPE_CHECKING, Any, Final, Protocol

from hapticnet.checks import check_above
from hapticnet.device.base import Device, Reading
from hapticnet.errors import SettingsError, UserCodeError, in_words
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.user_code import attribute_of, failure, method_of, short

if TYPE_CHECKING:
    from collections.abc import Callable

TRAVEL_M: Final = 0.005
"""Travel [m] of a device that declares none."""

LARGEST_TRAVEL_M: Final = 1.0
LARGEST_FORCE_N: Final = 1000.0


class HasExchange(Protocol):
    """What a user's object must have to press a finger; see `UserDevice` for what it may have besides."""

    def exchange(self, displacement_m: float, now_us: int, /) -> Reading | float | None:
        """Set the displacement [m] of the platform; return the force [N] that its sensor reads. It must not wait."""
        ...


class UserDevice(Device):
    """An object of the user's, with its results checked.

    Parameters
    ----------
    made
        Its ``exchange(displacement_m, now_us)`` sets the displacement of the platform toward the finger [m] (0:
        retracted) and returns the force that its sensor reads [N], a `Reading`, or None while there is no reading.
        Optional: ``travel_m`` (default 5 mm), ``max_force_n`` (default 5 N), ``description``, ``status``, and
        ``report()``, which returns a dictionary.
    what
        What messages call the object, such as "device own.py:Mine".

    Raises
    ------
    SettingsError
        If ``exchange`` is missing or cannot be called this way, or an attribute cannot be used.
    """

    def __init__(self, made: HasExchange, what: str = "the device") -> None:
        self.made = made
        self._exchange: Callable[[float, int], Any] = method_of(made, "exchange(displacement_m, now_us)", what)
        self._method = f"{type(made).__name__}.exchange"
        self.travel_m = attribute_of(made, "travel_m", TRAVEL_M, what)
        self.max_force_n = attribute_of(made, "max_force_n", MAX_FORCE_N, what)
        for name, value, largest, unit in (
            ("travel_m", self.travel_m, LARGEST_TRAVEL_M, "m"),
            ("max_force_n", self.max_force_n, LARGEST_FORCE_N, "N"),
        ):
            if not isinstance(value, Real) or isinstance(value, bool):
                raise SettingsError(f"{what}: {name} is {short(value)}; it must be a number [{unit}]")
            check_above(f"{what}: {name}", float(value), 0.0, largest, unit)
        self.description = str(attribute_of(made, "description", f"{type(made).__name__} (own device)", what))
        self._has_reading = False

    @property
    def status(self) -> str:  # type: ignore[override]
        """What the object says, or whether it gave a reading."""
        try:
            return str(getattr(self.made, "status", "ready" if self._has_reading else "it gives no reading"))
        except Exception as error:  # it is for messages only
            return f"reading status raised {in_words(error)}"

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the displacement [m], limited to the travel, and return the newest reading.

        Raises
        ------
        UserCodeError
            If the object raises, or returns something else than a force, a reading or None.
        """
        set_m = min(max(displacement_m, 0.0), self.travel_m) if math.isfinite(displacement_m) else 0.0
        try:
            result = self._exchange(set_m, now_us)
        except BaseException as error:
            raise failure(self._method, error) from error
        self._has_reading = result is not None
        if result is None:
            return None
        reading = result if type(result) is Reading else Reading(now_us, 0.0, result, set_m)
        for value in (reading.force_n, reading.displacement_m):
            # Written so that NaN, which compares false with everything, is refused too.
            if not (isinstance(value, Real) and -LARGEST_COMPONENT <= float(value) <= LARGEST_COMPONENT):
                raise UserCodeError(
                    f"{self._method} returned {short(result)}; it must return a finite number [N], a Reading or None"
                )
        return reading

    def report(self) -> dict[str, Any]:
        """Return what the object reports; nothing if it has no such method or raises."""
        try:
            # Through JSON, so that nothing in it can spoil the report of the run.
            return dict(json.loads(json.dumps(self.made.report(), default=str))) if hasattr(self.made, "report") else {}
        except Exception as error:
            return {"report": str(failure(f"{type(self.made).__name__}.report", error))}
