"""Predict the position of the hand when the force arrives, and the force of a copy of the scene there.

A force reaches the master one round trip after the position that it answers; by then the hand has moved on. A slave
that answers for a later position avoids that. The true scene is only stepped at positions that were received, so
a wrong prediction breaks or heals nothing.

The displacement over the time ahead is predicted by least squares with forgetting from five regressors: velocity and
acceleration now, the displacement over the last such period, and velocity and acceleration before that. All axes share
the coefficients. The estimator: L. Ljung, "System Identification", 2nd edition, 1999, section 11.2.
"""

import math
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from hapticnet.codec.positions import PromisedLine, bent_s2
from hapticnet.errors import SampleError, in_words
from hapticnet.parts import KINDS, PartsLaw
from hapticnet.perception import WeberLaw
from hapticnet.samples import PositionSample, Vector
from hapticnet.scene.base import Touchable, copy_method, lead_limit_n
from hapticnet.vectors import along, magnitude, minus, times

if TYPE_CHECKING:
    from collections.abc import Callable

LONGEST_AHEAD_US: Final = 150_000
"""Longest time [µs] for which the hand is predicted: an arm changes its mind about as fast as it reacts."""

SHORTEST_STEP_US: Final = 1_000  # shortest period at which the movement is sampled [µs]
VELOCITY_LAG_S: Final = 0.003
ACCELERATION_LAG_S: Final = 0.01
"""Time constants [s] of the low-passes of velocity and acceleration."""

MEMORY_S: Final = 2.0  # time constant [s] for forgetting earlier movements
RIDGE: Final = 0.002
"""Weight of the coefficients before anything is learned, as a sum of squared speeds in units of `SPEED_M_PER_S`."""

SPEED_M_PER_S: Final = 0.05
PERSISTENCE_S: Final = 0.1  # before anything is learned, a velocity decays with this time constant [s]
SOLVED_EVERY: Final = 8  # steps between two solutions of the equations
FASTEST: Final = 2.0
LARGEST_SPEED_M_PER_S: Final = 1.0
"""Largest predicted speed: a multiple of the present one or the last period's, whichever is larger, and never
faster than a hand on a tool moves. From faster movements nothing is learned."""

LEAP_M_PER_S: Final = 3.0  # between two steps nothing but a leap is faster: the movement is looked at afresh

LONGEST_GAP: Final = 200  # steps without a position after which the movement is sampled afresh
STEPS_PER_POSITION: Final = 10
"""Steps that a position allows, for those missed before it. A master whose clock runs away costs the slave no more."""

TERMS: Final = 5
_UPPER: Final = np.triu_indices(TERMS)
KEPT: Final = 4 * LONGEST_AHEAD_US // SHORTEST_STEP_US


class HandPredictor:
    """Predict one hand from its positions. `period_us`: time [µs] between two of them."""

    def __init__(self, axes: int, period_us: int) -> None:
        self._axes = range(axes)
        self._step_us = max(period_us, SHORTEST_STEP_US)
        step_s = 1e-6 * self._step_us
        self._step_s = step_s
        self._toward_velocity = step_s / (VELOCITY_LAG_S + step_s)
        self._toward_acceleration = step_s / (ACCELERATION_LAG_S + step_s)
        self._keep = MEMORY_S / (MEMORY_S + step_s)
        # Positions [m], velocities [m/s] and accelerations [m/s²] at each step, axis by axis
        self._positions: list[list[float]] = [[0.0] * KEPT for _ in self._axes]
        self._velocities: list[list[float]] = [[0.0] * KEPT for _ in self._axes]
        self._accelerations: list[list[float]] = [[0.0] * KEPT for _ in self._axes]
        self._steps = 0  # steps in the tables since the last gap
        self._allowed = LONGEST_GAP  # steps that may be made up for now
        self._t_us = 0  # time of the newest step
        self._newest_m: Vector = (0.0,) * axes  # newest position, which may be a later one
        self._line: PromisedLine | None = None  # the newest line, where positions are few
        self._on_line = 0  # steps since then, which are only promised
        # Normal equations: the upper triangle row by row, and the right-hand side
        self._normal = [0.0] * (TERMS * (TERMS + 1) // 2)
        self._right = [0.0] * TERMS
        self._coefficients = [0.0] * TERMS
        self._ahead_us = 0

    def receive(self, t_us: int, position_m: Vector) -> None:
        """Add the position of a time [µs]."""
        self._newest_m = position_m
        self._allowed = min(self._allowed + STEPS_PER_POSITION, LONGEST_GAP)
        steps = (t_us - self._t_us + self._step_us // 2) // self._step_us
        if not self._steps or not 0 <= steps <= self._allowed:
            self._begin(t_us, position_m)
            return
        if not steps:
            return
        self._allowed -= steps
        self._t_us += steps * self._step_us  # not the time of the position: at 2 kHz, every second one is a step
        newest = (self._steps - 1) % KEPT
        before = [self._positions[axis][newest] for axis in self._axes]
        if self._line is not None:
            self._on_line += steps
        for step in range(1, steps + 1):  # positions that are missing are on a line
            share = step / steps
            self._push(tuple([x + share * (y - x) for x, y in zip(before, position_m, strict=True)]))

    def follow(self, line: PromisedLine) -> None:
        """Add a promised line. The assumed path to its start is replaced by a better guess.

        That goes over smoothly from the earlier line to the later one, as far as it goes back.
        """
        before = self._line
        steps = 0 if before is None else (line.t_us - before.t_us + self._step_us // 2) // self._step_us
        if before is None or not self._on_line <= self._steps - 1 or not 0 < steps <= self._allowed:
            self._begin(line.t_us, line.position_m)
            self._line = line
            return
        self._allowed -= steps
        self._steps -= self._on_line
        self._on_line, self._t_us, self._line = 0, line.t_us, line
        for step in range(1, steps + 1):
            share = step / steps
            back_s = 1e-6 * (1.0 - share) * (line.t_us - before.t_us)
            back_m = along(
                along(line.position_m, -back_s, line.velocity_m_per_s), bent_s2(back_s), line.acceleration_m_per_s2
            )
            there_m = before.at(line.t_us - round(1e6 * back_s))
            self._push(along(there_m, share * share * (3.0 - 2.0 * share), minus(back_m, there_m)))

    def predict(self, ahead_us: int) -> Vector:
        """Return the predicted position [m] this long after the newest one."""
        if ahead_us != self._ahead_us:
            self._ahead_us = ahead_us
            self._solve()
        lag, ahead_s = self._lag(), 1e-6 * ahead_us
        now = (self._steps - 1) % KEPT
        a, b, c, d, e = self._coefficients
        if self._steps <= 2 * lag:
            a, b, c, d, e = self._prior(ahead_s), 0.0, 0.0, 0.0, 0.0
        before = (now - lag) % KEPT
        predicted, last, present = [], [], []
        for axis in self._axes:
            velocities, accelerations = self._velocities[axis], self._accelerations[axis]
            positions = self._positions[axis]
            velocity, moved = velocities[now], (positions[now] - positions[before]) / (lag * self._step_s)
            speed = a * velocity + b * ahead_s * accelerations[now] + c * moved
            predicted.append(speed + d * velocities[before] + e * ahead_s * accelerations[before])
            last.append(moved)
            present.append(velocity)
        largest = min(FASTEST * max(magnitude(tuple(last)), magnitude(tuple(present))), LARGEST_SPEED_M_PER_S)
        size = magnitude(tuple(predicted))
        scale = ahead_s if size <= largest else ahead_s * largest / size
        return tuple([self._newest_m[axis] + scale * predicted[axis] for axis in self._axes])

    def _lag(self) -> int:
        return min(max((self._ahead_us + self._step_us // 2) // self._step_us, 1), KEPT // 4)

    def _prior(self, ahead_s: float) -> float:
        """Return the mean speed over a time [s], as a share of the present one, before anything is learned."""
        return PERSISTENCE_S * (1.0 - math.exp(-ahead_s / PERSISTENCE_S)) / ahead_s

    def _begin(self, t_us: int, position_m: Vector) -> None:
        """Restart the sampling of the movement at a position."""
        self._steps = self._on_line = 0
        self._t_us, self._line = t_us, None
        self._push(position_m)

    def _push(self, position_m: Vector) -> None:
        """Write the position of the next step, and learn from it."""
        before, leap_m = (self._steps - 1) % KEPT, LEAP_M_PER_S * self._step_s
        if not all(abs(x - known[before]) <= leap_m for x, known in zip(position_m, self._positions, strict=True)):
            self._steps = 0  # so that what is learned stays within what the equations can hold
        first = not self._steps
        now = self._steps % KEPT
        for axis in self._axes:
            x = position_m[axis]
            velocity = acceleration = 0.0
            if not first:
                moving, changing = self._velocities[axis][before], self._accelerations[axis][before]
                step = self._toward_velocity * ((x - self._positions[axis][before]) / self._step_s - moving)
                velocity = moving + step
                acceleration = changing + self._toward_acceleration * (step / self._step_s - changing)
            self._positions[axis][now] = x
            self._velocities[axis][now], self._accelerations[axis][now] = velocity, acceleration
        self._steps += 1
        if self._ahead_us and not self._on_line and self._steps > 2 * self._lag() + 1:
            self._learn(now)

    def _learn(self, now: int) -> None:
        """Learn from the displacement over the last lead, given the data before it."""
        lag = self._lag()
        then, earlier, ahead_s = (now - lag) % KEPT, (now - 2 * lag) % KEPT, lag * self._step_s
        normal, right, keep = self._normal, self._right, self._keep
        for axis in self._axes:
            positions, velocities, accelerations = (
                self._positions[axis],
                self._velocities[axis],
                self._accelerations[axis],
            )
            unit = 1.0 / SPEED_M_PER_S
            terms = [
                unit * velocities[then],
                unit * ahead_s * accelerations[then],
                unit * (positions[then] - positions[earlier]) / ahead_s,
                unit * velocities[earlier],
                unit * ahead_s * accelerations[earlier],
            ]
            seen = unit * (positions[now] - positions[then]) / ahead_s
            if not unit * LARGEST_SPEED_M_PER_S >= max(abs(seen), abs(terms[0]), abs(terms[3])):
                continue
            index = 0
            for row in range(TERMS):
                term = terms[row]
                right[row] = keep * right[row] + term * seen
                for column in range(row, TERMS):
                    normal[index] = keep * normal[index] + term * terms[column]
                    index += 1
            keep = 1.0  # once for all axes
        if self._steps % SOLVED_EVERY == 0:
            self._solve()

    def _solve(self) -> None:
        """Solve the equations. The ridge keeps them solvable for any movement."""
        matrix = np.zeros((TERMS, TERMS))
        matrix[_UPPER] = self._normal
        matrix += np.triu(matrix, 1).T + RIDGE * np.eye(TERMS)
        right = list(self._right)
        if self._ahead_us:
            right[0] += RIDGE * self._prior(1e-6 * self._ahead_us)
        self._coefficients = np.linalg.solve(matrix, right).tolist()


class PartsPredictor:
    """A predictor for each part of the hand's position. Rotations are predicted as movements at `LEVER_M`."""

    def __init__(self, law: PartsLaw, period_us: int) -> None:
        self._parts = tuple(
            (each, KINDS[part.kind].m_per_unit, HandPredictor(part.axes, period_us))
            for part, each in zip(law.parts, law.slices(), strict=True)
        )

    def receive(self, t_us: int, position: Vector) -> None:
        """Add the position of a time [µs]."""
        for each, scale, hand in self._parts:
            hand.receive(t_us, times(position[each], scale))

    def predict(self, ahead_us: int) -> Vector:
        """Return the predicted position this long after the newest one."""
        return tuple([x / scale for _, scale, hand in self._parts for x in hand.predict(ahead_us)])


LONGEST_LEAD_US: Final = 20_000
"""Longest round trip [µs] at which a robot moves ahead. At 50 ms, on recordings of contact, errors of the prediction
made forces of 117 N where the hand was; up to 20 ms the share of ticks above 1 JND fell from 53 to 25 %."""


class ForceAhead:
    """The force of one scene at the predicted position. `period_us`: time [µs] between two positions; `law`: of forces.

    An exception of a user's scene ends prediction; present forces can still be served.
    """

    def __init__(self, scene: Touchable, period_us: int, law: WeberLaw | None = None) -> None:
        self._copy: Callable[[], Touchable] | None = copy_method(scene)
        self._hand: HandPredictor | PartsPredictor = HandPredictor(scene.axes, period_us)
        if isinstance(law, PartsLaw):
            self._hand = PartsPredictor(law, period_us)
        self._period_us = period_us
        self._lead_n = 0.0 if self._copy is not None else lead_limit_n(scene)
        self._line: PromisedLine | None = None
        self._answers = 0
        self._ahead_us = 0
        self.fault: str | None = None  # why the scene is not copied any more

    def answer(
        self, sample: PositionSample, scene_us: int, round_trip_us: int, line: PromisedLine | None = None
    ) -> tuple[Vector, Vector] | None:
        """Return position [m] and force [N] one round trip later; None to use the present ones.

        `sample` is the newest position, or the present place on the newest `line`; `scene_us` is the scene's time then
        [µs]. A master applies a force from the tick after its arrival on, and names it then: this period is not delay.
        """
        if self._copy is None:
            return None
        if line is not None and line is not self._line:
            self._line = line
            cast("HandPredictor", self._hand).follow(line)  # lines have no parts
        self._hand.receive(sample.t_us, sample.position_m)
        self._ahead_us = ahead_us = min(round_trip_us - self._period_us, LONGEST_AHEAD_US)
        if 2 * ahead_us < self._period_us:
            return None
        position_m = self._hand.predict(ahead_us)
        try:
            scene = self._copy()
            if ahead_us > self._period_us:  # so that the last step has the speed that the hand has there
                share = self._period_us / ahead_us
                near_m = tuple([x + share * (y - x) for x, y in zip(position_m, sample.position_m, strict=True)])
                scene.step(PositionSample(scene_us + ahead_us - self._period_us, near_m))
            force_n = scene.step(PositionSample(scene_us + ahead_us, position_m)).force_n
        except SampleError:
            return None
        except Exception as error:  # a user's scene may raise anything
            self._copy, self.fault = None, in_words(error)
            return None
        self._answers += 1
        return position_m, force_n

    def lead(self, sample: PositionSample, round_trip_us: int, force_n: Vector) -> Vector | None:
        """Return the position [m] at which to step a scene that moves ahead; None: the received one.

        `force_n` is its newest force.
        """
        if not self._lead_n:
            return None
        self._hand.receive(sample.t_us, sample.position_m)
        self._ahead_us = ahead_us = round_trip_us - self._period_us
        too_long = round_trip_us > LONGEST_LEAD_US or 2 * ahead_us < self._period_us
        if too_long or magnitude(force_n) > self._lead_n:
            return None
        self._answers += 1
        return self._hand.predict(ahead_us)

    def report(self) -> dict[str, Any]:
        """Return the figures of the prediction, for JSON."""
        return {"answers": self._answers, "ahead_us": max(self._ahead_us, 0), "fault": self.fault}
