"""The interface of an operator, which moves the tool, and users' objects behind it."""

from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from hapticnet.capabilities import Capabilities, capabilities_of
from hapticnet.checks import check_integer
from hapticnet.parts import Parts, declared, force_axes, written
from hapticnet.samples import PositionSample, Vector
from hapticnet.user_code import attribute_of, failure, method_of, vector_from

LONGEST_STEP_US: Final = 20_000  # longest time [µs] between two calls that lets the force on a hand rise


class Operator(Protocol):
    """A source of tool positions: a script, a recording, a person, or a program.

    An operator that needs the force also defines ``feel(t_us: int, force_n: Vector) -> None``. It is called in
    every tick before `sample`, with the held force [N] of all axes.
    """

    @property
    def axes(self) -> int:
        """Number of axes of a position."""

    @property
    def duration_us(self) -> int | None:
        """Duration of the motion [µs], or None if it is endless."""

    def sample(self, t_us: int) -> PositionSample:
        """Return the position of the tool at `t_us` [µs] from the start of the motion."""


def operator_parts(operator: Operator) -> Parts:
    """Return the parts of an operator's positions; none if they are one position."""
    parts: Parts = getattr(operator, "parts", ())
    return parts


class HasSample(Protocol):
    """Required method of a user's object that moves the tool; see `UserOperator` for optional members."""

    def sample(self, t_us: int, /) -> PositionSample | float | Sequence[float]:
        """Return the position [m] of the tool at a time [µs] since the start. It must not wait."""


class UserOperator:
    """An object of the user's, with its results checked. Satisfies `Operator`.

    Its ``sample(t_us)`` returns the position [m] at a time [µs] since the start: a `PositionSample`, a number, or a
    sequence of numbers, one for each axis. Optional: ``feel(t_us, force_n)``, called in every tick with the force held
    [N], a tuple, whose first part is within the capabilities that it declares (``max_force_n``, ``slew_n_per_s``,
    ``travel_m``: by default no limit; ``grounded``: by default whether it has a ``max_force_n``); ``axes`` (1 to 3;
    default 1) or ``parts``, such as ``("force:3", "torque:3", "grip:1")`` (`hapticnet.parts`); ``clutched``, true while
    the hand moves without the tool (`operator.mapping`); ``duration_us``,
    after which the run ends. `what` names the object in messages, such as "operator own.py:Mine". Raise SettingsError
    if a method cannot be called this way, or an attribute cannot be used.
    """

    __slots__ = (
        "_feel", "_felt_n", "_felt_us", "_hand_feel", "_hand_sample", "_sample", "_unit", "axes", "capabilities",
        "duration_us", "hand", "parts", "what",
    )  # fmt: skip

    def __init__(self, hand: HasSample, what: str = "the operator") -> None:
        self.hand = hand
        self.what = what
        kind = type(hand).__name__
        self._sample, self._feel = f"{kind}.sample", f"{kind}.feel"
        self._hand_sample: Callable[[int], Any] = method_of(hand, "sample(t_us)", what)
        self._hand_feel: Callable[[int, Vector], Any] | None = None
        if attribute_of(hand, "feel", None, what) is not None:
            self._hand_feel = method_of(hand, "feel(t_us, force_n)", what)
        self.axes, self.parts = declared(hand, what)
        self._unit = written(self.parts, 1) if self.parts else "m"  # for messages
        duration_us: int | None = attribute_of(hand, "duration_us", None, what)
        if duration_us is not None:
            check_integer(f"{what}: duration_us", duration_us, 1, 2**62, "µs")
            duration_us = int(duration_us)
        self.duration_us = duration_us
        of_force = force_axes(self.axes, self.parts)
        pushes = attribute_of(hand, "max_force_n", None, what) is not None
        self.capabilities = capabilities_of(hand, what, Capabilities(axes=of_force or 1, grounded=pushes))
        self._felt_n: Vector = (0.0,) * of_force
        self._felt_us = 0

    @property
    def clutched(self) -> bool:
        """Whether the object lifts the clutch (`operator.mapping`).

        Raise AttributeError if it has none, and UserCodeError if the object raises.
        """
        try:
            return bool(self.hand.clutched)  # type: ignore[attr-defined]
        except AttributeError:
            raise
        except BaseException as error:
            raise failure(f"{type(self.hand).__name__}.clutched", error) from error

    def sample(self, t_us: int) -> PositionSample:
        """Return the position at a time [µs]; UserCodeError if the object raises, or returns an invalid position."""
        try:
            result = self._hand_sample(t_us)
            if type(result) is PositionSample:
                result = result.position_m
            position_m = vector_from(result, self.axes, self._sample, self._unit)
        except BaseException as error:
            raise failure(self._sample, error) from error
        return PositionSample(t_us, position_m)

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Tell the object the force held at `t_us` [µs], within its limits; raise UserCodeError if it raises."""
        if self._hand_feel is None:
            return
        step_us, self._felt_us = min(max(0, t_us - self._felt_us), LONGEST_STEP_US), t_us
        of_force = len(self._felt_n)
        self._felt_n = self.capabilities.limited(force_n[:of_force], self._felt_n, step_us)
        try:
            self._hand_feel(t_us, (*self._felt_n, *force_n[of_force:]))
        except BaseException as error:
            raise failure(self._feel, error) from error
