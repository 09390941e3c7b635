"""What a run cost and did: bytes per penetration, and what was felt beside what was true."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.measure.metrics import ErrorReport, error_report
from hapticnet.perception import WeberLaw
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES

Columns = Mapping[str, FloatArray]
"""A recording: columns by name, shape (n,) each; see `node.recording`."""

STAMP_MODULUS: Final = 1 << 32
"""Time stamps cross the wire modulo 2³² µs, so that is how the two sides' recordings are matched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BytesPerPenetration:
    """Feedback bytes between touching a tissue and breaching it: keepalives, UDP and IPv4 headers included.

    Attributes
    ----------
    each
        Bytes of each penetration, in order of time.
    mean, deviation
        Their mean and standard deviation [B]; 0 where there is none.
    """

    each: tuple[int, ...]
    mean: float
    deviation: float


def bytes_per_penetration(slave: Columns) -> BytesPerPenetration:
    """Return the cost of every penetration in a slave's recording.

    A penetration begins after the last sample without force, or after the breach before, and ends with the breach.
    """
    datagrams = slave["datagram_bytes"]
    wire = np.where(datagrams > 0, datagrams + UDP_IPV4_HEADER_BYTES, 0.0)
    spent = np.concatenate([[0.0], np.cumsum(wire)])
    breaches = np.flatnonzero(np.diff(slave["breaches"], prepend=0.0) > 0)
    free = np.flatnonzero(slave["force_n"] <= 0.0)
    each = []
    begin = 0
    for end in breaches:
        before = free[free < end]
        if len(before):
            begin = max(begin, int(before[-1]) + 1)
        each.append(int(spent[end + 1] - spent[begin]))
        begin = int(end) + 1
    return BytesPerPenetration(
        each=tuple(each),
        mean=float(np.mean(each)) if each else 0.0,
        deviation=float(np.std(each, ddof=1)) if len(each) > 1 else 0.0,
    )


def felt_error(law: WeberLaw, slave: Columns, master: Columns) -> ErrorReport:
    """Compare the force held at each tick with the true force at the position sent in that very tick.

    Unlike the codec's own error this includes the way there and back, and every packet that was lost or late.
    """
    true, held = matched(slave, master)
    return error_report(law, true[:, np.newaxis], held[:, np.newaxis])


def matched(slave: Columns, master: Columns) -> tuple[FloatArray, FloatArray]:
    """Return true force and held force [N] at the times both sides recorded, shape (n,) each."""
    _, at_slave, at_master = np.intersect1d(_stamps(slave), _stamps(master), return_indices=True)
    return slave["force_n"][at_slave], master["held_n"][at_master]


def _stamps(columns: Columns) -> npt.NDArray[np.int64]:
    stamps: npt.NDArray[np.int64] = columns["t_us"].astype(np.int64) % STAMP_MODULUS
    return stamps
