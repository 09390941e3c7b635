"""The linear-predictive deadband: both sides extrapolate, and only what strays from the line is transmitted.

First-order prediction within the deadband: Hinterseer, Hirche, Chaudhuri, Steinbach & Buss 2008, "Perception-based data
reduction and transmission of haptic data in telepresence and teleaction systems" (IEEE Trans. Signal Processing). Here
the payload carries the slope beside the value, so that what was lost before it does no lasting harm.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoding
from hapticnet.codec.payload import (
    COUNT,
    COUNT_BYTES,
    LARGEST_COUNT,
    SINGLE,
    PayloadFormat,
    check_axes,
    check_parameter,
    check_step,
    distance,
)
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import PeerError, SettingsError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector, checked_vector, magnitude

IMPACT_THRESHOLDS: Final = 3.0
"""A stimulus further than this from the prediction is an impact or a breach.

An assumption. On the paper's scene, whose breaches take one sample, it saves a quarter of the packets and more; on
recorded forces it hardly ever strikes. Anything from 2 to 4 does the same.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPredictive:
    """Transmit value and slope when the stimulus strays from the line that was transmitted last.

    Rule: both sides predict ``p = value + slope · min(t - t_sent, horizon)``, limited to ±1e15 an axis; send when
    ``|x - p| > threshold(|p|)``, strictly. `slope` is that of the least-squares line through the newest samples,
    which low-passes it; samples before an impact (`is_impact`) are forgotten. The first stimulus is always sent.
    Payload: the value as in the deadband, then the slope [N/s]: float32 an axis, or int16 beside an int16 value.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input. At
    an impact it therefore overshoots by a threshold at most; between two samples, or for the time that an update
    comes late, by ``|slope| · time`` more, which ends at the horizon.

    Attributes
    ----------
    slope_samples
        Newest samples that the slope is taken from: 2 to 64.
    horizon_ms
        For how long a line is followed before its end is held [ms]: 1 to 10 000.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold, and of
        ``step_n / horizon`` [N/s] for the slope; 0: never.
    """

    name: ClassVar[str] = "linear-predictive"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    slope_samples: float = 5
    horizon_ms: float = 100.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_integer("slope_samples", self.slope_samples, 2, 64)
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "LinearPredictiveEncoder":
        """Return a new encoder."""
        return LinearPredictiveEncoder(self, axes)

    def decoder(self, axes: int) -> "LinearPredictiveDecoder":
        """Return a new decoder."""
        return LinearPredictiveDecoder(self, axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        if worth_compiling(stimuli, t_us):
            from hapticnet.codec import kernels_scalar

            samples, horizon_ms = int(self.slope_samples), self.horizon_ms
            encoding = kernels_scalar.linear_predictive(
                self.law, t_us, stimuli, slope_samples=samples, horizon_ms=horizon_ms, step_n=self.step_n
            )
            if encoding is not None:
                return encoding
        return encode_streamed(self, t_us, stimuli, positions)


class Line:
    """A stimulus that changes at a constant rate for a limited time. It depends on differences of times only."""

    __slots__ = ("_floor_n", "_gain", "_horizon_us", "_terms", "_within_range", "slope_n_per_s", "t_us", "value")

    def __init__(self, t_us: int, value: Vector, slope_n_per_s: Vector, law: WeberLaw, *, horizon_us: float) -> None:
        self.t_us = t_us
        self.value = value
        self.slope_n_per_s = slope_n_per_s
        self._horizon_us = horizon_us
        self._terms = [(v, slope * 1e-6) for v, slope in zip(value, slope_n_per_s, strict=True)]
        self._within_range = True
        for v, rate in self._terms:
            if abs(v) + abs(rate) * horizon_us >= LARGEST_COMPONENT:
                self._within_range = False
        self._gain, self._floor_n = law.multiplier * law.weber_fraction, law.multiplier * law.floor_n

    def at(self, t_us: int) -> Vector:
        """Return the stimulus at a time; before its own time it is its value."""
        elapsed_us: float = t_us - self.t_us
        if elapsed_us <= 0:
            return self.value
        if elapsed_us > self._horizon_us:
            elapsed_us = self._horizon_us
        point = [v + rate * elapsed_us for v, rate in self._terms]
        return tuple(point) if self._within_range else tuple(map(limited, point))

    def is_near(self, t_us: int, stimulus: Vector) -> bool:
        """Tell whether a stimulus is within the threshold around the line at a time; NaN and infinity never are.

        As `distance(stimulus, at(t_us)) <= threshold_n(magnitude(at(t_us)))` is, in one go: it runs at every sample.
        """
        if not self._within_range:
            point = self.at(t_us)
            return distance(stimulus, point) <= max(self._gain * magnitude(point), self._floor_n)
        elapsed_us: float = t_us - self.t_us
        if elapsed_us < 0:
            elapsed_us = 0
        elif elapsed_us > self._horizon_us:
            elapsed_us = self._horizon_us
        if len(stimulus) == 1:
            ((v, rate),) = self._terms
            p = v + rate * elapsed_us
            error = abs(stimulus[0] - p)
            return error <= self._floor_n or error <= self._gain * abs(p)
        square = size = 0.0
        for x, (v, rate) in zip(stimulus, self._terms, strict=True):
            p = v + rate * elapsed_us
            square += (x - p) * (x - p)
            size += p * p
        error = math.sqrt(square)
        return error <= self._floor_n or error <= self._gain * math.sqrt(size)


def is_impact(predicted: Vector, stimulus: Vector, law: WeberLaw) -> bool:
    """Tell whether a stimulus is so far from the predicted one that what was before does not foretell what comes."""
    return distance(stimulus, predicted) > IMPACT_THRESHOLDS * law.threshold_n(magnitude(predicted))


def limited(component: float) -> float:
    """Return a component limited to what a stimulus may be."""
    if -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
        return component
    return math.copysign(LARGEST_COMPONENT, component)


def least_squares_slope(samples: Sequence[tuple[int, Vector]]) -> Vector:
    """Return the slope [N/s] of the least-squares line through samples, an axis at a time; 0 when all are of one time.

    Computed afresh and from differences, so that neither large numbers nor long runs leave anything behind.
    """
    newest_us, newest = samples[-1]
    count = len(samples)
    total_us = squares_us2 = 0
    for at_us, _ in samples:
        apart_us = at_us - newest_us
        total_us += apart_us
        squares_us2 += apart_us * apart_us
    spread_us2 = count * squares_us2 - total_us * total_us
    if not spread_us2:
        return (0.0,) * len(newest)
    slope = []
    for axis, x in enumerate(newest):
        product = 0.0
        for at_us, sample in samples:
            product += (count * (at_us - newest_us) - total_us) * (sample[axis] - x)
        slope.append(limited(1e6 * product / spread_us2))
    return tuple(slope)


class LineFormat:
    """A stimulus and its slope as bytes: the value as `PayloadFormat` has it, then the slope, which follows its form.

    ======== ======= ===================================================
    bytes    value   slope
    ======== ======= ===================================================
    4/axis   int16   int16, counts of ``step_n / horizon``, limited
    8/axis   float32 float32
    12/axis  float64 float32
    ======== ======= ===================================================
    """

    __slots__ = ("_axes", "_count_n_per_s", "_horizon_us", "_law", "_value")

    def __init__(self, axes: int, law: WeberLaw, *, horizon_ms: float, step_n: float) -> None:
        self._axes = axes
        self._law = law
        self._value = PayloadFormat(axes, step_n=step_n)
        self._horizon_us = horizon_ms * 1e3
        # A count moves the end of the line by as much as one of the value's; rounding, by half of that.
        self._count_n_per_s = step_n * 1e3 / horizon_ms

    def level(self, t_us: int, value: Vector) -> Line:
        """Return a line without slope."""
        return self.line(t_us, value, (0.0,) * self._axes)

    def line(self, t_us: int, value: Vector, slope_n_per_s: Vector) -> Line:
        """Return a line that ends at the horizon."""
        return Line(t_us, value, slope_n_per_s, self._law, horizon_us=self._horizon_us)

    def pack(self, t_us: int, stimulus: Vector, slope_n_per_s: Vector) -> tuple[bytes, Line]:
        """Return the payload of a stimulus and its slope, and the line that the receiver makes of them.

        Raises
        ------
        SampleError
            When the stimulus is not finite or out of range.
        """
        payload, value, _ = self._value.pack(stimulus, self._law)
        if len(payload) == COUNT_BYTES * self._axes:
            counts = [self._counts(slope) for slope in slope_n_per_s]
            return payload + COUNT[self._axes].pack(*counts), self.line(t_us, value, self._counted(counts))
        slope = SINGLE[self._axes].pack(*slope_n_per_s)
        return payload + slope, self.line(t_us, value, SINGLE[self._axes].unpack(slope))

    def unpack(self, t_us: int, payload: bytes) -> Line:
        """Return the line in a payload.

        Raises
        ------
        PeerError
            When the length fits no form, or a component is not finite or out of range.
        """
        form = COUNT[self._axes] if len(payload) == 2 * COUNT_BYTES * self._axes else SINGLE[self._axes]
        value = self._value.unpack(payload[: -form.size])
        slope: Vector = form.unpack(payload[-form.size :])
        if form is COUNT[self._axes]:
            slope = self._counted(slope)
        for component in slope:
            if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                raise PeerError(f"payload holds a slope of {component} N/s; it must be within ±{LARGEST_COMPONENT:g}")
        return self.line(t_us, value, slope)

    def _counts(self, slope_n_per_s: float) -> int:
        return max(-LARGEST_COUNT, min(round(slope_n_per_s / self._count_n_per_s), LARGEST_COUNT))

    def _counted(self, counts: Sequence[float]) -> Vector:
        return tuple([count * self._count_n_per_s for count in counts])


class LinearPredictiveEncoder:
    """Compares with the receiver's line. Satisfies `Encoder`."""

    __slots__ = ("_form", "_law", "_line", "_newest")

    def __init__(self, codec: LinearPredictive, axes: int) -> None:
        self._law = codec.law
        self._form = LineFormat(check_axes(axes), codec.law, horizon_ms=codec.horizon_ms, step_n=codec.step_n)
        self._newest: deque[tuple[int, Vector]] = deque(maxlen=int(codec.slope_samples))
        self._line: Line | None = None

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None where the line is near enough."""
        line = self._line
        if line is not None and line.is_near(t_us, stimulus):
            self._newest.append((t_us, stimulus))
            return None
        stimulus = checked_vector(stimulus, "stimulus")
        if line is not None and is_impact(line.at(t_us), stimulus, self._law):
            self._newest.clear()
        self._newest.append((t_us, stimulus))
        payload, self._line = self._form.pack(t_us, stimulus, least_squares_slope(self._newest))
        return payload

    def refresh(self) -> None:
        """Forget the line, so that the next stimulus is sent."""
        self._line = None


class LinearPredictiveDecoder:
    """Follows the line received last. Satisfies `Decoder`."""

    __slots__ = ("_form", "_line")

    def __init__(self, codec: LinearPredictive, axes: int) -> None:
        self._form = LineFormat(check_axes(axes), codec.law, horizon_ms=codec.horizon_ms, step_n=codec.step_n)
        self._line = self._form.level(0, (0.0,) * axes)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload."""
        self._line = self._form.unpack(t_us, payload)

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002 - motion decides nothing
        """Return the point of the line at time `t_us`."""
        return self._line.at(t_us)


def check_integer(name: str, value: float, smallest: int, largest: int) -> None:
    """Refuse a parameter that is no whole number or out of its range with a SettingsError."""
    check_parameter(name, value, smallest, largest)
    if value != int(value):
        raise SettingsError(f"{name} is {value}; it must be a whole number")
