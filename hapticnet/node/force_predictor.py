"""The force expected a little ahead of now, toward which a slow device can already move.

Three forecasts compete, and the one that has predicted best is used:

- *hold*: the force stays as it is;
- *codec*: what the decoder predicts for the time ahead and the position to which the hand's speed leads;
- *stiffness*: the force changes with the position as it did at the last updates. The master knows its own position
  without delay, so this needs nothing from the codec.

Each forecast is compared with the force that was applied later.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from itertools import starmap
from typing import Final

from hapticnet.samples import Vector
from hapticnet.vectors import distance, dot, magnitude, minus, plus, times

Predict = Callable[[int, Vector], Vector]
"""``(lead_us, position_m) -> force_n``: the decoder's forecast for a lead from now and the position at that time."""

SPEED_US: Final = 10_000
"""Time [µs] over which the speed of the hand is measured. Its tremor has a period of 80 to 125 ms."""

REMEMBERED_US: Final = 1_000_000
"""Time [µs] for which positions are remembered: as long as a force may be late (`SessionSettings.max_age_us`)."""

NEAR_M: Final = 50e-6
"""Distance [m] between two updates below which a change of force says little about the stiffness: the tremor."""

STIFFEST_N_M: Final = 5000.0
JUMP_N: Final = 0.3
"""Largest stiffness [N/m] that is used, and change of force [N] beyond it that is not a stiffness but a breach."""

FREE_N: Final = 0.0125
"""Force [N] below which there is no contact, whose stiffness could be known: half the JND's floor."""

SCORED_US: Final = 5_000
SCORE_MEMORY_US: Final = 250_000
"""Time [µs] between two forecasts that are compared with the outcome, and over which their errors are averaged."""


class ForcePredictor:
    """Forecasts of one session's force. A new session begins with a new one."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        self.gradient_n_m: tuple[Vector, ...] = ((0.0,) * axes,) * axes  # [N/m], a row for each axis
        self.errors_n2 = [0.0, 0.0, 0.0]  # of hold, codec, stiffness so far
        self._times_us: list[int] = []
        self._positions_m: list[Vector] = []
        self._learned_m: Vector | None = None
        self._force_n: Vector = (0.0,) * axes
        self._forecasts: deque[tuple[int, tuple[Vector, ...]]] = deque()
        self._scored_us: int | None = None
        self._speed_of_us: int | None = None  # the tick at which the hand had the speed of the following
        self._moved_m: Vector | None = None  # how far it has moved; None: not known
        self._elapsed_us = 1  # and in which time

    def move(self, now_us: int, position_m: Vector) -> None:
        """Note the master's own position [m] at a tick."""
        if self._times_us and now_us <= self._times_us[-1]:
            return
        self._times_us.append(now_us)
        self._positions_m.append(position_m)
        if self._times_us[0] < now_us - 2 * REMEMBERED_US:
            old = bisect_right(self._times_us, now_us - REMEMBERED_US)
            del self._times_us[:old], self._positions_m[:old]

    def learn(self, t_us: int, force_n: Vector) -> None:
        """Note an update: the force [N] of the position at a time [µs]."""
        if not self._times_us:
            return
        position_m = self._position_at(t_us)
        before_m, before_n = self._learned_m, self._force_n
        self._learned_m, self._force_n = position_m, force_n
        if before_m is None:
            return
        moved_m, changed_n = minus(position_m, before_m), minus(force_n, before_n)
        moved2 = dot(moved_m, moved_m)
        if magnitude(changed_n) > STIFFEST_N_M * magnitude(moved_m) + JUMP_N or magnitude(force_n) <= FREE_N:
            self.gradient_n_m = ((0.0,) * self._axes,) * self._axes
            return
        # Normalised least mean squares (Widrow & Hoff): the gradient changes only in the direction of the motion.
        shares = times(moved_m, 1.0 / (moved2 + NEAR_M * NEAR_M))
        self.gradient_n_m = tuple(
            _limited(plus(row, times(shares, change_n - dot(row, moved_m))), STIFFEST_N_M)
            for row, change_n in zip(self.gradient_n_m, changed_n, strict=True)
        )

    def expected(self, now_us: int, at_us: int, lead_us: int, force_n: Vector, predict: Predict | None) -> Vector:
        """Return the force [N] expected `lead_us` after now, at which the force of a position at `at_us` is applied."""
        if not self._times_us:
            return force_n
        self._compare(now_us, force_n)
        hold_n2, codec_n2, stiffness_n2 = self.errors_n2
        best = 1 if codec_n2 < hold_n2 else 0
        if stiffness_n2 < (codec_n2 if best else hold_n2):
            best = 2
        if self._scored_us is not None and now_us - self._scored_us < SCORED_US:  # only the best is asked for
            if best == 0:
                return force_n
            if best == 2:
                return self._by_stiffness(at_us, lead_us, force_n)
            return self._by_codec(now_us, lead_us, force_n, predict)
        by_codec_n = self._by_codec(now_us, lead_us, force_n, predict)
        forecasts = force_n, by_codec_n, self._by_stiffness(at_us, lead_us, force_n)
        self._scored_us = now_us
        self._forecasts.append((now_us + lead_us, forecasts))
        return forecasts[best]

    def _by_codec(self, now_us: int, lead_us: int, force_n: Vector, predict: Predict | None) -> Vector:
        return force_n if predict is None else predict(lead_us, self._position_at(now_us + lead_us))

    def _by_stiffness(self, at_us: int, lead_us: int, force_n: Vector) -> Vector:
        if magnitude(force_n) <= FREE_N:
            return force_n
        # On a late link, part of the path ahead is known, because the hand has already covered it.
        there_m, here_m = self._position_at(at_us + lead_us), self._position_at(at_us)
        if len(force_n) == 1:  # as below, in a third of the time
            before_n = force_n[0]
            after_n = before_n + self.gradient_n_m[0][0] * (there_m[0] - here_m[0])
            return (_same_sign(after_n, before_n),)
        moved_m = minus(there_m, here_m)
        ahead_n = plus(force_n, tuple([dot(row, moved_m) for row in self.gradient_n_m]))
        # Contact pushes; the tool is not pulled back into the tissue it leaves.
        return tuple(starmap(_same_sign, zip(ahead_n, force_n, strict=True)))

    def _compare(self, now_us: int, force_n: Vector) -> None:
        """Compare earlier forecasts for now with the actual force [N]."""
        while self._forecasts and self._forecasts[0][0] <= now_us:
            _, past = self._forecasts.popleft()
            weight = SCORED_US / SCORE_MEMORY_US
            for index, forecast_n in enumerate(past):
                missed_n = distance(forecast_n, force_n)
                self.errors_n2[index] += weight * (missed_n * missed_n - self.errors_n2[index])

    def _position_at(self, t_us: int) -> Vector:
        """Return the position [m] at a time, continued with the present speed if it lies ahead."""
        times_us, positions_m = self._times_us, self._positions_m
        newest_us = times_us[-1]
        newest_m = positions_m[-1]
        if t_us <= newest_us:
            return newest_m if t_us == newest_us else positions_m[max(bisect_right(times_us, t_us) - 1, 0)]
        if self._speed_of_us != newest_us:
            self._speed_of_us = newest_us
            start = max(bisect_right(times_us, newest_us - SPEED_US) - 1, 0)
            self._elapsed_us = elapsed_us = newest_us - times_us[start]
            is_known = 0 < elapsed_us <= 2 * SPEED_US
            self._moved_m = minus(newest_m, positions_m[start]) if is_known else None
        moved_m = self._moved_m
        if moved_m is None:
            return newest_m
        share = (t_us - newest_us) / self._elapsed_us
        return (newest_m[0] + moved_m[0] * share,) if len(newest_m) == 1 else plus(newest_m, times(moved_m, share))


def _limited(row: Vector, largest: float) -> Vector:
    size = magnitude(row)
    return row if size <= largest else times(row, largest / size)


def _same_sign(ahead_n: float, force_n: float) -> float:
    return 0.0 if ahead_n * force_n < 0.0 else ahead_n
