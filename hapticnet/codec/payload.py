"""A stimulus as bytes: big-endian IEEE 754, four bytes an axis, or eight where four would not be true enough."""

import struct
from collections.abc import Mapping
from typing import Final

from hapticnet.errors import PeerError, SampleError
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector, checked_vector

SINGLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}f") for axes in range(1, MAX_AXES + 1)}
DOUBLE: Final[Mapping[int, struct.Struct]] = {axes: struct.Struct(f">{axes}d") for axes in range(1, MAX_AXES + 1)}

SINGLE_BYTES: Final = 4
DOUBLE_BYTES: Final = 8


def pack_single(stimulus: Vector) -> bytes:
    """Return a stimulus as float32, refusing what is not finite or out of range with a SampleError."""
    return SINGLE[len(stimulus)].pack(*checked_vector(stimulus, "stimulus"))


def unpack_stimulus(payload: bytes, axes: int, *, may_be_wide: bool = True) -> Vector:
    """Return the stimulus in a payload of float32, or of float64 where the codec has that.

    Raises
    ------
    PeerError
        When the length fits neither, or a component is not finite or out of range.
    """
    if len(payload) == axes * SINGLE_BYTES:
        stimulus: Vector = SINGLE[axes].unpack(payload)
    elif may_be_wide and len(payload) == axes * DOUBLE_BYTES:
        stimulus = DOUBLE[axes].unpack(payload)
    else:
        wide = f" or {DOUBLE_BYTES * axes}" if may_be_wide else ""
        raise PeerError(f"payload of {len(payload)} bytes; {axes} axes take {SINGLE_BYTES * axes}{wide}")
    for component in stimulus:
        if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
            raise PeerError(f"payload holds {component}; it must be finite and within ±{LARGEST_COMPONENT:g}")
    return stimulus


class HoldDecoder:
    """Zero-order hold: applies the last stimulus received until the next one. Satisfies `Decoder`."""

    __slots__ = ("_axes", "_held", "_may_be_wide")

    def __init__(self, axes: int, *, may_be_wide: bool) -> None:
        self._axes = axes
        self._may_be_wide = may_be_wide
        self._held: Vector = (0.0,) * axes

    def decode(self, t_us: int, payload: bytes) -> None:  # noqa: ARG002 - a hold has no use for the time
        """Take in a payload."""
        self._held = unpack_stimulus(payload, self._axes, may_be_wide=self._may_be_wide)

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002 - a hold needs neither
        """Return the held stimulus."""
        return self._held


def check_axes(axes: int) -> int:
    """Return `axes`, refusing numbers of axes that cannot be packed with a SampleError."""
    if axes not in SINGLE:
        raise SampleError(f"{axes} axes; 1 to {MAX_AXES} are supported")
    return axes
