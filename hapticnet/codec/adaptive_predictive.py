"""The adaptive-predictive deadband: a curve whose slope and start are what has foretold the stimulus best so far.

A codec of our own. It is a predictive deadband (see `codec.predictive`) that learns, from how its own predictions
ended, how far to trust two slopes and a smoothed level. Where the stimulus is smooth it extrapolates; where it is noise
it holds the level; where it wanders without a trend it becomes a plain deadband. The receiver learns nothing: each
payload is a whole curve. That the slope dies away is the damped trend of Gardner & McKenzie 1985, "Forecasting trends
in time series" (Management Science), with a parabola instead of their exponential, so that it ends.
"""

import math
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, as_recording
from hapticnet.codec.arrays import worth_compiling
from hapticnet.codec.base import Encoding
from hapticnet.codec.payload import PayloadFormat, check_axes, check_parameter, check_step, distance
from hapticnet.codec.predictive import is_impact, limited
from hapticnet.codec.recording import encode_streamed
from hapticnet.codec.trend import Trust, Vectors, trend
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector, checked_vector, magnitude

TRAVEL: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}e") for axes in range(1, MAX_AXES + 1)}

LARGEST_TRAVEL: Final = 1024.0
"""How many thresholds a curve can travel an axis. Far above any hand's force; it bounds what a lost update leaves."""

LARGEST_OFFSET: Final = 0.9
"""How far from the stimulus a curve may start, as a share of what the threshold allows. The rest is for rounding."""

BAND: Final = 2.0
"""A sample further than this from the line through the newer ones, in thresholds, is from before an impact."""

SMALLEST_JUMP: Final = 0.1
"""The least bound on jumps, in thresholds. Below it most updates would have to start at the edge of the threshold."""

MOST_SAMPLES: Final = 64
"""Samples that a slope is taken from, at most: it bounds the cost of an update."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptivePredictive:
    """Transmit a curve that foretells the stimulus, as learned from how earlier curves ended.

    Rule: both sides apply ``p = value + travel · s · (2 - s)``, ``s = min((t - t_sent) / horizon, 1)``: a slope that
    dies away and ends in a hold. Send when ``|x - p| > threshold(|p|)``, strictly. The first stimulus is always sent.
    The curve sent has ``travel = horizon / 2 · (c1 · short slope + c2 · long slope)`` and ``value = x + c3 · level``;
    the slopes are those of the newest samples (`codec.trend`), the level is how far their line passes from x, and the
    c are learned by least squares (`codec.trend.Trust`), such that a slope that goes on, and on
    which both agree, is led by 0.3 thresholds at most. A curve never starts further from x than the threshold.
    Payload: the value as in the deadband, then an axis at a time float16, the travel in thresholds around the value.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input.
    After a loss, and for as long as an update comes late, the curve is followed to its end: by then it is at most
    ``|travel|`` from its start.

    Attributes
    ----------
    horizon_ms
        For how long the slope takes to die away [ms]: 1 to 10 000.
    window_ms
        How old the samples are that the long slope is taken from [ms]: 1 to 1000, and no less than three sampling
        periods; the short one, 0.3 of that.
    jump_thresholds
        How far the applied stimulus may jump when an update arrives, in thresholds: 0.1 to 10; further only as far as
        the threshold around the stimulus demands. The rest of the way is made up for along the curve. 0: as far as
        saves most.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "adaptive-predictive"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    horizon_ms: float = 200.0
    window_ms: float = 17.0
    jump_thresholds: float = 0.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("window_ms", self.window_ms, 1.0, 1000.0)
        if self.jump_thresholds:
            check_parameter("jump_thresholds", self.jump_thresholds, SMALLEST_JUMP, 10.0)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "AdaptivePredictiveEncoder":
        """Return a new encoder."""
        return AdaptivePredictiveEncoder(self, axes)

    def decoder(self, axes: int) -> "AdaptivePredictiveDecoder":
        """Return a new decoder."""
        return AdaptivePredictiveDecoder(self, axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        stimuli = as_recording(stimuli)
        if worth_compiling(stimuli, t_us):
            from hapticnet.codec import kernels_adaptive

            return kernels_adaptive.adaptive_predictive(
                self.law,
                t_us,
                stimuli,
                horizon_ms=self.horizon_ms,
                window_ms=self.window_ms,
                jump_thresholds=self.jump_thresholds,
                step_n=self.step_n,
            )
        return encode_streamed(self, t_us, stimuli, positions)


class Curve:
    """A stimulus whose rate of change dies away to nothing at the horizon. It depends on differences of times only."""

    __slots__ = ("_floor_n", "_gain", "_horizon_us", "_terms", "t_us", "value")

    def __init__(self, t_us: int, value: Vector, travel: Vector, law: WeberLaw, *, horizon_us: float) -> None:
        self.t_us = t_us
        self.value = value
        self._terms = list(zip(value, travel, strict=True))
        self._horizon_us = horizon_us
        self._gain, self._floor_n = law.multiplier * law.weber_fraction, law.multiplier * law.floor_n

    def share(self, t_us: int) -> float:
        """Return how much of its travel it has made at a time, 0 to 1."""
        s = (t_us - self.t_us) / self._horizon_us
        return s * (2.0 - s) if 0.0 < s < 1.0 else float(s > 0.0)

    def at(self, t_us: int) -> Vector:
        """Return the stimulus at a time; before its own time it is its value."""
        s = (t_us - self.t_us) / self._horizon_us
        share = s * (2.0 - s) if 0.0 < s < 1.0 else float(s > 0.0)
        if len(self._terms) == 1:
            ((v, travel),) = self._terms
            return (v + travel * share,)
        return tuple([v + travel * share for v, travel in self._terms])

    def is_near(self, t_us: int, stimulus: Vector) -> bool:
        """Tell whether a stimulus is within the threshold around the curve at a time; NaN and infinity never are.

        As `distance(stimulus, at(t_us)) <= threshold_n(magnitude(at(t_us)))` is, in one go: it runs at every sample.
        """
        s = (t_us - self.t_us) / self._horizon_us
        share = s * (2.0 - s) if 0.0 < s < 1.0 else float(s > 0.0)
        if len(stimulus) == 1:
            ((v, travel),) = self._terms
            point = v + travel * share
            error = abs(stimulus[0] - point)
            return error <= self._floor_n or error <= self._gain * abs(point)
        square = size = 0.0
        for x, (v, travel) in zip(stimulus, self._terms, strict=True):
            point = v + travel * share
            square += (x - point) * (x - point)
            size += point * point
        error = math.sqrt(square)
        return error <= self._floor_n or error <= self._gain * math.sqrt(size)


class CurveFormat:
    """A curve as bytes: its value as `PayloadFormat` has it, then its travel as float16 multiples of the threshold."""

    __slots__ = ("_horizon_us", "_law", "_travel", "_value", "axes")

    def __init__(self, codec: AdaptivePredictive, axes: int) -> None:
        self.axes = check_axes(axes)
        self._law = codec.law
        self._horizon_us = codec.horizon_ms * 1e3
        self._value = PayloadFormat(axes, step_n=codec.step_n)
        self._travel = TRAVEL[axes]

    def curve(self, t_us: int, value: Vector, travel: Vector) -> Curve:
        """Return a curve."""
        return Curve(t_us, value, travel, self._law, horizon_us=self._horizon_us)

    def pack(self, t_us: int, stimulus: Vector, start: Vector, travel: Vector) -> tuple[bytes, Curve]:
        """Return the payload of a curve from `start`, and the curve that the receiver makes of it.

        Where rounding takes it out of the threshold around `stimulus`, it starts from there.
        """
        payload, value, threshold = self._value.pack(start, self._law)
        if not distance(stimulus, value) <= threshold:
            payload, value, threshold = self._value.pack(stimulus, self._law)
        thresholds = [_within(each / threshold, LARGEST_TRAVEL) if threshold else 0.0 for each in travel]
        travels = self._travel.pack(*thresholds)
        taken = self._taken(value, threshold, travels)
        if taken is None:
            travels = self._travel.pack(*[0.0] * self.axes)
            taken = (0.0,) * self.axes
        return payload + travels, self.curve(t_us, value, taken)

    def unpack(self, t_us: int, payload: bytes) -> Curve:
        """Return the curve in a payload.

        Raises
        ------
        PeerError
            When the length fits no form, or where it starts or ends is not finite or out of range.
        """
        value = self._value.unpack(payload[: -self._travel.size])
        travels = payload[-self._travel.size :]
        taken = self._taken(value, self._law.threshold_n(magnitude(value)), travels)
        if taken is None:
            raise PeerError(
                f"payload holds a travel of {self._travel.unpack(travels)} thresholds; it must be within"
                f" ±{LARGEST_TRAVEL:g} and end within ±{LARGEST_COMPONENT:g}"
            )
        return self.curve(t_us, value, taken)

    def _taken(self, value: Vector, threshold: float, travels: bytes) -> Vector | None:
        """Return the travel [N] that a receiver takes from its bytes; None for one that is refused."""
        thresholds = self._travel.unpack(travels)
        travel = tuple([each * threshold for each in thresholds])
        for v, each, multiple in zip(value, travel, thresholds, strict=True):
            if not (abs(multiple) <= LARGEST_TRAVEL and abs(v + each) <= LARGEST_COMPONENT):
                return None
        return travel


class AdaptivePredictiveEncoder:
    """Compares with the receiver's curve, and learns from where it ends. Satisfies `Encoder`."""

    __slots__ = (
        "_causes",
        "_curve",
        "_form",
        "_half_us",
        "_jump_thresholds",
        "_law",
        "_newest",
        "_sent",
        "_trust",
        "_window_us",
    )

    def __init__(self, codec: AdaptivePredictive, axes: int) -> None:
        self._law = codec.law
        self._form = CurveFormat(codec, axes)
        self._half_us = 500.0 * codec.horizon_ms
        self._window_us = 1000.0 * codec.window_ms
        self._jump_thresholds = codec.jump_thresholds
        self._newest: deque[tuple[int, Vector]] = deque(maxlen=MOST_SAMPLES)
        self._trust = Trust()
        self._curve: Curve | None = None
        # The stimulus that the curve was sent for, and what was thought to move it.
        self._sent: Vector = ()
        self._causes: Vectors = ((), (), ())

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None where the curve is near enough."""
        curve = self._curve
        if curve is not None and curve.is_near(t_us, stimulus):
            self._newest.append((t_us, stimulus))
            return None
        stimulus = checked_vector(stimulus, "stimulus")
        applied = None if curve is None else curve.at(t_us)
        if curve is not None and applied is not None and not is_impact(applied, stimulus, self._law):
            moved = _difference(stimulus, self._sent)
            self._trust.learn(self._causes, moved, curve.share(t_us), self._law.threshold_n(magnitude(self._sent)))
        self._newest.append((t_us, stimulus))
        threshold = self._law.threshold_n(magnitude(stimulus))
        short, long, level = trend(self._newest, band_n=BAND * threshold, window_us=self._window_us)
        self._sent = stimulus
        self._causes = tuple([self._half_us * x for x in short]), tuple([self._half_us * x for x in long]), level
        travel, offset = self._trust.foretell(self._causes, threshold)
        # At a start nearer to zero the threshold is smaller, by at most the Weber fraction of the offset.
        room = LARGEST_OFFSET * threshold / (1.0 + self._law.multiplier * self._law.weber_fraction)
        start = _moved(stimulus, offset, room)
        if applied is not None and self._jump_thresholds:
            wanted = start
            start = _moved(applied, _difference(wanted, applied), self._jump_thresholds * threshold)
            start = _moved(stimulus, _difference(start, stimulus), room)
            travel = tuple([e + w - s for e, w, s in zip(travel, wanted, start, strict=True)])
        payload, self._curve = self._form.pack(t_us, stimulus, tuple([limited(x) for x in start]), travel)
        return payload

    def refresh(self) -> None:
        """Forget the curve, so that the next stimulus is sent."""
        self._curve = None


class AdaptivePredictiveDecoder:
    """Follows the curve received last. Satisfies `Decoder`."""

    __slots__ = ("_curve", "_form")

    def __init__(self, codec: AdaptivePredictive, axes: int) -> None:
        self._form = CurveFormat(codec, axes)
        self._curve = self._form.curve(0, (0.0,) * axes, (0.0,) * axes)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload."""
        self._curve = self._form.unpack(t_us, payload)

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002 - motion decides nothing
        """Return the point of the curve at time `t_us`."""
        return self._curve.at(t_us)


def _within(value: float, limit: float) -> float:
    return max(-limit, min(value, limit))


def _difference(one: Vector, other: Vector) -> Vector:
    return tuple([x - y for x, y in zip(one, other, strict=True)])


def _moved(origin: Vector, by: Vector, limit: float) -> Vector:
    """Return where `by` leads from `origin`, or as far that way as the limit allows."""
    length = magnitude(by)
    share = limit / length if length > limit else 1.0
    return tuple([x + share * each for x, each in zip(origin, by, strict=True)])
