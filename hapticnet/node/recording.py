"""Recording of every sample and datagram by a node, for tables and figures."""

from array import array
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.parts import AXIS_NAMES, Parts

IN: Final = 0.0
OUT: Final = 1.0

DATAGRAM_COLUMNS: Final = ("t_us", "direction", "kind", "datagram_bytes")
"""For each datagram: when it was sent or received, on the node's own clock; direction, 0 in or 1 out; `wire.Kind` as a
number, as the frame says; UDP payload bytes."""


VIBRATION_COLUMNS: Final = ("t_us", "played_m_s2", "felt_m_s2")
"""For each sample of vibration: when it is played, on the master's clock, what is asked of the device, and what a
simulated one makes of it."""


def axis_columns(quantity: str, unit: str, axes: int) -> tuple[str, ...]:
    """Return the names of a vector's columns: ``force_n`` for one axis, ``force_x_n, force_y_n, …`` for more."""
    if axes == 1:
        return (f"{quantity}_{unit}",)
    return tuple(f"{quantity}_{axis}_{unit}" for axis in AXIS_NAMES[:axes])


def position_columns(axes: int, parts: Parts) -> tuple[str, ...]:
    """Return the names of a position's columns."""
    of_parts = tuple(name for part in parts for name in part.columns("position", is_position=True))
    return of_parts or axis_columns("position", "m", axes)


def force_columns(quantity: str, axes: int, parts: Parts) -> tuple[str, ...]:
    """Return the names of a stimulus's columns, such as "force" or "held"."""
    return tuple(name for part in parts for name in part.columns(quantity)) or axis_columns(quantity, "n", axes)


def slave_columns(axes: int, parts: Parts = ()) -> tuple[str, ...]:
    """Return the columns of a slave's recording, one row for each position answered.

    Its time stamp (the master's clock), the position, the true force, the force that the master applies if nothing is
    lost, whether a FORCE was transmitted, UDP payload bytes of the FORCE or KEEPALIVE sent (0: neither), surfaces
    breached so far, and when it was answered (the slave's clock).
    """
    return (
        "t_us",
        *position_columns(axes, parts),
        *force_columns("force", axes, parts),
        *force_columns("held", axes, parts),
        "transmitted",
        "datagram_bytes",
        "breaches",
        "answered_us",
    )


def master_columns(axes: int, parts: Parts = ()) -> tuple[str, ...]:
    """Return the columns of a master's recording, one row for each tick.

    Time of the tick on the master's clock (a position of this tick has it as its time stamp), position, and at that
    time: force received (what the decoder reconstructs), held force, force requested of the device after all limits,
    sensed force, and displacement of the platform.
    """
    return (
        "t_us",
        *position_columns(axes, parts),
        *force_columns("received", axes, parts),
        *force_columns("held", axes, parts),
        "target_n",
        "sensed_n",
        "displacement_m",
    )


class Recording:
    """Rows of numbers, appended by one `extend` of a flat array: eight bytes a number and no object per row."""

    def __init__(self, columns: tuple[str, ...]) -> None:
        self.columns = columns
        self._numbers = array("d")

    def __len__(self) -> int:
        return len(self._numbers) // len(self.columns)

    def add(self, row: tuple[float, ...]) -> None:
        """Append a row, one number per column."""
        self._numbers.extend(row)

    def take(self) -> "array[float]":
        """Return all rows as one flat array, and begin again without any."""
        numbers, self._numbers = self._numbers, array("d")
        return numbers

    def table(self) -> dict[str, FloatArray]:
        """Return the columns by name, shape (n,)."""
        rows = np.array(self._numbers, dtype=np.float64).reshape(-1, len(self.columns))
        return {name: rows[:, index] for index, name in enumerate(self.columns)}


def frame_kind(data: bytes) -> float:
    """Return the kind that a datagram's frame names (the third byte of every datagram, docs/refer/protocol.md)."""
    return float(data[2]) if len(data) > 2 else -1.0
