"""The interface of an operator, which moves the tool, and users' objects behind it."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hapticnet.checks import check_integer, check_parameter
from hapticnet.parts import Parts, declared
from hapticnet.samples import PositionSample, Vector
from hapticnet.user_code import attribute_of, failure, method_of, vector_from


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
    sequence of numbers, one for each axis. Optional: ``max_force_n``, the largest force [N] with which it pushes the
    hand, for a coupling; ``feel(t_us, force_n)``, called in every tick with the force held [N], a tuple; ``axes`` (1 to
    3; default 1) or ``parts``, such as ``("force:3", "torque:3", "grip:1")`` (`hapticnet.parts`); ``duration_us``,
    after which the run ends. `what` names the object in messages, such as "operator own.py:Mine". Raise SettingsError
    if a method cannot be called this way, or an attribute cannot be used.
    """

    __slots__ = (
        "_feel",
        "_hand_feel",
        "_hand_sample",
        "_sample",
        "axes",
        "duration_us",
        "hand",
        "max_force_n",
        "parts",
        "what",
    )

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
        duration_us: int | None = attribute_of(hand, "duration_us", None, what)
        if duration_us is not None:
            check_integer(f"{what}: duration_us", duration_us, 1, 2**62, "µs")
            duration_us = int(duration_us)
        self.duration_us = duration_us
        self.max_force_n: float = attribute_of(hand, "max_force_n", math.inf, what)
        if self.max_force_n != math.inf:
            check_parameter(f"{what}: max_force_n", self.max_force_n, 1e-6, 1e6, "N")

    def sample(self, t_us: int) -> PositionSample:
        """Return the position at a time [µs]; UserCodeError if the object raises, or returns an invalid position."""
        try:
            result = self._hand_sample(t_us)
            if type(result) is PositionSample:
                result = result.position_m
            position_m = vector_from(result, self.axes, self._sample, "m")
        except BaseException as error:
            raise failure(self._sample, error) from error
        return PositionSample(t_us, position_m)

    def feel(self, t_us: int, force_n: Vector) -> None:
        """Tell the object the force held at `t_us` [µs]; raise UserCodeError if the object raises."""
        if self._hand_feel is None:
            return
        try:
            self._hand_feel(t_us, force_n)
        except BaseException as error:
            raise failure(self._feel, error) from error
