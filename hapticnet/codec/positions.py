"""Positions sent only when they matter: dead reckoning with a tolerance that is a share of the JND.

The slave follows the promised line, within the box of its scene's stiffness bound. The master knows the
line, the bound and its true position, and sends the next position

- if the force of the scene may differ between the two by more than the positions' share of the JND,
- if the true position leaves the box, because there is a surface or a breach behind its sides,
- after `LONGEST_SILENCE_US`,
- at every tick while the scene gives no bound.

Dead reckoning with a threshold is the method of distributed simulation (IEEE 1278.1). docs/refer/payloads.md describes
the payloads of lines and bounds.
"""

import math
import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hapticnet.codec.values import HALF, SINGLE
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import as_half
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector, checked_vector
from hapticnet.stiffness_bound import LONGEST_SILENCE_US, StiffnessBound
from hapticnet.vectors import along, distance, dot, in_range, limited, magnitude, minus, over, single, times

FASTEST_M_PER_S: Final = 10.0
"""Largest velocity of a line on an axis: several times a hand's (as in `scene.settings`)."""

FASTEST_M_PER_S2: Final = 100.0  # largest acceleration of a line on an axis, likewise
FADING_S: Final = 0.06
"""Time [s] in which the acceleration of a line falls to zero, linearly: a hand seldom accelerates for longer."""


class PromisedLine(NamedTuple):
    """The tool's motion as promised by the master: from a position, at a velocity, with an acceleration that fades."""

    t_us: int
    # As both sides know them, rounded for the wire
    position_m: Vector
    velocity_m_per_s: Vector
    acceleration_m_per_s2: Vector

    def arriving_m_per_s(self, step_us: int) -> Vector:
        """Return the mean velocity over a step that ends where the line starts."""
        return along(self.velocity_m_per_s, -0.5e-6 * step_us, self.acceleration_m_per_s2)

    def at(self, t_us: int) -> Vector:
        """Return the position on the line at a time [m]: level before it starts and after `LONGEST_SILENCE_US`."""
        elapsed_us = min(t_us - self.t_us, LONGEST_SILENCE_US)
        if elapsed_us <= 0:
            return self.position_m
        elapsed_s = 1e-6 * elapsed_us
        place_m = along(self.position_m, elapsed_s, self.velocity_m_per_s)
        return limited(along(place_m, bent_s2(elapsed_s), self.acceleration_m_per_s2), LARGEST_COMPONENT)


def bent_s2(elapsed_s: float) -> float:
    """Return how far [m] a line has left its tangent after a time [s], per m/s² of acceleration."""
    fading_s = min(elapsed_s, FADING_S)
    return fading_s * fading_s * (0.5 - fading_s / (6.0 * FADING_S)) + 0.5 * FADING_S * (elapsed_s - fading_s)


def as_halves(x: Vector, limit: float) -> Vector:
    """Return a vector rounded for the wire, limited to ± limit on each axis."""
    return tuple([as_half(component) + 0.0 for component in limited(x, limit)])


def pack_line(line: PromisedLine) -> bytes:
    """Return the payload of a line."""
    _, position_m, velocity_m_per_s, acceleration_m_per_s2 = line
    axes = len(position_m)
    payload = SINGLE[axes].pack(*position_m)
    is_bent = any(acceleration_m_per_s2)
    if is_bent or any(velocity_m_per_s):
        payload += HALF[axes].pack(*velocity_m_per_s)
    return payload + HALF[axes].pack(*acceleration_m_per_s2) if is_bent else payload


def unpack_line(t_us: int, payload: bytes, axes: int) -> PromisedLine:
    """Return the line in the payload of a POSITION; PeerError if its length or a component is not allowed."""
    if len(payload) not in (4 * axes, 6 * axes, 8 * axes):
        raise PeerError(f"payload of {len(payload)} bytes; a line has 4, 6 or 8 for each of {axes} axes")
    position_m: Vector = SINGLE[axes].unpack(payload[: 4 * axes])
    if not in_range(position_m):
        raise PeerError(f"payload holds the position {position_m} m; it must be within ±{LARGEST_COMPONENT:g}")
    velocity_m_per_s = _halves(payload[4 * axes : 6 * axes], axes, FASTEST_M_PER_S, "m/s")
    return PromisedLine(
        t_us, position_m, velocity_m_per_s, _halves(payload[6 * axes :], axes, FASTEST_M_PER_S2, "m/s²")
    )


def _halves(payload: bytes, axes: int, limit: float, unit: str) -> Vector:
    """Return the numbers of a part of a line, zero if it is left out; PeerError if one is not within ± limit."""
    numbers: Vector = HALF[axes].unpack(payload) if payload else (0.0,) * axes
    for number in numbers:
        if not abs(number) <= limit:
            raise PeerError(f"payload holds {number} {unit}; it must be within ±{limit:g}")
    return numbers


LAYOUT: Final[Mapping[int, struct.Struct]] = {
    axes: struct.Struct(f">{3 + 2 * axes}f") for axes in range(1, MAX_AXES + 1)
}

FARTHEST_M: Final = 2.0 * LARGEST_COMPONENT  # largest distance of a side of a box from the origin [m]
STIFFEST: Final = 1e9  # largest stiffness [N/m], damping [N·s/m] and stiffening [1/m]. More is as useless as no bound.


def rounded_bound(bound: StiffnessBound | None) -> StiffnessBound | None:
    """Return a stiffness bound as the master decodes it; None if there is none, or its numbers are invalid."""
    if bound is None:
        return None
    stiffness, damping, low_m, high_m, stiffening = bound
    rounded = StiffnessBound(
        _rounded(stiffness, np.inf),
        _rounded(damping, np.inf),
        tuple(_rounded(component, np.inf) for component in low_m),
        tuple(_rounded(component, -np.inf) for component in high_m),
        _rounded(stiffening, np.inf),
    )
    return rounded if _is_good(rounded) else None


def pack_bound(bound: StiffnessBound | None) -> bytes:
    """Return the payload of a rounded stiffness bound."""
    if bound is None:
        return b""
    stiffness, damping, low_m, high_m, stiffening = bound
    return LAYOUT[len(low_m)].pack(stiffness, damping, stiffening, *low_m, *high_m)


def unpack_bound(payload: bytes, axes: int) -> StiffnessBound | None:
    """Return the bound in a payload, None if the scene has none; PeerError if it is not allowed."""
    if not payload:
        return None
    layout = LAYOUT[axes]
    if len(payload) != layout.size:
        raise PeerError(f"bound of {len(payload)} bytes; one of {axes} axes has {layout.size}")
    stiffness, damping, stiffening, *sides = layout.unpack(payload)
    bound = StiffnessBound(stiffness, damping, tuple(sides[:axes]), tuple(sides[axes:]), stiffening)
    if not _is_good(bound):
        raise PeerError(f"bound {tuple(bound)} is not what the protocol allows")
    return bound


def _is_good(bound: StiffnessBound) -> bool:
    stiffness, damping, low_m, high_m, stiffening = bound
    return (
        0.0 <= stiffness <= STIFFEST
        and 0.0 <= damping <= STIFFEST
        and 0.0 <= stiffening <= STIFFEST
        and all(-FARTHEST_M <= low <= high <= FARTHEST_M for low, high in zip(low_m, high_m, strict=True))
    )


def _rounded(x: float, toward: float) -> float:
    """Return the float32 nearest to a number, rounded toward `toward`."""
    with np.errstate(over="ignore"):
        single = np.float32(x)
    if float(single) < x if toward > 0.0 else float(single) > x:  # numpy would compare them as float32
        single = np.nextafter(single, np.float32(toward))
    return float(single)


WINDOW_US: Final = 12_000  # window of the samples that determine velocity and acceleration of a line [µs]
MOST_SAMPLES: Final = 32  # most samples in that window
SIGNIFICANT: Final = 25.0
"""How many times its variance the square of an acceleration must be to be promised: noise looks like one, too."""

UNKNOWN_STIFFNESS: Final = 1000.0
"""Stiffness [N/m] that is assumed between leaving a box and receiving the next one, before any is known."""

Difference: TypeAlias = Callable[[Vector], Vector | None]
"""``(place_m) -> force_n``: the force that the master applies at its position minus the force at the places
on its line, for the present place; None if that does not depend on the position."""


def parabola(samples: deque[tuple[int, Vector]]) -> tuple[Vector, Vector]:
    """Return velocity and acceleration at the newest sample: least squares over those before it, through it."""
    t_us, x = samples[-1]
    squares = cubes = fourths = moved_m2 = 0.0
    count = 0
    first = second = times(x, 0.0)
    for before_us, before in samples:
        if 0 < t_us - before_us <= WINDOW_US:
            elapsed_s = 1e-6 * (before_us - t_us)
            half_s2 = 0.5 * elapsed_s * elapsed_s
            moved_m = minus(before, x)
            squares += elapsed_s * elapsed_s
            cubes += elapsed_s * half_s2
            fourths += half_s2 * half_s2
            moved_m2 += dot(moved_m, moved_m)
            count += 1
            first, second = along(first, elapsed_s, moved_m), along(second, half_s2, moved_m)
    divisor = squares * fourths - cubes * cubes
    if divisor > 1e-6 * squares * fourths:
        acceleration = over(minus(times(second, squares), times(first, cubes)), divisor)
        velocity = over(minus(times(first, fourths), times(second, cubes)), divisor)
        left_m2 = moved_m2 - dot(velocity, first) - dot(acceleration, second)
        if dot(acceleration, acceleration) * divisor * (count - 2) > SIGNIFICANT * left_m2 * squares:
            return velocity, acceleration
    return over(first, squares or 1.0), times(x, 0.0)


@dataclass(slots=True)
class Reasons:
    """How many positions were sent for which reason."""

    first: int = 0
    unknown: int = 0
    left: int = 0
    tolerance: int = 0
    silence: int = 0
    wanted: int = 0


@dataclass(slots=True)
class PositionSender:
    """Decide at each tick whether to send the position, and what to promise with it.

    `share` (0 to 1) of the JND of `law` is for positions, the rest for the feedback codec.
    """

    law: WeberLaw
    share: float
    reasons: Reasons = field(default_factory=Reasons)
    line: PromisedLine | None = None
    bound: StiffnessBound | None = None
    _outside: bool = False
    _stiffest: float = 0.0
    _samples: deque[tuple[int, Vector]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))

    def set_bound(self, bound: StiffnessBound | None) -> None:
        """Receive the newest bound; None: the scene has none."""
        self.bound = bound
        self._outside = False
        if bound is not None:
            self._stiffest = max(self._stiffest, bound.stiffness_n_per_m)

    def forget(self) -> None:
        """Forget the line, because it was not sent or the slave does not follow it."""
        self.line = None

    def payload(
        self,
        t_us: int,
        position_m: Vector,
        applied_n: float,
        *,
        wanted: bool = False,
        difference: Difference | None = None,
    ) -> bytes | None:
        """Return the payload of a position [m] at a time [µs] to send now; None if the slave's line is good enough.

        The JND belongs to the applied force [N]. If `wanted`, send in any case, for instance to acknowledge a force.
        For decoders that know the position, the slave judges what they apply at the places on the line: `difference`.
        Raise SampleError if the position is not finite or out of range.
        """
        x = single(checked_vector(position_m, "position"))
        samples = self._samples
        if samples and t_us - samples[-1][0] <= 0:  # the clock went back
            samples.clear()
        velocity = self._newest_velocity(t_us, x)
        samples.append((t_us, x))
        if not self._is_due(t_us, x, velocity, applied_n, difference):
            if not wanted:
                return None
            self.reasons.wanted += 1
        self.line = self._promise(t_us, x, velocity)
        return pack_line(self.line)

    def place_m(self, t_us: int) -> Vector | None:
        """Return the tool's position [m] as the slave assumes it; None if there is no line."""
        if self.line is None or self.bound is None:
            return None if self.line is None else self.line.position_m
        return self.bound.nearest(self.line.at(t_us))

    def _is_due(self, t_us: int, x: Vector, velocity: Vector, applied_n: float, difference: Difference | None) -> bool:
        line, bound, reasons = self.line, self.bound, self.reasons
        if line is None or len(line.position_m) != len(x) or t_us < line.t_us:
            reasons.first += 1
            return True
        if bound is None:
            reasons.unknown += 1
            return True
        if t_us - line.t_us >= LONGEST_SILENCE_US:
            reasons.silence += 1
            return True
        followed = line.at(t_us)
        outside = not bound.contains(x)
        if not outside:
            followed = bound.nearest(followed)
        elif not self._outside:
            self._outside = True
            reasons.left += 1
            return True
        differing_n = difference(followed) if difference is not None else None
        stiffness, damping, stiffening = bound.stiffness_n_per_m, bound.damping_n_s_per_m, bound.stiffening_per_m
        if not (outside or stiffness or damping or stiffening) and differing_n is None:
            return False
        step_us = self._step_us()
        moved_m = distance(line.at(t_us), line.at(t_us - step_us))
        damper_n = times(x, 0.0)
        changed_n = 0.0
        if damping:
            followed_velocity = self._followed_velocity(t_us, step_us, outside=outside)
            damper_n = times(minus(velocity, followed_velocity), damping)
            before = self._followed_velocity(t_us - step_us, step_us, outside=outside)
            changed_n = damping * distance(followed_velocity, before)
        if stiffening:
            # The springs' part of the force may be larger than the force by that of the dampers.
            most_n = applied_n + changed_n + 2.0 * self.law.threshold_n(applied_n) + damping * magnitude(velocity)
            stiffness += stiffening * most_n
        self._stiffest = max(self._stiffest, stiffness)
        if outside:
            stiffness = self._stiffest or UNKNOWN_STIFFNESS
        elif stiffening:  # dF/dx = k + a·F: over a distance d it grows by exp(a·d)
            stiffness *= math.exp(min(stiffening * (distance(x, followed) + moved_m), 50.0))
        spring_n = times(minus(x, followed), stiffness)
        away_n = magnitude(spring_n) + magnitude(damper_n)
        if differing_n is not None:
            away_n = self._away_n(away_n, spring_n, damper_n, differing_n)
        if away_n <= self._tolerance_n(applied_n, changed_n + stiffness * moved_m):
            return False
        reasons.tolerance += 1
        return True

    def _away_n(self, away_n: float, spring_n: Vector, damper_n: Vector, differing_n: Vector) -> float:
        """Return the largest error of the force [N] at the position, where the applied force differs too.

        On one axis a contact pushes harder where the tool is deeper or faster, so that the two differ in the same
        direction. On several axes, nothing is known about that.
        """
        size_n = magnitude(differing_n)
        if len(differing_n) == 1:
            ends_n = (0.0, spring_n[0], damper_n[0], spring_n[0] + damper_n[0])
            away_n = max(away_n, max(ends_n) - differing_n[0], differing_n[0] - min(ends_n))
        else:
            away_n += size_n
        # The JND belongs to the force at the position, the codec's threshold to the force on the line.
        return away_n + self.law.multiplier * self.law.weber_fraction * size_n

    def _followed_velocity(self, t_us: int, step_us: int, *, outside: bool) -> Vector:
        """Return the velocity with which the slave steps its scene [m/s]: the line ends at the sides of the box.

        `outside`: the tool has left the box, so the slave is about to step along the line in another.
        """
        line, bound = self.line, self.bound
        assert line is not None and bound is not None  # noqa: S101, PT018 - for the type checker
        if step_us <= 0 or t_us - step_us < line.t_us:
            return line.arriving_m_per_s(step_us)
        now_m, before_m = line.at(t_us), line.at(t_us - step_us)
        if not outside:
            now_m, before_m = bound.nearest(now_m), bound.nearest(before_m)
        return times(minus(now_m, before_m), 1e6 / step_us)

    def _tolerance_n(self, applied_n: float, changed_n: float) -> float:
        """Return how far the force on the line may differ from the true one [N].

        The JND belongs to the force applied after the slave's answer to this tick. It is not known yet, but it
        is within the codec's threshold of the force on the line, and so was the one before. `changed_n` is by how much
        the force on the line may have changed since [N].
        """
        law, share = self.law, self.share
        least_n = applied_n - changed_n - 2.0 * (1.0 - share) * law.threshold_n(applied_n)
        return share * law.threshold_n(max(least_n, 0.0))

    def _newest_velocity(self, t_us: int, x: Vector) -> Vector:
        """Return the velocity since the last sample [m/s]; zero if there is none."""
        if not self._samples:
            return times(x, 0.0)
        before_us, before = self._samples[-1]
        velocity = times(over(minus(x, before), float(t_us - before_us)), 1e6)
        if magnitude(velocity) > FASTEST_M_PER_S:  # the hand jumped: earlier samples say nothing
            self._samples.clear()
            return times(x, 0.0)
        return velocity

    def _promise(self, t_us: int, x: Vector, velocity: Vector) -> PromisedLine:
        """Return the line from a sample on, which was reached with a velocity [m/s]."""
        bound, step_us = self.bound, self._step_us()
        speed, change = parabola(self._samples)
        acceleration = as_halves(change, FASTEST_M_PER_S2)
        line = PromisedLine(t_us, x, as_halves(speed, FASTEST_M_PER_S), acceleration)
        if bound is not None and bound.contains(x):
            wrong_n = bound.damping_n_s_per_m * distance(velocity, line.arriving_m_per_s(step_us))
            if wrong_n <= self.share * self.law.threshold_n(0.0):
                return line
        # Outside the box the slave may find something viscous, too.
        speed = along(velocity, 0.5e-6 * step_us, acceleration)
        return PromisedLine(t_us, x, as_halves(speed, FASTEST_M_PER_S), acceleration)

    def _step_us(self) -> int:
        """Return the time between the two newest samples [µs]; 0 if there is one."""
        return self._samples[-1][0] - self._samples[-2][0] if len(self._samples) > 1 else 0
