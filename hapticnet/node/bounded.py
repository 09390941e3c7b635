"""A bound on what a decoder that follows the receiver's own position may apply: never far beyond the recent past.

Over a network with a delay, such a decoder draws a force for positions that the slave has not answered yet, with a
stiffness and viscosity that were learned a round trip ago. At a first touch or in rigid contact these can be wrong by
far: 25 N were applied on a spring that never pressed with more than 7.5 N. The force of the same updates at positions
that are a round trip old is known to be right: the slave would have contradicted it. What is applied stays near the
largest of these forces.
"""

from bisect import bisect_right
from collections import deque
from typing import Final, cast

from hapticnet.codec.base import Codec, Decoder, Predictive
from hapticnet.samples import Vector
from hapticnet.vectors import magnitude, times

GROWTH: Final = 1.3
MARGIN_N: Final = 0.5
"""The bound is this factor times the largest force that was answered lately, plus this force [N]: what a hand can add
within a round trip. bench/measure/felt.py compares values."""

LATELY_US: Final = 1_000_000
"""How far back [µs] answered forces count, and positions are remembered."""


WAY: Final = 50
"""Positions from which a velocity follows: ten time constants at 1 kHz."""


class Answered:
    """Positions and answered forces of the last second.

    Attributes
    ----------
    bound_n
        Largest magnitude [N] that may be applied now.
    """

    __slots__ = ("_forces", "_positions_m", "_times_us", "bound_n")

    def __init__(self) -> None:
        self.bound_n = MARGIN_N
        self._times_us: list[int] = []
        self._positions_m: list[Vector] = []
        self._forces: deque[tuple[int, float]] = deque()  # each is larger than those after it

    def move(self, t_us: int, position_m: Vector) -> None:
        """Note where the tool is."""
        if self._times_us and t_us <= self._times_us[-1]:
            return
        self._times_us.append(t_us)
        self._positions_m.append(position_m)
        if self._times_us[0] < t_us - 2 * LATELY_US:
            old = bisect_right(self._times_us, t_us - LATELY_US)
            del self._times_us[:old], self._positions_m[:old]

    def position_m(self, t_us: int) -> Vector:
        """Return where the tool was [m]."""
        return self._positions_m[max(bisect_right(self._times_us, t_us) - 1, 0)]

    def way(self, t_us: int) -> list[tuple[int, Vector]]:
        """Return the last positions until a time, which tell the velocity there."""
        end = bisect_right(self._times_us, t_us)
        start = max(end - WAY, 0)
        return list(zip(self._times_us[start:end], self._positions_m[start:end], strict=True))

    def note(self, force_n: Vector, now_us: int) -> None:
        """Note the force [N] at an answered position."""
        size_n, forces = magnitude(force_n), self._forces
        while forces and forces[-1][1] <= size_n:
            forces.pop()
        forces.append((now_us, size_n))
        while forces[0][0] < now_us - LATELY_US:
            forces.popleft()
        self.bound_n = GROWTH * forces[0][1] + MARGIN_N


class BoundedDecoder:
    """A decoder within the bound. Satisfies `Decoder`.

    A second decoder, which is told the same updates, is where the newest answered position was: at the time that the
    first is asked for (`Decoder.reconstruct`).

    Attributes
    ----------
    inner
        The decoder whose forces are bounded.
    """

    __slots__ = ("_answered", "_answered_us", "_behind", "inner")

    def __init__(self, codec: Codec, axes: int) -> None:
        self.inner, self._behind = codec.decoder(axes), codec.decoder(axes)
        self._answered = Answered()
        self._answered_us: int | None = None

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload. See `Decoder.decode`."""
        self.inner.decode(t_us, payload)
        if self._answered_us is None:
            for at_us, position in self._answered.way(t_us):
                self._behind.reconstruct(at_us, position, at_us)
            self._answered_us = t_us
        self._behind.decode(t_us, payload)

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply. See `Decoder.reconstruct`."""
        force_n = self.inner.reconstruct(t_us, position, position_us)
        if position is None:
            return force_n
        now_us = t_us if position_us is None else position_us
        answered = self._answered
        answered.move(now_us, position)
        if self._answered_us is not None and t_us >= self._answered_us:  # jitter may take the time back
            self._answered_us = t_us
            answered.note(self._behind.reconstruct(t_us, answered.position_m(t_us), t_us), now_us)
        return self._limited(force_n)

    def _limited(self, force_n: Vector) -> Vector:
        size_n, bound_n = magnitude(force_n), self._answered.bound_n
        return force_n if size_n <= bound_n else times(force_n, bound_n / size_n)


class BoundedPredictingDecoder(BoundedDecoder):
    """A bounded decoder that can be asked for the future. Satisfies `Predictive`."""

    __slots__ = ()

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus of a time to come. See `Predictive`."""
        return self._limited(cast("Predictive", self.inner).predict(t_us, position, position_us))


def receiver(codec: Codec, axes: int) -> Decoder:
    """Return a decoder for what is applied: a bounded one if the codec follows the receiver's own position."""
    if not codec.needs_position:
        return codec.decoder(axes)
    predicts = isinstance(codec.decoder(axes), Predictive)
    return BoundedPredictingDecoder(codec, axes) if predicts else BoundedDecoder(codec, axes)
