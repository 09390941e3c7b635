"""The least-squares predictor: what both sides know already foretells the stimulus, and residuals are a few bits.

Sakr, Zhou, Georganas, Zhao & Shen 2008, "Prediction-based haptic data reduction and compression in tele-mentoring
systems" (IMTC): least-squares prediction, uniform quantisation, adaptive Golomb-Rice codes. Sakr, Zhou, Georganas, Zhao
& Petriu 2009, "Robust perception-based data reduction and transmission in telehaptic systems" (World Haptics): a
median filter before it. How the rest of the state is kept in step, and started anew at impacts, is ours.
"""

from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Encoding
from hapticnet.codec.golomb_rice import RiceParameter, pack_integers, unpack_integers
from hapticnet.codec.payload import SINGLE_BYTES, check_axes, check_parameter, check_step, distance
from hapticnet.codec.predictive import Line, LineFormat, check_integer, is_impact, least_squares_slope
from hapticnet.codec.recording import encode_streamed
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, Vector, checked_vector, magnitude

ABSOLUTE: Final = 0x80
"""Set in the first byte of a payload that needs no earlier one; the other seven bits count the updates."""

COUNTS: Final = 0x80

LARGEST_STEPS: Final = 1e6
"""A residual of more steps is not tried as a code, so that only what is finite and small is rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastSquares:
    """Transmit, as a few bits, how far the stimulus is from what earlier updates foretell.

    Rule: both sides predict ``p = value + slope · min(t - t_sent, horizon)`` from the last update, with the slope of
    the least-squares line through the last `updates` transmitted values, each but the outer ones replaced by the
    median of itself and its neighbours; an impact starts the line anew. The transmitted samples are the ones both
    sides know, whatever is sampled in between. Send when ``|x - p| > threshold(|p|)``, strictly.
    Payload: a byte, and the residual in steps of ``step_fraction · threshold(|p|)``, an axis at a time,
    Golomb-Rice coded. The byte names the state that it builds on; a decoder in another one refuses it, and the
    session asks for a refresh. The first payload, one after a refresh, every `absolute_every`-th, and whatever a
    residual would not be true enough or as short for, is absolute: value and slope, as in the linear-predictive codec,
    and both sides start from there.

    Without loss the applied stimulus is within the threshold of the true one at every sample, whatever the input.
    After a loss the line received last is followed to the horizon and held, until the next absolute payload. (A run of
    exactly 128 n lost updates goes unnoticed until then.)

    Attributes
    ----------
    updates
        Transmitted values that the slope is taken from: 2 (the line through them) to 16. More of them, and their
        median, help where noise is all there is; on recorded forces and the paper's scene each costs packets.
    horizon_ms
        For how long a line is followed before its end is held [ms]: 1 to 10 000.
    step_fraction
        Quantisation step of a residual, in thresholds: 0.01 to 1. Above 0.5, rounding the axes leaves several of them
        near the edge of the dead zone, and packets multiply.
    absolute_every
        Updates from one absolute payload to the next, at most: 1 to 127.
    step_n
        Absolute payloads of int16 multiples of this [N], as in the linear-predictive codec; 0: never.
    """

    name: ClassVar[str] = "least-squares"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    updates: float = 2
    horizon_ms: float = 100.0
    step_fraction: float = 0.5
    absolute_every: float = 16
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_integer("updates", self.updates, 2, 16)
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("step_fraction", self.step_fraction, 0.01, 1.0)
        check_integer("absolute_every", self.absolute_every, 1, COUNTS - 1)
        check_step(self.step_n)

    def encoder(self, axes: int) -> "LeastSquaresEncoder":
        """Return a new encoder."""
        return LeastSquaresEncoder(self, axes)

    def decoder(self, axes: int) -> "LeastSquaresDecoder":
        """Return a new decoder."""
        return LeastSquaresDecoder(self, axes)

    def encode_array(
        self, t_us: npt.NDArray[np.int64], stimuli: FloatArray, positions: FloatArray | None = None
    ) -> Encoding:
        """Encode a whole recording; see `Codec.encode_array`."""
        return encode_streamed(self, t_us, stimuli, positions)


class Predictor:
    """What both sides know, and so foretell: a function of the payloads since the last absolute one."""

    __slots__ = ("_first_mean", "_known", "_law", "_rice", "_step_fraction", "_updates", "count", "form", "line")

    def __init__(self, codec: LeastSquares, axes: int) -> None:
        self._law = codec.law
        self._step_fraction = codec.step_fraction
        self._updates = int(codec.updates)
        self._known: list[tuple[int, Vector]] = []
        # A residual is above the threshold: folded, it is twice as many steps as make up that, and more.
        self._first_mean = round(2.0 / codec.step_fraction)
        self._rice = RiceParameter(self._first_mean)
        self.form = LineFormat(check_axes(axes), codec.law, horizon_ms=codec.horizon_ms, step_n=codec.step_n)
        self.count: int | None = None  # of the last update; None before the first
        self.line = self.form.level(0, (0.0,) * axes)

    @property
    def parameter(self) -> int:
        """The Golomb-Rice parameter of the next residual."""
        return self._rice.value

    def step(self, predicted: Vector) -> float:
        """Return the quantisation step [N] of a residual from `predicted`."""
        return self._step_fraction * self._law.threshold_n(magnitude(predicted))

    def start(self, count: int, line: Line) -> None:
        """Start from an absolute payload."""
        self.count = count
        self.line = line
        self._rice = RiceParameter(self._first_mean)
        self._known = [(line.t_us, line.value)]

    def advance(self, count: int, t_us: int, residual: tuple[int, ...], predicted: Vector, value: Vector) -> None:
        """Go on by a residual, which leads from the predicted to the present value."""
        self.count = count
        self._known = self._known_with(t_us, predicted, value)
        self.line = self.form.line(t_us, value, filtered_slope(self._known))
        self._rice.add(residual)

    def slope(self, t_us: int, predicted: Vector, value: Vector) -> Vector:
        """Return the slope [N/s] from a value on that is transmitted at a time."""
        return filtered_slope(self._known_with(t_us, predicted, value))

    def _known_with(self, t_us: int, predicted: Vector, value: Vector) -> list[tuple[int, Vector]]:
        if is_impact(predicted, value, self._law):
            return [(t_us, value)]
        return [*self._known, (t_us, value)][-self._updates :]


def filtered_slope(samples: list[tuple[int, Vector]]) -> Vector:
    """Return the slope [N/s] of the least-squares line through samples whose outliers are taken out."""
    return least_squares_slope(median_filtered(samples))


def median_filtered(samples: list[tuple[int, Vector]]) -> list[tuple[int, Vector]]:
    """Return samples, each but the first and the last replaced by the median of itself and its neighbours."""
    if len(samples) < 3:
        return samples
    filtered = list(samples)
    for index in range(1, len(samples) - 1):
        neighbours = (sample for _, sample in samples[index - 1 : index + 2])
        filtered[index] = samples[index][0], tuple([sorted(axis)[1] for axis in zip(*neighbours, strict=True)])
    return filtered


class LeastSquaresEncoder:
    """Compares with what the receiver foretells. Satisfies `Encoder`."""

    __slots__ = ("_absolute_every", "_law", "_most_bytes", "_predictor", "_since_absolute")

    def __init__(self, codec: LeastSquares, axes: int) -> None:
        self._law = codec.law
        self._absolute_every = int(codec.absolute_every)
        self._predictor = Predictor(codec, axes)
        self._most_bytes = SINGLE_BYTES * axes
        self._since_absolute: int | None = None  # None: the next stimulus is sent, and as an absolute payload

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload, or None where the prediction is near enough."""
        line = self._predictor.line
        if self._since_absolute is not None and line.is_near(t_us, stimulus):
            return None
        stimulus, predicted = checked_vector(stimulus, "stimulus"), line.at(t_us)
        return self._residual(t_us, stimulus, predicted) or self._absolute(t_us, stimulus, predicted)

    def refresh(self) -> None:
        """Make the next payload one that needs no earlier one."""
        self._since_absolute = None

    def _residual(self, t_us: int, stimulus: Vector, predicted: Vector) -> bytes | None:
        """Return the payload of a residual and go on by it; None where it may not be one."""
        predictor = self._predictor
        step = predictor.step(predicted)
        if self._since_absolute is None or self._since_absolute + 1 >= self._absolute_every or not step:
            return None
        steps = [(x - p) / step for x, p in zip(stimulus, predicted, strict=True)]
        if not max(map(abs, steps)) < LARGEST_STEPS:
            return None
        residual = tuple(map(round, steps))
        packed = pack_integers(residual, predictor.parameter, most_bytes=self._most_bytes)
        value = reconstructed(predicted, residual, step)
        if packed is None or value is None or distance(stimulus, value) > self._law.threshold_n(magnitude(value)):
            return None
        count = predictor.count or 0
        predictor.advance((count + 1) % COUNTS, t_us, residual, predicted, value)
        self._since_absolute += 1
        return bytes([count]) + packed

    def _absolute(self, t_us: int, stimulus: Vector, predicted: Vector) -> bytes:
        """Return a payload that needs no earlier one, and start from it."""
        predictor = self._predictor
        count = 0 if predictor.count is None else (predictor.count + 1) % COUNTS
        payload, line = predictor.form.pack(t_us, stimulus, predictor.slope(t_us, predicted, stimulus))
        predictor.start(count, line)
        self._since_absolute = 0
        return bytes([ABSOLUTE | count]) + payload


class LeastSquaresDecoder:
    """Foretells, and is put right. Satisfies `Decoder`."""

    __slots__ = ("_axes", "_predictor")

    def __init__(self, codec: LeastSquares, axes: int) -> None:
        self._axes = axes
        self._predictor = Predictor(codec, axes)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload."""
        predictor = self._predictor
        if not payload:
            raise PeerError("payload of 0 bytes; it starts with a byte that names its state")
        count = payload[0] % COUNTS
        if payload[0] & ABSOLUTE:
            predictor.start(count, predictor.form.unpack(t_us, payload[1:]))
            return
        if count != predictor.count:
            raise PeerError(f"payload builds on update {count}; the last one here is {predictor.count}")
        if len(payload) > 1 + SINGLE_BYTES * self._axes:
            raise PeerError(f"residual of {len(payload) - 1} bytes; at most {SINGLE_BYTES * self._axes} are sent")
        predicted = predictor.line.at(t_us)
        residual = unpack_integers(payload[1:], self._axes, predictor.parameter)
        value = reconstructed(predicted, residual, predictor.step(predicted))
        if value is None:
            raise PeerError(f"payload leads to a stimulus beyond ±{LARGEST_COMPONENT:g}")
        predictor.advance((count + 1) % COUNTS, t_us, residual, predicted, value)

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002 - motion decides nothing
        """Return what is foretold for time `t_us`."""
        return self._predictor.line.at(t_us)


def reconstructed(predicted: Vector, residual: tuple[int, ...], step: float) -> Vector | None:
    """Return the stimulus that lies so many steps from the predicted one; None when it is out of range."""
    value = tuple([p + steps * step for p, steps in zip(predicted, residual, strict=True)])
    return value if all(-LARGEST_COMPONENT <= component <= LARGEST_COMPONENT for component in value) else None
