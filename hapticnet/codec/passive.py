"""Passive reduction: what is applied never gives the hand more energy than the true force would.

After Kuschel, Kremer, Hirche & Buss 2006, "Lossy data reduction methods for haptic telepresence systems" (ICRA), and
Kuschel, Kremer & Buss 2009, "Passive haptic data-compression methods with perceptual coding for bilateral presence
systems" (IEEE Trans. SMC-A 39(6)): the reconstruction is shifted by the deadband against the motion. The rule below is
derived for the convention here (positions x grow into the tissue, a positive force F pushes out of it).

The hand puts the work ``F · dx`` into the scene. Applying F̂ instead asks it for ``F̂ · dx``, so that
``(F - F̂) · dx`` is the energy created in that sample, with dx the motion since the sample before. Let v be the value
transmitted last, Δ the threshold around it, and u the direction of dx. The deadband sees to ``|F - v| ≤ Δ``, hence

    F · u  ≤  v · u + Δ                                  (Cauchy-Schwarz; for one axis, u = ±1)

and any F̂ with ``F̂ · u ≥ v · u + Δ`` has ``(F - F̂) · dx ≤ 0``: no sample creates energy, whatever force and motion do.
Pushing in, the applied force is the highest that the true one could be; pulling out, the lowest.

What that guarantees, and what it does not
- Every term ``(F - F̂) · dx`` is at most 0, and so is their running sum, where nothing is lost and the receiver knows
  the position of each sample. Shifts are wider than Δ by more than they round, so that floating point keeps to it.
  (Differences below 1e-154 N, which a norm takes for nothing, are not looked after.)
- A force that stands until the next sample acts along the *next* motion dx', which nobody knows yet. Counted that way a
  term can be positive only where the direction changes: by ``(Δ + |F - v|) · |dx'| ≤ 2 Δ |dx'|`` at a reversal.
- A lost or late update leaves v behind the force: nothing is guaranteed from then until the next update arrives.
- The error is up to 2 Δ, felt as dry friction of Δ, in free motion too, and every reversal is a step of 2 Δ. Zero
  exceedance is not claimed. With the law's multiplier at 0.5 the error is one JND of v at most.
- A hand at rest keeps the shift of its last direction: rest creates nothing, and letting go would be a step to feel.
  Before any motion, or where positions are not known, v is applied: this is then the plain deadband.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import MARGIN, worth_compiling
from hapticnet.codec.base import Encoder, Encoding
from hapticnet.codec.deadband import Deadband, hold_encoder
from hapticnet.codec.payload import PayloadFormat, check_parameter, check_step
from hapticnet.codec.recording import encode_streamed
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector, magnitude

FORWARD: Final = (1.0,)
BACKWARD: Final = (-1.0,)

SMALLEST_SQUARE: Final = 1e-280
"""Below it, squares lose digits to underflow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PassiveExtrapolative:
    """The deadband, with the held force shifted by the threshold against the motion.

    Rule: send as the deadband does; apply ``v + Δ · u``. Payload: the deadband's. Error: 2 Δ at most. No delay.

    Attributes
    ----------
    step_n
        Payload of int16 multiples of this [N], as in the deadband; 0: never.
    """

    name: ClassVar[str] = "passive-extrapolative"
    needs_position: ClassVar[bool] = True
    law: WeberLaw = field(default_factory=WeberLaw)
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_step(self.step_n)

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder."""
        return hold_encoder(self.law, PayloadFormat(axes, step_n=self.step_n), axes)

    def decoder(self, axes: int) -> "PassiveDecoder":
        """Return a new decoder."""
        return PassiveDecoder(self.law, PayloadFormat(axes, step_n=self.step_n), interval_us=0.0)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        if positions is None:
            return Deadband(law=self.law, step_n=self.step_n).encode_array(t_us, stimuli)
        stimuli, positions = as_recording(stimuli), as_recording(positions)
        if worth_compiling(stimuli, t_us, positions):
            from hapticnet.codec import kernels_positions

            return kernels_positions.passive_extrapolative(self.law, stimuli, positions, step_n=self.step_n)
        return encode_streamed(self, t_us, stimuli, positions)


@dataclass(frozen=True, slots=True, kw_only=True)
class PassiveInterpolative:
    """The same, led from value to value along a ramp wherever that takes energy.

    Rule: send as the deadband does. Over as long as the last two updates were apart, at most `interval_ms`, the
    receiver interpolates b from where it was to v, and applies ``b + (max((v - b) · u, 0) + Δ) · u``. For one axis
    that is ``max(b, v) + Δ`` pushing in and ``min(b, v) - Δ`` pulling out: a change in favour of the hand, such as
    a breach on the way in, comes as a ramp; one against it comes at once.
    Payload: the deadband's. Delay: up to `interval_ms` for changes in favour of the hand, none for the others.
    Error: up to 2 Δ, plus what is left of the ramp; on several axes the force applied on the way may be up to √2 times
    the larger of its ends, and Δ.

    Attributes
    ----------
    interval_ms
        Longest ramp [ms]: 0 to 1000.
    step_n
        Payload of int16 multiples of this [N], as in the deadband; 0: never.
    """

    name: ClassVar[str] = "passive-interpolative"
    needs_position: ClassVar[bool] = True
    law: WeberLaw = field(default_factory=WeberLaw)
    interval_ms: float = 20.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("interval_ms", self.interval_ms, 0.0, 1000.0)
        check_step(self.step_n)

    def encoder(self, axes: int) -> Encoder:
        """Return a new encoder."""
        return hold_encoder(self.law, PayloadFormat(axes, step_n=self.step_n), axes)

    def decoder(self, axes: int) -> "PassiveDecoder":
        """Return a new decoder."""
        form = PayloadFormat(axes, step_n=self.step_n)
        return PassiveDecoder(self.law, form, interval_us=self.interval_ms * 1e3)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        if positions is None:
            return Deadband(law=self.law, step_n=self.step_n).encode_array(t_us, stimuli)
        stimuli, positions = as_recording(stimuli), as_recording(positions)
        if worth_compiling(stimuli, t_us, positions):
            from hapticnet.codec import kernels_positions

            return kernels_positions.passive_interpolative(
                self.law, t_us, stimuli, positions, interval_ms=self.interval_ms, step_n=self.step_n
            )
        return encode_streamed(self, t_us, stimuli, positions)


class PassiveDecoder:
    """Applies the force that takes most energy of all that the true one could be. Satisfies `Decoder`."""

    __slots__ = (
        "_applied",
        "_direction",
        "_form",
        "_from",
        "_interval_us",
        "_law",
        "_position",
        "_ramp_us",
        "_shift_n",
        "_t_us",
        "_value",
    )

    def __init__(self, law: WeberLaw, form: PayloadFormat, *, interval_us: float) -> None:
        self._law = law
        self._form = form
        self._interval_us = interval_us
        self._position: Vector | None = None
        self._direction: Vector | None = None
        self._t_us: int | None = None  # of the last update
        self._value: Vector = (0.0,) * form.axes
        self._from = self._value
        self._ramp_us = 0.0
        self._shift_n = 0.0
        self._applied: Vector | None = None  # where only an update or another direction changes it

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload."""
        value = self._form.unpack(payload)
        since_us = 0 if self._t_us is None else t_us - self._t_us
        self._from = self._interpolated(t_us) if since_us > 0 and self._interval_us else value
        self._ramp_us = min(since_us, self._interval_us)  # none where time stands or goes back
        self._t_us, self._value = t_us, value
        size = magnitude(value)
        threshold_n = self._law.threshold_n(size)
        self._shift_n = threshold_n + MARGIN * (threshold_n + 2.0 * size + magnitude(self._from))
        self._applied = None

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:
        """Return the stimulus to apply at time `t_us`, with the tool at `position` [m]."""
        before = self._position
        if position is not None and position != before:
            self._position = position
            if before is not None and (direction := _direction(before, position)) != self._direction:
                self._direction = direction
                self._applied = None
        return self._applied or self._apply(t_us)

    def _apply(self, t_us: int) -> Vector:
        """Work out what to apply, and keep it where time does not change it."""
        value, along = self._value, self._direction
        if along is None or self._t_us is None:
            return value
        base, shift = self._interpolated(t_us), self._shift_n
        if base is value:
            self._applied = tuple([v + shift * u for v, u in zip(value, along, strict=True)])
            return self._applied
        ahead = 0.0
        for v, b, u in zip(value, base, along, strict=True):
            ahead += (v - b) * u
        if ahead > 0.0:
            shift += ahead
        return tuple([b + shift * u for b, u in zip(base, along, strict=True)])

    def _interpolated(self, t_us: int) -> Vector:
        """Return where the ramp is at a time."""
        elapsed_us = t_us - (self._t_us or 0)
        if not 0 <= elapsed_us < self._ramp_us:
            return self._value
        share = elapsed_us / self._ramp_us
        return tuple([a + share * (b - a) for a, b in zip(self._from, self._value, strict=True)])


def _direction(before: Vector, now: Vector) -> Vector:
    """Return the unit vector from one position to another that differs."""
    if len(now) == 1:
        return FORWARD if now > before else BACKWARD
    motion = [n - b for n, b in zip(now, before, strict=True)]
    square = 0.0
    for component in motion:
        square += component * component
    if square < SMALLEST_SQUARE:
        largest = max(map(abs, motion))
        motion = [component / largest for component in motion]
        square = sum([component * component for component in motion])
    norm = math.sqrt(square)
    return tuple([component / norm for component in motion])
