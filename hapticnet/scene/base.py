"""The interface of anything that a master touches (scene, robot, engine or recording), and users' objects."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol, TypeAlias

from hapticnet.errors import SettingsError, UserCodeError
from hapticnet.parts import Parts, declared, written
from hapticnet.samples import ForceSample, PositionSample
from hapticnet.scene.ahead import LookAhead
from hapticnet.stiffness_bound import StiffnessBound
from hapticnet.user_code import attribute_of, failure, method_of, raised, report_of, short, vector_from


class Touchable(Protocol):
    """Something that answers each position with a force. `scene.Scene` is one.

    If it also has an attribute ``breaches``, recordings and reports show it: surfaces breached so far. If it has a
    method ``welcome(master: str)``, that is called once, before the first step, with the name of the master; an
    exception refuses the session. If it has a method ``ahead()``, that returns the layers to be met after the newest
    position: a sequence of `scene.ahead.LayerAhead`, the nearest first, or None if unknown. It is
    called after a step, at most as often as ``step``, and must not wait.

    If it has a method ``next_line()``, that returns the next message for a person, or None; it is asked a few times a
    second, and its masters are told too. If it has a method ``report()``, the session's report has what that returns.

    If it has a method ``stiffness_bound()``, that returns a `StiffnessBound` for the newest position, or None if
    unknown. Such a scene may be stepped at positions that the master did not send, but that are within the box
    of the newest bound. A robot that must only move on received positions must not have it.

    If it has a method ``copy()``, that returns an independent scene in the same state, in about 10 µs. A slave steps
    copies at positions that it expects, and throws them away. Copies must move nothing that is real.

    If it has a method ``vibration(start_us, samples, rate_hz)``, that returns as many accelerations [m/s²] of one axis
    at that rate, the first at the time `start_us` of ``step``, or None if nothing vibrates. It is called about a
    hundred times a second, after a step at or behind the end of that time, and never on copies.

    If it has a method ``shapes()``, that returns how the scene looks now: a sequence of `scene.shapes.Shape`, always in
    the same order; an object that is returned again has not moved. A slave calls it at most 30 times a second, while a
    page is open, after a force is sent.

    A real object without copies may have an attribute ``moves_ahead_n``: it may be stepped at positions where the hand
    is expected, while the round trip is short (`node.hand_predictor.LONGEST_LEAD_US`) and the force is below this many
    newtons. **It then moves to places where the hand may never be.**

    If it has an attribute ``parts`` that is not empty, its positions and forces have those parts (`hapticnet.parts`).
    If it has an attribute ``frame``, that tells the person at the master where its axes point, in at most 64 bytes.
    """

    @property
    def axes(self) -> int:
        """Number of axes of positions and forces."""

    @property
    def name(self) -> str:
        """Name in messages and reports, at most 64 bytes."""

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force at a position, positive when it pushes the operator out.

        Called for each position, in order of time, within the time of a tick: it must not wait. A SampleError refuses a
        position, which is counted; any other exception ends or pauses the session.
        """


Vibrate: TypeAlias = Callable[[int, int, float], "Sequence[float] | None"]
"""The method ``vibration`` of a scene."""


def vibration_method(scene: Touchable) -> Vibrate | None:
    """Return the method ``vibration`` of a scene; None if it makes none."""
    vibration: Vibrate | None = getattr(scene, "vibration", None)
    return vibration


def look_ahead_of(scene: Touchable) -> LookAhead | None:
    """Return the method ``ahead`` of a scene; None if it announces nothing."""
    ahead: LookAhead | None = getattr(scene, "ahead", None)
    return ahead


def bound_method(scene: Touchable) -> Callable[[], StiffnessBound | None] | None:
    """Return the method ``stiffness_bound`` of a scene; None if it only accepts sent positions."""
    bound: Callable[[], StiffnessBound | None] | None = getattr(scene, "stiffness_bound", None)
    return bound


def copy_method(scene: Touchable) -> Callable[[], Touchable] | None:
    """Return the method ``copy`` of a scene; None if it cannot be copied."""
    copy: Callable[[], Touchable] | None = getattr(scene, "copy", None)
    return copy


def lead_limit_n(scene: Touchable) -> float:
    """Return the force [N] up to which a scene may be stepped where the hand is expected; 0 if it must not be."""
    return float(getattr(scene, "moves_ahead_n", 0.0))


def scene_frame(scene: Touchable) -> str | None:
    """Return where the axes of a scene point, in words; None if it does not say."""
    frame: str | None = getattr(scene, "frame", None)
    return frame


def scene_parts(scene: Touchable) -> Parts:
    """Return the parts of a scene's positions and forces; none if they are one force."""
    parts: Parts = getattr(scene, "parts", ())
    return parts


def breaches_of(scene: Touchable) -> int:
    """Return the number of surfaces breached so far; 0 if unknown."""
    return int(getattr(scene, "breaches", 0))


LONGEST_NAME: Final = 64  # most bytes of a scene's name, which travels to the master


class HasStep(Protocol):
    """Required method of a user's object that is touched; see `UserScene` for optional members."""

    def step(self, sample: PositionSample, /) -> ForceSample | float | Sequence[float]:
        """Return the force [N] at a position, positive when it pushes the tool out. It must not wait."""


class UserScene:
    """An object of the user's, with its results checked. Satisfies `Touchable`.

    Its ``step(sample)`` is called with a `PositionSample` and returns a `ForceSample`, a number, or a sequence of
    numbers, one for each axis [N]. Optional attributes: ``axes`` (1 to 3; default 1) or ``parts``, such as
    ``("force:3", "torque:3", "grip:1")``; ``name``, ``frame`` (where the axes point, in words), ``breaches`` and
    ``moves_ahead_n``; optional methods:
    ``welcome(master)``, ``next_line()``, ``report()``, ``ahead()``, ``stiffness_bound()``, ``copy()``,
    ``vibration(start_us, samples, rate_hz)`` and ``shapes()``. `what` names the object in messages, such as "scene
    own.py:Mine". Raise SettingsError if ``step`` cannot be called with one argument, or an attribute cannot be used.
    """

    __slots__ = (
        "__weakref__",
        "_method",
        "_step",
        "_unit",
        "ahead",
        "axes",
        "copy",
        "frame",
        "moves_ahead_n",
        "name",
        "next_line",
        "parts",
        "shapes",
        "stiffness_bound",
        "touched",
        "vibration",
        "what",
    )

    def __init__(self, touched: HasStep, what: str = "the scene") -> None:
        self.touched = touched
        self.what = what
        self._step: Callable[[PositionSample], Any] = method_of(touched, "step(sample)", what)
        self._method = f"{type(touched).__name__}.step"
        self.axes, self.parts = declared(touched, what)
        self._unit = written(self.parts, 1) if self.parts else "N"  # for messages
        self.name = _text(touched, "name", type(touched).__name__, what) or ""
        self.frame = _text(touched, "frame", None, what)
        # The object's methods of these names; None if it has none
        self.ahead: LookAhead | None = self._optional("ahead")
        self.next_line: Callable[[], str | None] | None = self._optional("next_line")
        self.stiffness_bound: Callable[[], StiffnessBound | None] | None = self._optional("stiffness_bound")
        self.vibration: Vibrate | None = self._optional("vibration")
        self.shapes = self._optional("shapes")
        moves_ahead_n = attribute_of(touched, "moves_ahead_n", 0.0, what)
        is_number = isinstance(moves_ahead_n, int | float) and type(moves_ahead_n) is not bool
        if not is_number or not 0.0 <= moves_ahead_n < math.inf:
            raise SettingsError(f"{what}: moves_ahead_n is {short(moves_ahead_n)}; it must be a force in newtons")
        self.moves_ahead_n = float(moves_ahead_n)
        self.copy: Callable[[], UserScene] | None = _copying(touched, self.axes, self._optional("copy"), what)

    @property
    def breaches(self) -> int:
        """Number of breaches that the object counts; 0 if it does not."""
        try:
            return int(getattr(self.touched, "breaches", 0))
        except BaseException as error:  # it is for reports only
            raised(error)
            return 0

    def report(self) -> dict[str, Any]:
        """Return the object's report; empty if it has no such method."""
        return report_of(self.touched)

    def welcome(self, master: str) -> None:
        """Tell the object the name of its master, if it has a method ``welcome``."""
        welcome: Callable[[str], Any] | None = getattr(self.touched, "welcome", None)
        if welcome is not None:
            try:
                welcome(master)
            except BaseException as error:
                raise failure(f"{type(self.touched).__name__}.welcome", error) from error

    def step(self, sample: PositionSample) -> ForceSample:
        """Return the force at a position; UserCodeError if the object raises, or returns an invalid force."""
        try:
            result = self._step(sample)
            if type(result) is ForceSample:
                result = result.force_n
            force_n = vector_from(result, self.axes, self._method, self._unit)
        except BaseException as error:
            raise failure(self._method, error) from error
        return ForceSample(sample.t_us, force_n)

    def _optional(self, name: str) -> Callable[..., Any] | None:
        """Return a method that the object may have; its exceptions become UserCodeErrors."""
        method = attribute_of(self.touched, name, None, self.what)
        if method is None:
            return None
        what = f"{type(self.touched).__name__}.{name}"  # not `self`: copies are to go without a garbage collection

        def call(*given: Any) -> Any:
            try:
                return method(*given)
            except BaseException as error:
                raise failure(what, error) from error

        return call


def _text(touched: HasStep, name: str, default: str | None, what: str) -> str | None:
    """Return an attribute that is text, or `default`; raise SettingsError if it cannot travel to a master."""
    text = attribute_of(touched, name, default, what)
    if text is None and default is None:
        return None
    if not isinstance(text, str) or not text.isprintable() or not 0 < len(text.encode()) <= LONGEST_NAME:
        raise SettingsError(f"{what}: {name} is {short(text)}; it must be text, 1 to {LONGEST_NAME} printable bytes")
    return text


def _copying(
    touched: HasStep, axes: int, copied: Callable[[], Any] | None, what: str
) -> Callable[[], UserScene] | None:
    """Return what copies a user's scene; None if it has no method ``copy``."""
    if copied is None:
        return None

    def copy() -> UserScene:
        other = UserScene(copied(), what)
        if other.touched is touched or other.axes != axes:
            raise UserCodeError(f"{what}: copy must return another object, of as many axes")
        return other

    return copy
