"""Cost and effect of a codec on a recording, computed without a network."""

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray, IntArray
from hapticnet.codec.base import Codec, Encoding
from hapticnet.measure.metrics import FeltReport, error_report, worst_window_packets
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import MODULUS, UDP_IPV4_HEADER_BYTES


@dataclass(frozen=True, slots=True, kw_only=True)
class CostReport(FeltReport):
    """Cost and error of a codec on one recording: the fields of `FeltReport`, and those below."""

    samples: int  # of the recording, and transmitted
    sent: int
    packet_rate_reduction: float  # ``1 - sent / samples``
    payload_bytes: int  # of FORCE datagrams; the same with 28 B of UDP and IPv4 headers each
    wire_bytes: int
    keepalives: int  # that the slave would send; wire bytes with them
    session_wire_bytes: int
    wire_byte_reduction: float  # ``1 - wire_bytes / (wire bytes when every sample is sent raw)``
    worst_100ms_packets: int  # most packets in any 100 ms


def cost_report(codec: Codec, t_us: IntArray, stimuli: FloatArray, encoding: Encoding) -> CostReport:
    """Return cost and effect of an encoding of a recording of shape (n, a)."""
    samples, axes = stimuli.shape
    sent_us = t_us[encoding.sent]
    payload_bytes = _datagram_bytes(sent_us, encoding.payload_bytes)
    wire_bytes = payload_bytes + len(sent_us) * UDP_IPV4_HEADER_BYTES
    raw_bytes = _datagram_bytes(t_us, np.full(samples, 4 * axes, dtype=np.uint16)) + samples * UDP_IPV4_HEADER_BYTES
    kept_us = keepalive_times(t_us, sent_us)
    session_bytes = _session_bytes(sent_us, encoding.payload_bytes, kept_us)
    return CostReport(
        samples=samples,
        sent=len(sent_us),
        packet_rate_reduction=1.0 - len(sent_us) / samples if samples else 0.0,
        payload_bytes=payload_bytes,
        wire_bytes=wire_bytes,
        keepalives=len(kept_us),
        session_wire_bytes=session_bytes + (len(sent_us) + len(kept_us)) * UDP_IPV4_HEADER_BYTES,
        wire_byte_reduction=1.0 - wire_bytes / raw_bytes if raw_bytes else 0.0,
        **asdict(error_report(codec.law, stimuli, encoding.decoded)),
        worst_100ms_packets=worst_window_packets(sent_us),
    )


def keepalive_times(t_us: IntArray, sent_us: IntArray) -> IntArray:
    """Return the times of a slave's KEEPALIVEs: the first sample one interval after the last datagram."""
    if not len(t_us):
        return np.empty(0, dtype=np.int64)
    interval_us = SessionSettings().keepalive_us
    bounds_us = np.concatenate([t_us[:1], sent_us, t_us[-1:] + 1])
    kept = []
    for quiet in np.flatnonzero(np.diff(bounds_us) > interval_us).tolist():
        at_us, end_us = int(bounds_us[quiet]), int(bounds_us[quiet + 1])
        while (index := int(np.searchsorted(t_us, at_us + interval_us))) < len(t_us) and t_us[index] < end_us:
            at_us = int(t_us[index])
            kept.append(at_us)
    return np.array(kept, dtype=np.int64)


def _session_bytes(sent_us: IntArray, payload_bytes: npt.NDArray[np.uint16], kept_us: IntArray) -> int:
    """Return the bytes of forces and keepalives, which share one sequence."""
    order = np.argsort(np.concatenate([sent_us, kept_us]), kind="stable")
    sequence = np.empty(len(order), dtype=np.int64)
    sequence[order] = np.arange(1, len(order) + 1)
    forces, keepalives = sequence[: len(sent_us)], sequence[len(sent_us) :]
    newest = np.concatenate([[0], forces])[np.searchsorted(sent_us, kept_us, side="right")]
    size = force_datagram_bytes(forces, sent_us, payload_bytes).sum()
    return int(size + keepalive_datagram_bytes(keepalives, kept_us, newest).sum())


def _datagram_bytes(t_us: IntArray, payload_bytes: npt.NDArray[np.uint16]) -> int:
    # A session's sequence numbers begin with the WELCOME, which takes 0.
    sequence = np.arange(1, len(t_us) + 1, dtype=np.int64)
    return int(force_datagram_bytes(sequence, t_us, payload_bytes).sum())


def force_datagram_bytes(sequence: IntArray, t_us: IntArray, payload_bytes: npt.NDArray[np.uint16]) -> IntArray:
    """Return the size [B] of FORCE datagrams, without UDP and IP headers, shapes (m,).

    The arithmetic of msgpack: one byte for each array head, version and kind, five for a session, two for each byte
    string's head, and one to five for an unsigned integer by its size.
    """
    return 13 + _uint_bytes(sequence) + _uint_bytes(t_us) + payload_bytes


def keepalive_datagram_bytes(sequence: IntArray, t_us: IntArray, newest_force: IntArray) -> IntArray:
    """Return the size [B] of KEEPALIVE datagrams, without UDP and IP headers, shapes (m,)."""
    return 11 + _uint_bytes(sequence) + _uint_bytes(t_us) + _uint_bytes(newest_force)


def _uint_bytes(values: IntArray) -> IntArray:
    sizes = np.array([1, 2, 3, 5], dtype=np.int64)
    return sizes[np.searchsorted([1 << 7, 1 << 8, 1 << 16], values % MODULUS, side="right")]
