"""A whole stimulus as bytes: counts of a step, float32, or float64 where float32 is too coarse.

An encoder takes the shortest form whose value is close enough for the stimulus to be within the threshold around it
(docs/refer/payloads.md).
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple, Never, Protocol

from hapticnet.checks import check_parameter
from hapticnet.errors import PeerError, SampleError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import nearest
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector
from hapticnet.vectors import distance, magnitude, single

HALF: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}e") for axes in range(1, MAX_AXES + 1)}
COUNT: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}h") for axes in range(1, MAX_AXES + 1)}
SINGLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}f") for axes in range(1, MAX_AXES + 1)}
DOUBLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}d") for axes in range(1, MAX_AXES + 1)}

COUNT_BYTES: Final = 2
SINGLE_BYTES: Final = 4
DOUBLE_BYTES: Final = 8  # bytes per axis, which identify the form of a message
LARGEST_COUNT: Final = 32_767  # counts are symmetric: -32 768, the one int16 beyond, is never sent and is refused

LARGEST_STEP_N: Final = 1.0
SMALLEST_STEP_N: Final = 1e-12


class LawNumbers(Protocol):
    """The numbers of a perceptual law in a rule."""

    @property
    def weber(self) -> float:
        """Threshold as a fraction of the reference."""

    @property
    def floor(self) -> float:
        """Smallest threshold [N]."""


class ValueNumbers(LawNumbers, Protocol):
    """The numbers that choose the form of a value."""

    @property
    def step(self) -> float:
        """Size of a count [N]; 0: no counts."""


class ValueRule(NamedTuple):
    """The only numbers of a rule. Satisfies `ValueNumbers`."""

    weber: float
    floor: float
    step: float


def law_numbers(law: WeberLaw) -> tuple[float, float]:
    """Return the threshold of a law as a fraction of the reference, and the smallest one [N]."""
    return law.multiplier * law.weber_fraction, law.multiplier * law.floor_n


def threshold_around(rule: LawNumbers, value: Vector) -> float:
    """Return the threshold [N] around an applied stimulus."""
    width = rule.weber * (abs(value[0]) if len(value) == 1 else magnitude(value))
    return width if width > rule.floor else rule.floor


def is_within(rule: LawNumbers, x: Vector, applied: Vector) -> bool:
    """Return whether a stimulus is within the threshold around the applied one; NaN and infinity never are."""
    if len(x) == 1:  # inlined from below, because this runs at every sample
        error, size = abs(x[0] - applied[0]), abs(applied[0])
    else:
        error, size = distance(x, applied), magnitude(applied)
    width = rule.weber * size
    return error <= (width if width > rule.floor else rule.floor)


def rounded(rule: ValueNumbers, x: Vector) -> tuple[int, Vector, float]:
    """Return the form of a stimulus's payload, the value that the receiver decodes, and the threshold around it."""
    if rule.step > 0.0 and are_countable(x, rule.step):
        value = counted(x, rule.step)
        width = threshold_around(rule, value)
        if distance(x, value) <= width:
            return COUNT_BYTES, value, width
    value = single(x)
    width = threshold_around(rule, value)
    if distance(x, value) <= width:
        return SINGLE_BYTES, value, width
    return DOUBLE_BYTES, x, threshold_around(rule, x)


def are_countable(x: Vector, step: float) -> bool:
    """Return whether every component is within `LARGEST_COUNT` steps, rounded."""
    if len(x) == 1:
        return abs(nearest(x[0] / step)) <= LARGEST_COUNT
    if len(x) == 2:
        return abs(nearest(x[0] / step)) <= LARGEST_COUNT and abs(nearest(x[1] / step)) <= LARGEST_COUNT
    return (
        abs(nearest(x[0] / step)) <= LARGEST_COUNT
        and abs(nearest(x[1] / step)) <= LARGEST_COUNT
        and abs(nearest(x[2] / step)) <= LARGEST_COUNT
    )


def counted(x: Vector, step: float) -> Vector:
    """Return the nearest multiples of the step, halves to even; no component is a negative zero."""
    if len(x) == 1:
        return (nearest(x[0] / step) * step + 0.0,)
    if len(x) == 2:
        return nearest(x[0] / step) * step + 0.0, nearest(x[1] / step) * step + 0.0
    return nearest(x[0] / step) * step + 0.0, nearest(x[1] / step) * step + 0.0, nearest(x[2] / step) * step + 0.0


class ValueForm:
    """Messages ``(form, value)`` as bytes; counts unless `step_n` is 0, and float64 if `wide`. Satisfies `Form`."""

    __slots__ = ("_packers", "_readers", "_step_n", "axes")

    def __init__(self, axes: int, *, step_n: float = 0.0, wide: bool = True) -> None:
        self.axes = check_axes(axes)
        self._step_n = step_n
        forms = {SINGLE_BYTES: SINGLE[axes]}
        if wide:
            forms[DOUBLE_BYTES] = DOUBLE[axes]
        if step_n:
            forms[COUNT_BYTES] = COUNT[axes]
        self._packers = {form: layout.pack for form, layout in forms.items()}
        self._readers = {form * axes: (form, layout.unpack) for form, layout in forms.items()}

    def pack(self, message: tuple[int, Vector]) -> bytes:
        """Return the payload of a message."""
        form, value = message
        if form == COUNT_BYTES:
            return self._packers[form](*counts_of(value, self._step_n))
        return self._packers[form](*value)

    def unpack(self, payload: bytes, receiver: object = None) -> tuple[int, Vector]:  # noqa: ARG002
        """Return the message in a payload; PeerError if its length fits no form, or a component is out of range."""
        form, read = self._readers.get(len(payload)) or self._refuse(payload)
        value: Vector = read(payload)
        if form == COUNT_BYTES:
            value = from_counts(value, self._step_n)
        for component in value:
            if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
                raise PeerError(f"payload holds {component}; it must be finite and within ±{LARGEST_COMPONENT:g}")
        return form, value

    def _refuse(self, payload: bytes) -> Never:
        lengths = " or ".join(map(str, sorted(self._readers)))
        raise PeerError(f"payload of {len(payload)} bytes; {self.axes} axes take {lengths}")


def counts_of(value: Sequence[float], step: float) -> list[int]:
    """Return the counts of a value that `counted` returned."""
    return [round(component / step) for component in value]


def from_counts(counts: Sequence[float], step: float) -> Vector:
    """Return the value of counts; PeerError if one is out of range."""
    if min(counts) < -LARGEST_COUNT:
        raise PeerError(f"payload counts {min(counts):g} steps; the smallest count is {-LARGEST_COUNT}")
    return tuple([count * step for count in counts])


def value_bytes(rule: object, message: tuple[int, Vector]) -> int:
    """Return the size of the payload of a message ``(form, value)``."""
    return message[0] * len(message[1])


def check_axes(axes: int) -> int:
    """Return `axes`; SampleError if it is not 1 to 3."""
    if axes not in SINGLE:
        raise SampleError(f"{axes} axes; 1 to {MAX_AXES} are supported")
    return axes


def check_step(step_n: float) -> None:
    """Raise SettingsError if the step of counts [N] is invalid."""
    check_parameter("step_n", step_n, SMALLEST_STEP_N, LARGEST_STEP_N, "N", zero_allowed=True)
