"""Updates of the least-squares predictor: a byte, and then a line or a residual in Golomb-Rice codes.

Bit 7 of the byte is set for a line, which needs no earlier update; the other bits number the updates, modulo 128. A
residual names the update that it builds on.
"""

from typing import Any, Final, NamedTuple

from hapticnet.codec.schemes.linear_predictive import LineForm, LineMessage
from hapticnet.codec.values import COUNT_BYTES, SINGLE_BYTES
from hapticnet.errors import PeerError
from hapticnet.samples import Vector
from hapticnet_literature.golomb_rice import bits_of, pack_integers, unpack_integers

ABSOLUTE: Final = 0x80
COUNTS: Final = 0x80
"""Numbers of updates."""

ABSOLUTE_EVERY: Final = COUNTS - 1
"""Updates from one absolute payload to the next, at most."""

RESIDUAL: Final = 0
"""The form of an update that is a residual."""

LARGEST_STEPS: Final = 1e6
"""Residuals of more steps are not coded, so that only finite, small numbers are rounded."""

LARGEST_PARAMETER: Final = 30

FORGET_ABOVE: Final = 32
"""Number of integers after which sum and count are halved, so that the mean follows recent ones (T.87: 64)."""


class Rice(NamedTuple):
    """How many integers were coded, their sum after folding, and the parameter k that fits them."""

    coded: int
    sum: int
    parameter: int


class Update(NamedTuple):
    """A message of the least-squares predictor.

    Attributes
    ----------
    form
        Bytes an axis of the value of a line; `RESIDUAL`.
    number
        Number of the line; for a residual, number of the update it builds on.
    value, slope
        Value [N] and slope [N/s] of a line; for a residual, both are its steps.
    parameter
        The Golomb-Rice parameter of a residual.
    """

    form: int
    number: int
    value: Vector
    slope: Vector
    parameter: int


def first_rice(mean: int) -> Rice:
    """Return the state at an absolute update, for integers of some mean."""
    return fitted(1, mean)


def next_rice(rice: Rice, residual: Vector) -> Rice:
    """Return the state after the integers of a residual."""
    count, total = rice.coded + len(residual), rice.sum
    for axis in range(len(residual)):
        total += folded(residual[axis])
    return fitted(count // 2, total // 2) if count >= FORGET_ABOVE else fitted(count, total)


def fitted(count: int, total: int) -> Rice:
    """Return the state with the least parameter for which ``count · 2^parameter ≥ sum``."""
    parameter, reach = 0, count
    while reach < total and parameter < LARGEST_PARAMETER:
        reach *= 2
        parameter += 1
    return Rice(count, total, parameter)


def folded(steps: float) -> int:
    """Return a signed integer folded onto 0, 1, 2, … in the order 0, -1, 1, -2, 2, …."""
    integer = int(steps)
    return 2 * integer if integer >= 0 else -2 * integer - 1


def residual_bits(residual: Vector, parameter: int) -> int:
    """Return the length of the codes of a residual."""
    bits = 0
    for axis in range(len(residual)):
        bits += bits_of(folded(residual[axis]), parameter)
    return bits


def fits(residual: Vector, parameter: int) -> bool:
    """Tell whether the codes of a residual are no longer than its value in float32."""
    return residual_bits(residual, parameter) <= 8 * SINGLE_BYTES * len(residual)


def update_bytes(rule: Any, update: Update) -> int:
    """Return the size of the payload of an update."""
    if update.form == RESIDUAL:
        return 1 + (residual_bits(update.value, update.parameter) + 7) // 8
    slope_bytes = COUNT_BYTES if update.form == COUNT_BYTES else SINGLE_BYTES
    return 1 + (update.form + slope_bytes) * len(update.value)


class UpdateForm:
    """Updates as bytes. Satisfies `Form`."""

    __slots__ = ("_axes", "_lines")

    def __init__(self, axes: int, *, step_n: float, slope_step: float) -> None:
        self._axes = axes
        self._lines = LineForm(axes, step_n=step_n, slope_step=slope_step)

    def pack(self, update: Update) -> bytes:
        """Return the payload of an update."""
        if update.form == RESIDUAL:
            return bytes([update.number]) + pack_integers(map(folded, update.value), update.parameter)
        line = LineMessage(update.form, update.value, update.slope)
        return bytes([ABSOLUTE | update.number]) + self._lines.pack(line)

    def unpack(self, payload: bytes, receiver: Any) -> Update:
        """Return the update in a payload for a receiver in some state.

        Raises
        ------
        PeerError
            If the payload is malformed, or builds on another update than the last one of the receiver.
        """
        if not payload:
            raise PeerError("payload of 0 bytes; it starts with a byte that numbers the update")
        number = payload[0] % COUNTS
        if payload[0] & ABSOLUTE:
            line = self._lines.unpack(payload[1:])
            return Update(line.form, number, line.value, line.slope, 0)
        if number != receiver.number:
            raise PeerError(f"payload builds on update {number}; the last one here is {receiver.number}")
        if len(payload) > 1 + SINGLE_BYTES * self._axes:
            raise PeerError(f"residual of {len(payload) - 1} bytes; at most {SINGLE_BYTES * self._axes} are sent")
        parameter = receiver.rice.parameter
        codes = unpack_integers(payload[1:], self._axes, parameter)
        steps = tuple([float(code >> 1 if code % 2 == 0 else -(code + 1 >> 1)) for code in codes])
        return Update(RESIDUAL, number, steps, steps, parameter)
