"""A fingertip device of the user's: anything with a method ``exchange`` or ``apply``."""

import math
from numbers import Real
from typing import TYPE_CHECKING, Any, Final, Protocol

from hapticnet.checks import check_above
from hapticnet.device.base import Device, Reading
from hapticnet.errors import SettingsError, UserCodeError, printable, shortened
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.samples import LARGEST_COMPONENT
from hapticnet.user_code import attribute_of, failure, method_of, raised, report_of, short

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TRAVEL_M: Final = 0.005  # travel [m] of a device that declares none
LONGEST_TEXT: Final = 200  # most characters of a description or status
LARGEST_TRAVEL_M: Final = 1.0
LARGEST_FORCE_N: Final = 1000.0


class HasExchange(Protocol):
    """Required method of a user's object that presses a finger; see `UserDevice` for optional members."""

    def exchange(self, displacement_m: float, now_us: int, /) -> Reading | float | None:
        """Set the displacement [m] of the platform; return the force [N] that its sensor reads. It must not wait."""
        ...


class HasApply(Protocol):
    """Required method of a user's object that renders a force itself; see `UserActuator` for optional members."""

    def apply(self, force_n: float, now_us: int, /) -> float | None:
        """Render a force [N]; return the sensed force, or None. It must not wait."""
        ...


class UserObject:
    """Base of both kinds of objects: limits, a description, a status, a report, and one checked method.

    `made` has the method, written as its `form`; messages call it `what`, such as "device own.py:Mine". An object may
    also have ``vibrate(samples, rate_hz)``, which plays accelerations [m/s²] beside the force, those of each tick in
    which something is felt. It limits them itself, and must not wait.

    Raise SettingsError if the method is missing or cannot be called this way, or an attribute cannot be used.
    """

    def __init__(self, made: Any, form: str, what: str) -> None:
        self.made = made
        self.what = what
        self._call: Callable[[float, int], Any] = method_of(made, form, what)
        self._method = f"{type(made).__name__}.{form.partition('(')[0]}"
        self.max_force_n = _positive(made, "max_force_n", MAX_FORCE_N, LARGEST_FORCE_N, "N", what)
        self.description = _text(attribute_of(made, "description", f"{type(made).__name__} (own device)", what))
        self._otherwise = "ready"  # the status of an object without one
        self._vibrate: Callable[[Any, float], Any] | None = attribute_of(made, "vibrate", None, what)

    @property
    def shakes(self) -> bool:
        """Whether the object renders vibration: whether it has ``vibrate(samples, rate_hz)``."""
        return self._vibrate is not None

    def vibrate(self, samples: "Sequence[float]", rate_hz: float) -> None:
        """Play accelerations [m/s²] at a rate [Hz]; raise UserCodeError if the object raises."""
        if self._vibrate is not None:
            try:
                self._vibrate(samples, rate_hz)
            except BaseException as error:
                raise failure(f"{type(self.made).__name__}.vibrate", error) from error

    @property
    def status(self) -> str:
        """The object's status, or whether it is ready."""
        try:
            return _text(getattr(self.made, "status", self._otherwise))
        except BaseException as error:  # it is for messages only
            return f"reading status raised {raised(error)}"

    def report(self) -> dict[str, Any]:
        """Return the object's report; empty if it has no such method."""
        return report_of(self.made)

    def refuse(self, result: Any, wanted: str) -> UserCodeError:
        """Return the error of a method that returned something other than `wanted`."""
        return UserCodeError(f"{self._method} returned {short(result)}; it must return {wanted}")


class UserDevice(UserObject, Device):  # type: ignore[override]  # a status that is asked for
    """An object of the user's that moves a platform, with its results checked.

    Its ``exchange(displacement_m, now_us)`` sets the displacement of the platform toward the finger [m] (0: retracted)
    and returns the force that its sensor reads [N], a `Reading`, or None while there is no reading. Optional:
    ``travel_m`` (default 5 mm), ``max_force_n`` (default 5 N), ``description``, ``status``, and ``report()``, which
    returns a dictionary.
    """

    def __init__(self, made: HasExchange, what: str = "the device") -> None:
        super().__init__(made, "exchange(displacement_m, now_us)", what)
        self.travel_m = _positive(made, "travel_m", TRAVEL_M, LARGEST_TRAVEL_M, "m", what)
        self.least_rate_hz = 0.0  # the user chooses the rate, through the master's
        self._otherwise = "it gives no reading"

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the displacement [m], limited to the travel, and return the newest reading.

        Raise UserCodeError if the object raises, or returns something other than a force, a reading or None.
        """
        set_m = min(max(displacement_m, 0.0), self.travel_m) if math.isfinite(displacement_m) else 0.0
        try:
            result = self._call(set_m, now_us)
        except BaseException as error:
            raise failure(self._method, error) from error
        self._otherwise = "it gives no reading" if result is None else "ready"
        if result is None:
            return None
        reading = result if type(result) is Reading else Reading(now_us, 0.0, result, set_m)
        if not (_is_finite(reading.force_n) and _is_finite(reading.displacement_m)):
            raise self.refuse(result, "a finite number [N], a Reading or None")
        return reading

    def rest(self, now_us: int) -> None:
        """Retract the platform; raise UserCodeError if the object raises."""
        self.exchange(0.0, now_us)


class UserActuator(UserObject):
    """An object of the user's that renders a force by itself, with its results checked.

    Its ``apply(force_n, now_us)`` renders a force [N], 0 or more, and returns the sensed force, or None if it
    senses none. Optional: ``max_force_n`` (default 5 N), ``description``, ``status`` and ``report()``.
    """

    def __init__(self, made: HasApply, what: str = "the device") -> None:
        super().__init__(made, "apply(force_n, now_us)", what)

    def apply(self, force_n: float, now_us: int) -> float | None:
        """Render a force [N]; return the force sensed [N], or None.

        Raise UserCodeError if the object raises, or returns something other than a number or None.
        """
        try:
            result = self._call(force_n, now_us)
        except BaseException as error:
            raise failure(self._method, error) from error
        if result is not None and not _is_finite(result):
            raise self.refuse(result, "a finite number [N] or None")
        return None if result is None else float(result)

    def rest(self, now_us: int) -> None:
        """Render no force; raise UserCodeError if the object raises."""
        self.apply(0.0, now_us)


def as_user_device(made: Any, what: str = "the device") -> UserDevice | UserActuator:
    """Return a user's object with its results checked: an actuator if it has ``apply``, else a platform.

    Raises SettingsError if it has neither method, or cannot be used.
    """
    if attribute_of(made, "apply", None, what) is not None:
        return UserActuator(made, what)
    if attribute_of(made, "exchange", None, what) is None:
        raise SettingsError(f"{what}: has neither exchange(displacement_m, now_us) nor apply(force_n, now_us)")
    return UserDevice(made, what)


def _is_finite(value: Any) -> bool:
    try:
        # Written so that NaN, which compares false with everything, is refused too.
        return isinstance(value, Real) and -LARGEST_COMPONENT <= float(value) <= LARGEST_COMPONENT
    except (TypeError, ValueError, ArithmeticError):
        return False


def _positive(made: Any, name: str, default: float, largest: float, unit: str, what: str) -> float:
    value = attribute_of(made, name, default, what)
    if not isinstance(value, Real) or isinstance(value, bool):
        raise SettingsError(f"{what}: {name} is {short(value)}; it must be a number [{unit}]")
    check_above(f"{what}: {name}", float(value), 0.0, largest, unit)
    return float(value)


def _text(value: Any) -> str:
    return shortened(printable(str(value)), LONGEST_TEXT)
