"""A stimulus as bytes, big-endian: int16 counts of a step, float32, or float64 where less would not be true enough."""

import math
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from hapticnet.errors import PeerError, SampleError, SettingsError
from hapticnet.perception import WeberLaw
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector, checked_vector, magnitude

COUNT: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}h") for axes in range(1, MAX_AXES + 1)}
SINGLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}f") for axes in range(1, MAX_AXES + 1)}
DOUBLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}d") for axes in range(1, MAX_AXES + 1)}

COUNT_BYTES: Final = 2
SINGLE_BYTES: Final = 4
DOUBLE_BYTES: Final = 8

LARGEST_COUNT: Final = 32_767
"""Counts are symmetric: -32 768, the one int16 beyond, is never sent and refused."""

LARGEST_STEP_N: Final = 1.0
SMALLEST_STEP_N: Final = 1e-12


def check_axes(axes: int) -> int:
    """Return `axes`, refusing numbers of axes that cannot be packed with a SampleError."""
    if axes not in SINGLE:
        raise SampleError(f"{axes} axes; 1 to {MAX_AXES} are supported")
    return axes


class Form(Protocol):
    """A way of writing stimuli that a hold can work with."""

    def pack(self, stimulus: Vector, law: WeberLaw) -> tuple[bytes, Vector, float]:
        """Return the payload of a stimulus, what the receiver makes of it, and the threshold [N] around that."""
        ...

    def unpack(self, payload: bytes) -> Vector:
        """Return the stimulus in a payload; a PeerError refuses what `pack` cannot have made."""
        ...


class PayloadFormat:
    """The payload of a whole stimulus; its length tells which of three forms it has. Satisfies `Form`.

    ======= ========== ============================================================================
    bytes   form       used
    ======= ========== ============================================================================
    2/axis  int16      counts of `step_n`, where that is above 0 and true enough
    4/axis  float32    else, where true enough
    8/axis  float64    else
    ======= ========== ============================================================================

    True enough: the stimulus is within the threshold around what the receiver makes of the payload.

    Parameters
    ----------
    axes
        Components of a stimulus, 1 to 3.
    step_n
        Size of a count [N]; 0: no counts.
    wide
        Whether there is a float64 form.
    """

    __slots__ = ("_count", "_double", "_readers", "_single", "_step_n", "axes")

    def __init__(self, axes: int, *, step_n: float = 0.0, wide: bool = True) -> None:
        self.axes = check_axes(axes)
        self._step_n = step_n
        self._count, self._single, self._double = COUNT[axes], SINGLE[axes], DOUBLE[axes]
        self._readers: dict[int, Callable[[bytes], tuple[Any, ...]]] = {self._single.size: self._single.unpack}
        if wide:
            self._readers[self._double.size] = self._double.unpack
        if step_n:
            self._readers[self._count.size] = self._unpack_counts

    def pack(self, stimulus: Vector, law: WeberLaw) -> tuple[bytes, Vector, float]:
        """Return the payload of a stimulus, what the receiver makes of it, and the threshold [N] around that.

        Raises
        ------
        SampleError
            When the stimulus is not finite or out of range.
        """
        stimulus = checked_vector(stimulus, "stimulus")
        if self._step_n:
            counts = self._counts(stimulus)
            if counts is not None:
                reference = self._counted(counts)
                threshold = law.threshold_n(magnitude(reference))
                if distance(stimulus, reference) <= threshold:
                    return self._count.pack(*counts), reference, threshold
        payload = self._single.pack(*stimulus)
        reference = self._single.unpack(payload)
        threshold = law.threshold_n(magnitude(reference))
        if distance(stimulus, reference) <= threshold:
            return payload, reference, threshold
        return self._double.pack(*stimulus), stimulus, law.threshold_n(magnitude(stimulus))

    def pack_rounded(self, stimulus: Vector) -> bytes:
        """Return the payload of a stimulus for a codec without thresholds: counts where in range, else float32.

        Raises
        ------
        SampleError
            When the stimulus is not finite or out of range.
        """
        stimulus = checked_vector(stimulus, "stimulus")
        counts = self._counts(stimulus) if self._step_n else None
        return self._single.pack(*stimulus) if counts is None else self._count.pack(*counts)

    def unpack(self, payload: bytes) -> Vector:
        """Return the stimulus in a payload.

        Raises
        ------
        PeerError
            When the length fits no form, or a component is not finite or out of range.
        """
        reader = self._readers.get(len(payload))
        if reader is None:
            lengths = " or ".join(map(str, sorted(self._readers)))
            raise PeerError(f"payload of {len(payload)} bytes; {self.axes} axes take {lengths}")
        stimulus = reader(payload)
        for component in stimulus:
            if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                raise PeerError(f"payload holds {component}; it must be finite and within ±{LARGEST_COMPONENT:g}")
        return stimulus

    def _counts(self, stimulus: Vector) -> list[int] | None:
        """Return the nearest counts, halves to even; None when one is out of range."""
        counts = [round(component / self._step_n) for component in stimulus]
        return counts if max(counts) <= LARGEST_COUNT and min(counts) >= -LARGEST_COUNT else None

    def _counted(self, counts: "list[int] | tuple[int, ...]") -> Vector:
        return tuple([count * self._step_n for count in counts])

    def _unpack_counts(self, payload: bytes) -> Vector:
        counts = self._count.unpack(payload)
        if min(counts) < -LARGEST_COUNT:
            raise PeerError(f"payload counts {min(counts)} steps; {-LARGEST_COUNT} is the least")
        return self._counted(counts)


class HoldDecoder:
    """Zero-order hold: applies the last stimulus received until the next one. Satisfies `Decoder`."""

    __slots__ = ("_form", "_held")

    def __init__(self, form: Form, axes: int) -> None:
        self._form = form
        self._held: Vector = (0.0,) * axes

    def decode(self, t_us: int, payload: bytes) -> None:  # noqa: ARG002 - a hold has no use for the time
        """Take in a payload."""
        self._held = self._form.unpack(payload)

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002 - a hold needs neither
        """Return the held stimulus."""
        return self._held


def distance(one: Vector, other: Vector) -> float:
    """Return the Euclidean norm of the difference of two vectors."""
    if len(one) == 1:
        return abs(one[0] - other[0])
    square = 0.0
    for x, y in zip(one, other, strict=True):
        square += (x - y) * (x - y)
    return math.sqrt(square)


def check_step(step_n: float) -> None:
    """Refuse a step of counts [N] that cannot be used with a SettingsError."""
    if step_n and not SMALLEST_STEP_N <= step_n <= LARGEST_STEP_N:
        raise SettingsError(
            f"step_n is {step_n}; it must be 0 (no counts) or between {SMALLEST_STEP_N:g} and {LARGEST_STEP_N:g} N"
        )


def check_parameter(name: str, value: float, smallest: float, largest: float) -> None:
    """Refuse a parameter that is not finite or out of its range with a SettingsError."""
    if not smallest <= value <= largest:
        raise SettingsError(f"{name} is {value}; it must be between {smallest:g} and {largest:g}")
