"""The deadband that widens while the hand moves, because force is then told apart less well.

That the force JND grows with the speed of the hand, and that a deadband may follow it: Zadeh 2008;
Kammerl, Vittorias, Nitsch, Faerber, Steinbach, Hirche, "Perception-based data reduction for haptic force-feedback
signals using velocity-adaptive deadbands", Presence 19(5), 2010, 450-462, which reports reductions of up to 96 %.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoding
from hapticnet.codec.deadband import Deadband
from hapticnet.codec.payload import (
    Form,
    HoldDecoder,
    PayloadFormat,
    check_axes,
    check_parameter,
    check_step,
    distance,
)
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector, magnitude


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityAdaptive:
    """Transmit a stimulus only when it can be told apart from the one being held by a hand moving so fast.

    Rule: send when ``|x - ref| > multiplier · max(fraction · |ref|, floor_n)``, strictly, with `ref` the last
    transmitted stimulus as it was rounded for the wire, and
    ``fraction = max(weber_fraction, min(weber_fraction + speed_gain_s_m · |v|, largest_fraction))``.
    The threshold is the one of the present speed: a hand that slows down finds the deadband narrower, so that a held
    stimulus may leave it without changing. The receiver holds and knows nothing of the speed.

    Speed: with each position p, ``v ← (τ·v + p - p_before) / (τ + dt)``, the low-passed difference quotient (backward
    Euler of ``τ·dv/dt = dp/dt - v``), per axis; |v| is its norm, so that jitter cancels instead of adding up. A
    repeated time stamp is passed over; one that goes back starts anew, at rest.

    At rest, and wherever positions are not known, it is the deadband. In motion the error exceeds the JND *at rest* on
    purpose, and never the threshold above. Payload: as the deadband's.

    Attributes
    ----------
    speed_gain_s_m
        Growth of the Weber fraction with speed [1 per m/s]. The linear form is after Kammerl 2010; the default is an
        assumption of ours (0.1 m/s doubles the paper's fraction of 0.05), to be replaced by what is measured on
        the person at hand.
    largest_fraction
        What the growth ends at, 0 to 1. An assumption as well: nothing tells that it goes on.
    time_constant_ms
        τ of the speed's low-pass [ms]; 0: the bare difference quotient.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold at rest; 0:
        never.
    """

    name: ClassVar[str] = "velocity-adaptive"
    needs_position: ClassVar[bool] = True
    law: WeberLaw = field(default_factory=WeberLaw)
    speed_gain_s_m: float = 0.5
    largest_fraction: float = 0.25
    time_constant_ms: float = 10.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("speed_gain_s_m", self.speed_gain_s_m, 0.0, 1e3)
        check_parameter("largest_fraction", self.largest_fraction, 0.0, 1.0)
        check_parameter("time_constant_ms", self.time_constant_ms, 0.0, 1e4)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "VelocityAdaptiveEncoder":
        """Return a new encoder."""
        return VelocityAdaptiveEncoder(self, PayloadFormat(check_axes(axes), step_n=self.step_n), axes)

    def decoder(self, axes: int) -> HoldDecoder:
        """Return a new decoder."""
        return HoldDecoder(PayloadFormat(axes, step_n=self.step_n), axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        if positions is None:
            return Deadband(law=self.law, step_n=self.step_n).encode_array(t_us, stimuli)
        stimuli, positions = as_recording(stimuli), as_recording(positions)
        if worth_compiling(stimuli, t_us, positions):
            from hapticnet.codec import kernels_positions

            return kernels_positions.velocity_adaptive(
                self.law,
                t_us,
                stimuli,
                positions,
                speed_gain_s_m=self.speed_gain_s_m,
                largest_fraction=self.largest_fraction,
                time_constant_s=self.time_constant_ms * 1e-3,
                step_n=self.step_n,
            )
        return encode_streamed(self, t_us, stimuli, positions)


class HandSpeed:
    """The speed of the hand, from its positions and nothing later than the present one."""

    __slots__ = ("_position_m", "_t_us", "_time_constant_s", "_velocity", "m_per_s")

    def __init__(self, time_constant_s: float, axes: int) -> None:
        self._time_constant_s = time_constant_s
        self._velocity = [0.0] * axes
        self._position_m: Vector | None = None
        self._t_us = 0
        self.m_per_s = 0.0

    def move(self, t_us: int, position_m: Vector) -> None:
        """Take in the position at time `t_us`.

        Raises
        ------
        SampleError
            When it is not finite or out of range. The state is then unchanged.
        """
        for component in position_m:
            if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                raise SampleError(f"position is {component}; it must be finite and within ±{LARGEST_COMPONENT:g}")
        before = self._position_m
        elapsed_s = (t_us - self._t_us) * 1e-6
        if before is None or elapsed_s < 0.0:
            self._velocity = [0.0] * len(self._velocity)
            self.m_per_s = 0.0
        elif elapsed_s == 0.0:
            return
        else:
            keep = self._time_constant_s
            span = keep + elapsed_s
            velocity = self._velocity
            for axis, (new, old) in enumerate(zip(position_m, before, strict=True)):
                velocity[axis] = (keep * velocity[axis] + (new - old)) / span
            self.m_per_s = magnitude(tuple(velocity))
        self._t_us = t_us
        self._position_m = position_m


class VelocityAdaptiveEncoder:
    """Holds each stimulus against the threshold of its moment. Satisfies `Encoder`."""

    __slots__ = ("_floor_n", "_gain", "_largest", "_law", "_magnitude", "_pack", "_reference", "_speed", "_weber")

    def __init__(self, codec: VelocityAdaptive, form: Form, axes: int) -> None:
        law = codec.law
        self._law = law
        self._pack = form.pack
        # The multiplier first, as the law has it: at rest both thresholds are the same to the bit.
        self._weber = law.multiplier * law.weber_fraction
        self._floor_n = law.multiplier * law.floor_n
        self._gain = law.multiplier * codec.speed_gain_s_m
        self._largest = max(law.multiplier * codec.largest_fraction, self._weber)
        self._speed = HandSpeed(codec.time_constant_ms * 1e-3, axes)
        self._reference: Vector | None = None
        self._magnitude = 0.0

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload, or None inside the dead zone."""
        fraction = self._weber
        if position is not None:
            self._speed.move(t_us, position)
            fraction = min(fraction + self._gain * self._speed.m_per_s, self._largest)
        reference = self._reference
        if reference is not None:
            threshold = max(fraction * self._magnitude, self._floor_n)
            if distance(stimulus, reference) <= threshold:
                return None
        payload, self._reference, _ = self._pack(stimulus, self._law)
        self._magnitude = magnitude(self._reference)
        return payload

    def refresh(self) -> None:
        """Empty the dead zone, so that the next stimulus is sent."""
        self._reference = None
