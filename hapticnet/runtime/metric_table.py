"""The metrics: their names, kinds and meanings, for the node's process and for the one that serves them."""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

Kind: TypeAlias = Literal["counter", "gauge", "histogram"]

EDGES_S: Final = (
    0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0,
)  # fmt: skip
"""Upper edges [s] of the buckets of histograms; the 1 ms of a tick is one of them."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric, without the prefix ``hapticnet_``.

    Attributes
    ----------
    labels
        Names of its labels.
    """

    name: str
    kind: Kind
    meaning: str
    labels: tuple[str, ...] = ()


COMMON: Final = (
    Metric("datagrams", "counter", "Datagrams sent to and received from peers.", ("direction",)),
    Metric("wire_bytes", "counter", "Bytes of these datagrams with UDP and IPv4 headers.", ("direction",)),
    Metric("forces", "counter", "Force updates sent (slave) or received (master).", ("direction",)),
    Metric("datagrams_lost", "counter", "Datagrams of peers that did not arrive."),
    Metric("datagrams_dropped", "counter", "Datagrams that arrived and were not used.", ("reason",)),
    Metric("queue_age_seconds", "histogram", "Time from arrival at this machine until a datagram is read."),
    Metric("step_seconds", "histogram", "Time of a step of scene, operator, device or a user's codec."),
    Metric("kernel_drops", "counter", "Datagrams that the system dropped because they were not read in time."),
    Metric("events", "counter", "Events of the node, by name.", ("event",)),
    Metric("log_lines_left_out", "counter", "Lines that were not written to stderr."),
    Metric("realtime", "gauge", "1 under real-time scheduling (SCHED_FIFO), else 0."),
)

MASTER: Final = (
    *COMMON,
    Metric("ticks", "counter", "Ticks of the master."),
    Metric("ticks_missed", "counter", "Ticks skipped because the next was already due."),
    Metric("tick_lateness_seconds", "histogram", "Delay from when a tick was due to its start."),
    Metric("round_trip_seconds", "histogram", "Time from a position to its answer."),
    Metric("force_age_seconds", "histogram", "Age of the force that is applied."),
    Metric("connected", "gauge", "1 in a session, else 0."),
    Metric("connections", "counter", "Sessions so far."),
    Metric("paused", "gauge", "1 while the operator is not asked because it failed, else 0."),
    Metric("held_force_newtons", "gauge", "Norm of the force that is held, at this moment."),
    Metric("target_force_newtons", "gauge", "Force requested of the device, at this moment."),
    Metric("sensed_force_newtons", "gauge", "Force sensed by the device, at this moment."),
    Metric("displacement_meters", "gauge", "Displacement of the device's platform, at this moment."),
)

SLAVE: Final = (
    *COMMON,
    Metric("sessions", "gauge", "Sessions at this moment."),
    Metric("steps", "counter", "Positions answered."),
    Metric("draining", "gauge", "1 while new masters are refused because the slave is to stop, else 0."),
    Metric("strangers_datagrams", "counter", "Datagrams of no session.", ("direction",)),
    Metric("throttled", "counter", "Requests for a session that were not read because there were too many."),
)

TABLES: Final = {"master": MASTER, "slave": SLAVE}
