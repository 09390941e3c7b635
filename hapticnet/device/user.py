"""A fingertip device of the user's: anything with a method ``exchange`` or ``apply``."""

import math
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Final, Protocol

from hapticnet.capabilities import capabilities_of
from hapticnet.device.base import Device, Reading, presses
from hapticnet.errors import SettingsError, UserCodeError, printable, shortened
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.user_code import attribute_of, axes_of, failure, method_of, raised, report_of, short, vector_from

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TRAVEL_M: Final = 0.005  # travel [m] of a device that declares none
LONGEST_TEXT: Final = 200  # most characters of a description or status


class HasExchange(Protocol):
    """Required method of a user's object that presses a finger; see `UserDevice` for optional members."""

    def exchange(self, displacement_m: float, now_us: int, /) -> Reading | float | None:
        """Set the displacement [m] of the platform; return the force [N] that its sensor reads. It must not wait."""
        ...


class HasApply(Protocol):
    """Required method of a user's object that renders a force itself; see `UserActuator` for optional members."""

    def apply(self, force_n: Any, now_us: int, /) -> Any:
        """Render a force [N], a number or, of several axes, a tuple; return the sensed one or None. Must not wait."""
        ...


class UserObject:
    """Base of both kinds of objects: capabilities, a description, a status, a report, and one checked method.

    Attributes with the names of `Capabilities` declare what it can do. `made` has the method, written as its `form`;
    messages call it `what`, such as "device own.py:Mine". An object may also have ``vibrate(samples, rate_hz)``, which
    plays accelerations [m/s²] beside the force, those of each tick in which something is felt. It limits them itself,
    and must not wait.

    Raise SettingsError if the method is missing or cannot be called this way, or an attribute cannot be used.
    """

    def __init__(self, made: Any, form: str, what: str) -> None:
        self.made = made
        self.what = what
        self._call: Callable[[Any, int], Any] = method_of(made, form, what)
        self._method = f"{type(made).__name__}.{form.partition('(')[0]}"
        self.capabilities = capabilities_of(made, what, replace(presses(TRAVEL_M), axes=axes_of(made, what)))
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
    ``description``, ``status``, ``report()``, which returns a dictionary, and of the capabilities ``travel_m`` (default
    5 mm), ``max_force_n`` (default 5 N, the most of the force loop) and ``slew_n_per_s`` (default 50 N/s).
    """

    def __init__(self, made: HasExchange, what: str = "the device") -> None:
        super().__init__(made, "exchange(displacement_m, now_us)", what)
        if self.capabilities.axes > 1 or self.capabilities.grounded:
            raise SettingsError(
                f"{what}: a platform presses a finger on one axis; for others, define apply(force_n, now_us)"
            )
        self.least_rate_hz = 0.0  # the user chooses the rate, through the master's
        self._otherwise = "it gives no reading"

    def exchange(self, displacement_m: float, now_us: int) -> Reading | None:
        """Set the displacement [m], limited to the travel, and return the newest reading.

        Raise UserCodeError if the object raises, or returns something other than a force, a reading or None.
        """
        set_m = min(max(displacement_m, 0.0), self.capabilities.travel_m) if math.isfinite(displacement_m) else 0.0
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

    Its ``apply(force_n, now_us)`` renders a force [N] and returns the sensed one, or None if it senses none. A force is
    a number, 0 or more; if it moves the hand (``grounded``), of either sign; of several ``axes``, a tuple. Optional:
    ``description``, ``status``, ``report()`` and capabilities: ``axes`` (default 1), ``max_force_n`` (default 5 N),
    ``slew_n_per_s`` (default 50 N/s), ``rate_hz`` (default: with each tick), ``travel_m`` and ``grounded``.
    """

    def __init__(self, made: HasApply, what: str = "the device") -> None:
        super().__init__(made, "apply(force_n, now_us)", what)

    def apply(self, force_n: Vector, now_us: int) -> Vector | None:
        """Render a force [N] on the axes of the device; return the force sensed [N], or None.

        Raise UserCodeError if the object raises, or returns something other than a force or None.
        """
        axes = self.capabilities.axes
        try:
            result = self._call(force_n[0] if axes == 1 else force_n, now_us)
        except BaseException as error:
            raise failure(self._method, error) from error
        if result is None:
            return None
        if axes == 1:
            if not _is_finite(result):
                raise self.refuse(result, "a finite number [N] or None")
            return (float(result),)
        return vector_from(result, axes, self._method, "N")

    def rest(self, now_us: int) -> None:
        """Render no force; raise UserCodeError if the object raises."""
        self.apply((0.0,) * self.capabilities.axes, now_us)


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


def _text(value: Any) -> str:
    return shortened(printable(str(value)), LONGEST_TEXT)
