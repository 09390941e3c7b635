"""The motion of the tool, and stimuli as functions of time and of that motion, with their payloads.

Offsets, normals, stiffness and viscosity are absolute: they do not name the position for which they were computed. A
receiver whose position differs from the one that the sender knew therefore applies the force for its own position.
"""

import struct
from collections.abc import Mapping
from typing import Final, NamedTuple, Protocol, TypeAlias

from hapticnet.codec.schemes.adaptive_predictive import CurveNumbers, check_travel, share_at
from hapticnet.codec.values import DOUBLE, HALF, SINGLE, threshold_around
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector
from hapticnet.vectors import along, dot, in_range, limited, minus, over, plus, times

Motion: TypeAlias = tuple[bool, int, int, Vector, Vector]
"""``(is_known, samples, t_us, position, velocity)`` of the tool.

`samples` is the number of positions in a row up to the present sample, and the rest belongs to the newest position
[µs, m, m/s], if there has been one. A plain tuple, because a named tuple takes ten times as long to make.
"""


def unknown_motion(axes: int) -> Motion:
    """Return the motion before the first position."""
    zeros = (0.0,) * axes
    return False, 0, 0, zeros, zeros


def moved_on(motion: Motion, t_us: int, position: Vector, lag_s: float) -> Motion:
    """Return the motion after a position.

    The velocity is the low-passed difference quotient: ``v ← (τ·v + p - p_before) / (τ + dt)``, backward Euler of
    ``τ·dv/dt = dp/dt - v``, per axis, with τ = `lag_s`. The tool counts as at rest after the first position, and after
    one whose time stamp goes back. A repeated time stamp is ignored.
    """
    is_known, samples, before_us, before, velocity = motion
    if not (is_known and t_us >= before_us):
        return True, samples + 1, t_us, position, minus(position, position)
    if t_us == before_us:
        return motion
    elapsed_s = (t_us - before_us) * 1e-6
    if len(position) == 1:  # inlined from below, because this runs at every sample
        velocity = ((position[0] - before[0] + lag_s * velocity[0]) / (lag_s + elapsed_s),)
    else:
        velocity = over(along(minus(position, before), lag_s, velocity), lag_s + elapsed_s)
    return True, samples + 1, t_us, position, velocity


def unseen(motion: Motion) -> Motion:
    """Return the motion at a sample whose position is not known: unchanged, as the receiver knows nothing newer."""
    is_known, _, t_us, position, velocity = motion
    return is_known, 0, t_us, position, velocity


UNSENT: Final = -1
HOLD: Final = 0
CURVE: Final = 1
SURFACE: Final = 2
COUPLED: Final = 3

WIDE: Final = 8  # added to the first byte if the value is float64

COUPLING: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}fee") for axes in range(1, MAX_AXES + 1)}

LARGEST_STIFFNESS: Final = 60_000.0  # largest stiffness [N/m] that can be negotiated; float16 ends at 65 504
LARGEST_VISCOSITY: Final = 1000.0  # largest viscosity [N·s/m]: a hand at 1 mm/s would feel 1 N
ROUNDING: Final = 1.002  # factor by which rounding to float16 may raise a stiffness above its bound


class MotionNumbers(CurveNumbers, Protocol):
    """Numbers of a rule that affect lines."""

    @property
    def stiffest(self) -> float:
        """Largest stiffness [N/m]."""


class Message(NamedTuple):
    """A transmitted message. Unused fields of a kind are zero."""

    kind: int  # `HOLD`, `CURVE`, `SURFACE` or `COUPLED`
    is_wide: bool  # whether the value is sent as float64
    value: Vector  # stimulus at the start of a curve, or the offset of a line [N]
    travel: Vector  # in thresholds around the value for a curve, in newtons for a coupling
    normal: Vector  # direction of a surface, times the square root of its stiffness [N/m]
    # Of a coupling [N/m, N·s/m]; `stiffness` is also that across the normal of a surface
    stiffness: float
    viscosity: float


class Line(NamedTuple):
    """The receiver's prediction after a message: see `line_at`. The travel is in newtons."""

    kind: int
    t_us: int
    offset: Vector
    travel: Vector
    normal: Vector
    stiffness: float
    viscosity: float


def no_line(axes: int) -> Line:
    """Return the line before the first message: zeros."""
    zeros = (0.0,) * axes
    return Line(UNSENT, 0, zeros, zeros, zeros, 0.0, 0.0)


def line_of(rule: CurveNumbers, t_us: int, message: Message) -> Line:
    """Return the line of a message."""
    kind, _, value, travel, normal, stiffness, viscosity = message
    if kind == CURVE:
        travel = times(travel, threshold_around(rule, value))
    return Line(kind, t_us, value, travel, normal, stiffness, viscosity)


def line_at(rule: CurveNumbers, line: Line, is_known: bool, position: Vector, velocity: Vector, t_us: int) -> Vector:
    """Return the stimulus [N] at a time, for a motion.

    With offset c, travel d, share s of the time (a parabola that is level at the horizon), position p, velocity v,
    normal κ, its unit vector n, stiffness K and viscosity B::

        hold      c
        curve     c + d·s
        surface   c + κ (κ·p) + K (p - n (n·p)), without its part along κ if that is below 0: it does not pull
        coupled   c + d·s + K p + B v

    The last two are zero where the position has never been known, and limited to `LARGEST_COMPONENT`.
    """
    if line.kind == HOLD:
        return line.offset
    if len(position) == 1:
        return (line_on_one_axis(rule, line, is_known, position[0], velocity[0], t_us),)
    if line.kind <= CURVE:
        return along(line.offset, share_at(rule, line.t_us, t_us), line.travel)
    if not is_known:
        return minus(line.offset, line.offset)
    if line.kind == SURFACE:
        x = plus(line.offset, pressed(line, position))
        out = dot(line.normal, x)
        if out < 0.0:
            x = along(x, -out / dot(line.normal, line.normal), line.normal)
        return limited(x, LARGEST_COMPONENT)
    x = along(line.offset, share_at(rule, line.t_us, t_us), line.travel)
    return limited(along(along(x, line.stiffness, position), line.viscosity, velocity), LARGEST_COMPONENT)


def line_on_one_axis(
    rule: CurveNumbers, line: Line, is_known: bool, position: float, velocity: float, t_us: int
) -> float:
    """Return the same on one axis; inlined, because this runs several times at every sample."""
    kind, x = line.kind, line.offset[0]
    if kind == HOLD:
        return x
    if kind == SURFACE:
        if not is_known:
            return 0.0
        normal = line.normal[0]
        x += normal * position * normal
        out = normal * x
        if out < 0.0:
            x += -out / (normal * normal) * normal
    else:
        s = (t_us - line.t_us) / rule.horizon_us
        x += (1.0 if s >= 1.0 else s * (2.0 - s) if s > 0.0 else 0.0) * line.travel[0]
        if kind <= CURVE:
            return x
        if not is_known:
            return 0.0
        x = x + line.stiffness * position + line.viscosity * velocity
    if x > LARGEST_COMPONENT:
        return LARGEST_COMPONENT
    return -LARGEST_COMPONENT if x < -LARGEST_COMPONENT else x


def pressed(line: Line, position: Vector) -> Vector:
    """Return the force [N] that a position adds to the offset of a surface."""
    depth = dot(line.normal, position)
    if len(position) == 1 or line.stiffness == 0.0:
        return times(line.normal, depth)
    across = along(position, -depth / dot(line.normal, line.normal), line.normal)
    return along(times(line.normal, depth), line.stiffness, across)


def message_bytes(rule: object, message: Message) -> int:
    """Return the size of the payload of a message."""
    axes = len(message.value)
    size = 1 + (8 if message.is_wide else 4) * axes
    if message.kind == HOLD:
        return size
    if message.kind == COUPLED:
        return size + 4 * axes + 4
    return size + 2 * axes + (2 if message.kind == SURFACE and axes > 1 else 0)


class MotionForm:
    """Messages as bytes. Satisfies `Form`."""

    __slots__ = ("_coupling", "_halves", "_law", "_stiffest", "_values", "axes")

    def __init__(self, axes: int, law: WeberLaw, *, stiffest: float) -> None:
        self.axes = axes
        self._law = law
        self._stiffest = stiffest
        self._values = SINGLE[axes], DOUBLE[axes]
        self._halves, self._coupling = HALF[axes], COUPLING[axes]

    def pack(self, message: Message) -> bytes:
        """Return the payload of a message."""
        kind, is_wide, value, travel, normal, stiffness, viscosity = message
        head = bytes((kind + WIDE if is_wide else kind,)) + self._values[is_wide].pack(*value)
        if kind == HOLD:
            return head
        if kind == COUPLED:
            return head + self._coupling.pack(*travel, stiffness, viscosity)
        if kind == CURVE:
            return head + self._halves.pack(*travel)
        return head + self._halves.pack(*normal) + (HALF[1].pack(stiffness) if self.axes > 1 else b"")

    def unpack(self, payload: bytes, receiver: object = None) -> Message:  # noqa: ARG002
        """Return the message in a payload; PeerError if kind, length or a number is not allowed."""
        first = payload[0] if payload else -1
        kind, is_wide = first & ~WIDE, bool(first & WIDE)
        if not HOLD <= kind <= COUPLED:
            raise PeerError(f"payload of kind {first}; it must be 0 to {COUPLED}, plus {WIDE} for float64")
        zeros: Vector = (0.0,) * self.axes
        size = message_bytes(None, Message(kind, is_wide, zeros, zeros, zeros, 0.0, 0.0))
        if len(payload) != size:
            raise PeerError(f"payload of {len(payload)} bytes; kind {first} with {self.axes} axes takes {size}")
        values = self._values[is_wide]
        value: Vector = values.unpack_from(payload, 1)
        if not in_range(value):
            raise PeerError(f"payload holds {value}; it must be finite and within ±{LARGEST_COMPONENT:g}")
        rest = payload[1 + values.size :]
        if kind == HOLD:
            return Message(kind, is_wide, value, zeros, zeros, 0.0, 0.0)
        if kind == COUPLED:
            *moved, stiffness, viscosity = self._coupling.unpack(rest)
            travel: Vector = tuple(moved)
            if not in_range(travel):
                raise PeerError(
                    f"payload holds a travel of {travel} N; it must be finite, within ±{LARGEST_COMPONENT:g}"
                )
            self._check_stiffness(stiffness)
            if not 0.0 <= viscosity <= LARGEST_VISCOSITY:
                raise PeerError(f"payload holds a viscosity of {viscosity} N·s/m; it is 0 to {LARGEST_VISCOSITY:g}")
            return Message(kind, is_wide, value, travel, zeros, stiffness, viscosity)
        numbers: Vector = self._halves.unpack_from(rest)
        if kind == SURFACE:
            (across,) = HALF[1].unpack(rest[self._halves.size :]) if self.axes > 1 else (0.0,)
            self._check_stiffness(dot(numbers, numbers))
            self._check_stiffness(across)
            if numbers == zeros:
                raise PeerError("payload holds a surface whose normal is zero")
            return Message(kind, is_wide, value, zeros, numbers, across, 0.0)
        check_travel(value, numbers, self._law)
        return Message(kind, is_wide, value, numbers, zeros, 0.0, 0.0)

    def _check_stiffness(self, stiffness: float) -> None:
        if not 0.0 <= stiffness <= ROUNDING * self._stiffest:
            raise PeerError(f"payload holds a stiffness of {stiffness:g} N/m; it is 0 to {self._stiffest:g}")
