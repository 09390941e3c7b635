"""Rows of the master's ticks: recorded in the tick, turned into messages outside it."""

import math
from typing import Final

import numpy as np

from hapticnet.arrays import FloatArray
from hapticnet.measure.metrics import FeltReport, error_report
from hapticnet.node.master import MasterNode
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import Kind
from hapticnet.web import messages
from hapticnet.web.mirror import Mirror

MOST_KEPT: Final = 20_000  # most rows kept for `felt`
_FORCE: Final = int(Kind.FORCE)


class Ticks:
    """Rows of a master's ticks since a page began."""

    def __init__(self, node: MasterNode, start_us: int) -> None:
        self.rows = 0  # number of rows so far
        self._node = node
        self._start_us = start_us
        self._rows: list[tuple[float, ...]] = []
        self._packets = 0.0
        self._felt = False
        self._past = np.empty((3, 0))  # of the newest rows: time [s] since the server began, true and held force

    def add(self, now_us: int) -> None:
        """Record a tick; called during it."""
        node = self._node
        position_m = node.position_m
        if position_m is None:
            return
        received_n, held_n = node.received_n[: node.first_axes], node.held_n[: node.first_axes]
        if len(held_n) == 1:
            (received,), (held,) = received_n, held_n
        else:
            received, held = math.hypot(*received_n), math.hypot(*held_n)
        self._rows.append(  # a third of the time of extending an array, and there are few
            (
                now_us, position_m[0], received, held, node.target_n, node.sensed_n, node.displacement_m,
                node.session.received.by_kind[_FORCE],
            )
        )  # fmt: skip

    def take(self, mirror: Mirror | None) -> list[bytes]:
        """Return SAMPLES messages of the ticks since the last call, and move the mirror of the scene along."""
        if not self._rows:
            return []
        taken, self._rows = self._rows, []
        rows = np.array(taken, dtype=np.float64)
        t_us, position, received, held, target, sensed, platform, counts = rows.T
        position = position.astype(np.float32).astype(np.float64)  # as the slave receives it
        if mirror is None:
            true = np.full(len(rows), math.nan)
        else:
            true = np.array(mirror.forces_n(t_us.astype(np.int64).tolist(), position.tolist()))
        packets = np.diff(counts, prepend=self._packets)
        self._packets = float(counts[-1])
        self._felt = self._felt or bool(received.any())
        times_s = 1e-6 * (t_us - t_us[0])
        columns = np.stack([times_s, position, true, received, held, target, sensed, platform, packets])
        start_s = 1e-6 * float(t_us[0] - self._start_us)
        first = self.rows
        self.rows += len(rows)
        past = np.concatenate([self._past, [start_s + times_s, true, held]], axis=1)
        self._past = past[:, past[0] >= past[0, -1] - messages.HISTORY_S][:, -MOST_KEPT:]
        return _in_messages(first, start_s, columns)

    def take_felt(self) -> bool:
        """Return whether a force was felt in the ticks since the last call."""
        felt, self._felt = self._felt, False
        return felt

    def felt(self, law: WeberLaw) -> FeltReport | None:
        """Return how far the held is from the true force in the newest `messages.HISTORY_S`; None if unknown."""
        _, true, held = self._past
        known = np.isfinite(true)
        return error_report(law, true[known, None], held[known, None]) if known.any() else None


def _in_messages(first: int, start_s: float, columns: FloatArray) -> list[bytes]:
    """Return columns of any length as messages of at most `messages.MOST_ROWS` rows."""
    made = []
    for begin in range(0, columns.shape[1], messages.MOST_ROWS):
        part = columns[:, begin : begin + messages.MOST_ROWS].copy()
        offset_s = float(part[0, 0])
        part[0] -= offset_s
        made.append(messages.samples(first + begin, start_s + offset_s, part))
    return made
