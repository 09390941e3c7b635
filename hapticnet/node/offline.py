"""What a codec would cost and do on a recording: codec and protocol without a network."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticnet.arrays import FloatArray
from hapticnet.codec.base import Codec, Encoding
from hapticnet.measure.metrics import error_report, worst_window_packets
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.wire import UDP_IPV4_HEADER_BYTES, force_datagram_bytes, keepalive_datagram_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class CostReport:
    """Cost and effect of a codec on one recording.

    Attributes
    ----------
    samples, sent
        Samples of the recording, and how many of them are transmitted.
    packet_rate_reduction
        ``1 - sent / samples``.
    payload_bytes, wire_bytes
        Bytes of the FORCE datagrams, as they would be in a session; with 28 B of UDP and IPv4 headers each.
    keepalives, session_wire_bytes
        How often the slave would say that nothing has changed, and all its bytes with these.
    wire_byte_reduction
        ``1 - wire_bytes / (wire bytes when every sample is sent raw)``.
    rmse_n, max_error_n, exceed_jnd_fraction
        See `measure.metrics.ErrorReport`.
    worst_100ms_packets
        Most packets in any 100 ms.
    """

    samples: int
    sent: int
    packet_rate_reduction: float
    payload_bytes: int
    wire_bytes: int
    keepalives: int
    session_wire_bytes: int
    wire_byte_reduction: float
    rmse_n: float
    max_error_n: float
    exceed_jnd_fraction: float
    worst_100ms_packets: int


def cost_report(codec: Codec, t_us: npt.NDArray[np.int64], stimuli: FloatArray, encoding: Encoding) -> CostReport:
    """Return what `encoding` of a recording of shape (n, a) costs and does."""
    samples, axes = stimuli.shape
    sent_us = t_us[encoding.sent]
    payload_bytes = _datagram_bytes(sent_us, encoding.payload_bytes)
    wire_bytes = payload_bytes + len(sent_us) * UDP_IPV4_HEADER_BYTES
    raw_bytes = _datagram_bytes(t_us, np.full(samples, 4 * axes, dtype=np.uint16)) + samples * UDP_IPV4_HEADER_BYTES
    kept_us = keepalive_times(t_us, sent_us)
    session_bytes = _session_bytes(sent_us, encoding.payload_bytes, kept_us)
    error = error_report(codec.law, stimuli, encoding.decoded)
    return CostReport(
        samples=samples,
        sent=len(sent_us),
        packet_rate_reduction=1.0 - len(sent_us) / samples if samples else 0.0,
        payload_bytes=payload_bytes,
        wire_bytes=wire_bytes,
        keepalives=len(kept_us),
        session_wire_bytes=session_bytes + (len(sent_us) + len(kept_us)) * UDP_IPV4_HEADER_BYTES,
        wire_byte_reduction=1.0 - wire_bytes / raw_bytes if raw_bytes else 0.0,
        rmse_n=error.rmse_n,
        max_error_n=error.max_error_n,
        exceed_jnd_fraction=error.exceed_jnd_fraction,
        worst_100ms_packets=worst_window_packets(sent_us),
    )


def keepalive_times(t_us: npt.NDArray[np.int64], sent_us: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return when a slave says that nothing has changed: the first sample an interval after it said anything."""
    if not len(t_us):
        return np.empty(0, dtype=np.int64)
    interval_us = SessionSettings().keepalive_us
    said_us = np.concatenate([t_us[:1], sent_us, t_us[-1:] + 1])
    kept = []
    for quiet in np.flatnonzero(np.diff(said_us) > interval_us).tolist():
        at_us, end_us = int(said_us[quiet]), int(said_us[quiet + 1])
        while (index := int(np.searchsorted(t_us, at_us + interval_us))) < len(t_us) and t_us[index] < end_us:
            at_us = int(t_us[index])
            kept.append(at_us)
    return np.array(kept, dtype=np.int64)


def _session_bytes(
    sent_us: npt.NDArray[np.int64], payload_bytes: npt.NDArray[np.uint16], kept_us: npt.NDArray[np.int64]
) -> int:
    """Return the bytes of forces and keepalives, which share one sequence."""
    order = np.argsort(np.concatenate([sent_us, kept_us]), kind="stable")
    sequence = np.empty(len(order), dtype=np.int64)
    sequence[order] = np.arange(1, len(order) + 1)
    forces, keepalives = sequence[: len(sent_us)], sequence[len(sent_us) :]
    newest = np.concatenate([[0], forces])[np.searchsorted(sent_us, kept_us, side="right")]
    size = force_datagram_bytes(forces, sent_us, payload_bytes).sum()
    return int(size + keepalive_datagram_bytes(keepalives, kept_us, newest).sum())


def _datagram_bytes(t_us: npt.NDArray[np.int64], payload_bytes: npt.NDArray[np.uint16]) -> int:
    # A session's sequence numbers begin with the WELCOME, which takes 0.
    sequence = np.arange(1, len(t_us) + 1, dtype=np.int64)
    return int(force_datagram_bytes(sequence, t_us, payload_bytes).sum())
