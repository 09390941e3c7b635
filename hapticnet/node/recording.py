"""Recording of every sample by a node, for tables and figures."""

from array import array

import numpy as np

from hapticnet.arrays import FloatArray

SLAVE_COLUMNS = ("t_us", "position_m", "force_n", "held_n", "transmitted", "datagram_bytes", "breaches")
"""For each position answered: its time stamp (the master's clock), the position, the true force, the force that the
master applies if nothing is lost, whether a FORCE was transmitted, UDP payload bytes of the FORCE or KEEPALIVE sent
(0: neither), and surfaces breached so far."""

MASTER_COLUMNS = ("t_us", "position_m", "held_n", "target_n", "sensed_n", "displacement_m")
"""For each tick: time stamp of the position on the master's clock, position sent, and at that time: held force, force
requested of the device after all limits, sensed force, and displacement of the platform."""


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
