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
from hapticnet.vectors import along, distance, in_range, limited, magnitude, minus, over, single, times

FASTEST_M_PER_S: Final = 10.0
"""Largest velocity of a line on an axis: several times a hand's (as in `scene.settings`)."""


class PromisedLine(NamedTuple):
    """The tool's motion as promised by the master: from a position, at a velocity."""

    t_us: int
    # As both sides know them, rounded for the wire
    position_m: Vector
    velocity_m_per_s: Vector

    def at(self, t_us: int) -> Vector:
        """Return the position on the line at a time [m]: level before it starts and after `LONGEST_SILENCE_US`."""
        elapsed_us = min(t_us - self.t_us, LONGEST_SILENCE_US)
        if elapsed_us <= 0:
            return self.position_m
        return limited(along(self.position_m, 1e-6 * elapsed_us, self.velocity_m_per_s), LARGEST_COMPONENT)


def as_velocity(velocity_m_per_s: Vector) -> Vector:
    """Return a velocity rounded for the wire, limited to ± `FASTEST_M_PER_S` on each axis."""
    return tuple(as_half(component) + 0.0 for component in limited(velocity_m_per_s, FASTEST_M_PER_S))


def pack_line(line: PromisedLine) -> bytes:
    """Return the payload of a line."""
    position_m, velocity_m_per_s = line.position_m, line.velocity_m_per_s
    payload = SINGLE[len(position_m)].pack(*position_m)
    if any(velocity_m_per_s):
        payload += HALF[len(velocity_m_per_s)].pack(*velocity_m_per_s)
    return payload


def unpack_line(t_us: int, payload: bytes, axes: int) -> PromisedLine:
    """Return the line in the payload of a POSITION; PeerError if its length or a component is not allowed."""
    size = 4 * axes
    if len(payload) not in (size, 6 * axes):
        raise PeerError(f"payload of {len(payload)} bytes; a line of {axes} axes has {size} or {6 * axes}")
    position_m: Vector = SINGLE[axes].unpack(payload[:size])
    velocity_m_per_s: Vector = HALF[axes].unpack(payload[size:]) if len(payload) > size else (0.0,) * axes
    if not in_range(position_m):
        raise PeerError(f"payload holds the position {position_m} m; it must be within ±{LARGEST_COMPONENT:g}")
    if not all(math.isfinite(speed) and abs(speed) <= FASTEST_M_PER_S for speed in velocity_m_per_s):
        raise PeerError(f"payload holds a velocity of {velocity_m_per_s} m/s; it must be within ±{FASTEST_M_PER_S:g}")
    return PromisedLine(t_us, position_m, velocity_m_per_s)


LAYOUT: Final[Mapping[int, struct.Struct]] = {
    axes: struct.Struct(f">{2 + 2 * axes}f") for axes in range(1, MAX_AXES + 1)
}

FARTHEST_M: Final = 2.0 * LARGEST_COMPONENT  # largest distance of a side of a box from the origin [m]
STIFFEST: Final = 1e9  # largest stiffness [N/m] and damping [N·s/m]. Anything above is as useless as no bound.


def rounded_bound(bound: StiffnessBound | None) -> StiffnessBound | None:
    """Return a stiffness bound as the master decodes it; None if there is none, or its numbers are invalid."""
    if bound is None:
        return None
    stiffness, damping, low_m, high_m = bound
    rounded = StiffnessBound(
        _rounded(stiffness, np.inf),
        _rounded(damping, np.inf),
        tuple(_rounded(component, np.inf) for component in low_m),
        tuple(_rounded(component, -np.inf) for component in high_m),
    )
    return rounded if _is_good(rounded) else None


def pack_bound(bound: StiffnessBound | None) -> bytes:
    """Return the payload of a rounded stiffness bound."""
    if bound is None:
        return b""
    stiffness, damping, low_m, high_m = bound
    return LAYOUT[len(low_m)].pack(stiffness, damping, *low_m, *high_m)


def unpack_bound(payload: bytes, axes: int) -> StiffnessBound | None:
    """Return the bound in a payload, None if the scene has none; PeerError if it is not allowed."""
    if not payload:
        return None
    layout = LAYOUT[axes]
    if len(payload) != layout.size:
        raise PeerError(f"bound of {len(payload)} bytes; one of {axes} axes has {layout.size}")
    stiffness, damping, *sides = layout.unpack(payload)
    bound = StiffnessBound(stiffness, damping, tuple(sides[:axes]), tuple(sides[axes:]))
    if not _is_good(bound):
        raise PeerError(f"bound {tuple(bound)} is not what the protocol allows")
    return bound


def _is_good(bound: StiffnessBound) -> bool:
    stiffness, damping, low_m, high_m = bound
    return (
        0.0 <= stiffness <= STIFFEST
        and 0.0 <= damping <= STIFFEST
        and all(-FARTHEST_M <= low <= high <= FARTHEST_M for low, high in zip(low_m, high_m, strict=True))
    )


def _rounded(x: float, toward: float) -> float:
    """Return the float32 nearest to a number, rounded toward `toward`."""
    with np.errstate(over="ignore"):
        single = np.float32(x)
    if float(single) < x if toward > 0.0 else float(single) > x:  # numpy would compare them as float32
        single = np.nextafter(single, np.float32(toward))
    return float(single)


WINDOW_US: Final = 12_000  # window of the samples that determine the velocity of a line [µs]
MOST_SAMPLES: Final = 32  # most samples in that window

UNKNOWN_STIFFNESS: Final = 1000.0
"""Least stiffness [N/m] that is assumed between leaving a box and receiving the next one."""

Difference: TypeAlias = Callable[[Vector], Vector | None]
"""``(place_m) -> force_n``: the force that the master applies at its position minus the force at the places
on its line, for the present place; None if that does not depend on the position."""


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
    """Decide at each tick whether to send the position, and with which velocity.

    `share` (0 to 1) of the JND of `law` is for positions, the rest for the feedback codec.
    """

    law: WeberLaw
    share: float
    reasons: Reasons = field(default_factory=Reasons)
    line: PromisedLine | None = None
    bound: StiffnessBound | None = None
    _outside: bool = False
    _stiffest: float = UNKNOWN_STIFFNESS
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
        self.line = PromisedLine(t_us, x, self._promised_velocity(velocity))
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
        if bound.contains(x):
            followed = bound.nearest(line.at(t_us))
            stiffness, damping = bound.stiffness_n_per_m, bound.damping_n_s_per_m
        else:
            if not self._outside:
                self._outside = True
                reasons.left += 1
                return True
            followed, stiffness, damping = line.at(t_us), self._stiffest, bound.damping_n_s_per_m
        differing_n = difference(followed) if difference is not None else None
        if not stiffness and not damping and differing_n is None:
            return False
        spring_n = times(minus(x, followed), stiffness)
        damper_n = times(spring_n, 0.0)
        changed_n = 0.0
        if damping:
            step_us = t_us - self._samples[-2][0] if len(self._samples) > 1 else 0
            followed_velocity = self._followed_velocity(t_us, step_us)
            damper_n = times(minus(velocity, followed_velocity), damping)
            changed_n = damping * distance(followed_velocity, self._followed_velocity(t_us - step_us, step_us))
        away_n = magnitude(spring_n) + magnitude(damper_n)
        if differing_n is not None:
            away_n = self._away_n(away_n, spring_n, damper_n, differing_n)
        if away_n <= self._tolerance_n(applied_n, stiffness, changed_n, t_us):
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

    def _followed_velocity(self, t_us: int, step_us: int) -> Vector:
        """Return the velocity with which the slave steps its scene [m/s]: the line ends at the sides of the box."""
        line, bound = self.line, self.bound
        assert line is not None and bound is not None  # noqa: S101, PT018 - for the type checker
        if step_us <= 0 or t_us - step_us < line.t_us:
            return line.velocity_m_per_s
        moved_m = minus(bound.nearest(line.at(t_us)), bound.nearest(line.at(t_us - step_us)))
        return times(moved_m, 1e6 / step_us)

    def _tolerance_n(self, applied_n: float, stiffness: float, changed_n: float, t_us: int) -> float:
        """Return how far the force on the line may differ from the true one [N].

        The JND belongs to the force applied after the slave's answer to this tick. It is not known yet, but it
        is within the codec's threshold of the force on the line, and so was the one before. `changed_n` is by how much
        the force on the line may have changed since because its velocity did [N].
        """
        law, share = self.law, self.share
        least_n = applied_n - changed_n - 2.0 * (1.0 - share) * law.threshold_n(applied_n)
        if len(self._samples) > 1 and self.line is not None:
            step_us = t_us - self._samples[-2][0]
            least_n -= 1e-6 * step_us * stiffness * magnitude(self.line.velocity_m_per_s)
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

    def _promised_velocity(self, velocity: Vector) -> Vector:
        """Return the velocity of a line: least squares over the newest samples, through the newest one."""
        t_us, x = self._samples[-1]
        bound = self.bound
        if bound is None or not bound.contains(x):  # the slave may find a viscous layer there
            return as_velocity(velocity)
        total_us2, total = 0.0, times(x, 0.0)
        for before_us, before in self._samples:
            elapsed_us = t_us - before_us
            if 0 < elapsed_us <= WINDOW_US:
                total_us2 += float(elapsed_us) * elapsed_us
                total = tuple(
                    sum_ + elapsed_us * (now - then) for sum_, now, then in zip(total, x, before, strict=True)
                )
        promised = as_velocity(times(over(total, total_us2), 1e6) if total_us2 else total)
        damping = bound.damping_n_s_per_m
        if damping and damping * distance(velocity, promised) > self.share * self.law.threshold_n(0.0):
            return as_velocity(velocity)
        return promised
