"""Settings of one direction of an emulated network."""

from dataclasses import dataclass
from typing import Final

from hapticnet.channel.jitter import Jitter
from hapticnet.channel.loss import Loss
from hapticnet.channel.quantities import (
    FASTEST_BIT_PER_S,
    LONGEST_US,
    format_rate,
    format_share,
    format_time,
)
from hapticnet.checks import check_parameter

DEFAULT_HOLD_BACK_US: Final = 10_000
"""Time [µs] a reordered packet is held back: ten packets of a 1 kHz stream overtake it."""

DEFAULT_QUEUE_US: Final = 100_000
"""Longest time [µs] a packet waits for the bottleneck."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelSettings:
    """Effects of one direction of a network; none by default.

    The effects apply in this order: loss, duplication, bottleneck, delay with jitter and reordering. A lost packet is
    not duplicated. A duplicate follows its original through the bottleneck, like a retransmission after a lost
    acknowledgement, so the output never exceeds the rate.

    Packets keep their order, with two exceptions: `reorder_probability` holds back single packets while later ones
    overtake, and a jitter with ``keeps_order=False`` reorders all.

    Attributes
    ----------
    delay_us
        Shortest time [µs] from sending to delivery.
    jitter
        Random delay added to it.
    loss
        Loss model.
    reorder_probability
        Probability that a packet is held back, 0 to 1.
    hold_back_us
        Additional delay [µs] of a packet that is held back.
    duplicate_probability
        Probability that a packet arrives twice, 0 to 1.
    rate_bit_per_s
        Rate of the bottleneck [bit/s], counting UDP and IPv4 headers; None: no bottleneck.
    queue_us
        Longest time [µs] a packet waits for the bottleneck; one that would wait longer is dropped. The limit is a time
        because time is what a queue costs a haptic loop, at any packet size and rate.

    Raises
    ------
    SettingsError
        If a value is out of range.
    """

    delay_us: int = 0
    jitter: Jitter | None = None
    loss: Loss | None = None
    reorder_probability: float = 0.0
    hold_back_us: int = DEFAULT_HOLD_BACK_US
    duplicate_probability: float = 0.0
    rate_bit_per_s: int | None = None
    queue_us: int = DEFAULT_QUEUE_US

    def __post_init__(self) -> None:
        rate = FASTEST_BIT_PER_S if self.rate_bit_per_s is None else self.rate_bit_per_s
        check_parameter("channel delay_us", self.delay_us, 0, LONGEST_US)
        check_parameter("channel reorder_probability", self.reorder_probability, 0, 1)
        check_parameter("channel hold_back_us", self.hold_back_us, 1, LONGEST_US)
        check_parameter("channel duplicate_probability", self.duplicate_probability, 0, 1)
        check_parameter("channel rate_bit_per_s", rate, 1, FASTEST_BIT_PER_S)
        check_parameter("channel queue_us", self.queue_us, 1, LONGEST_US)

    @property
    def is_perfect(self) -> bool:
        """Whether every packet is delivered once, in order, at the time it is sent."""
        return (
            self.delay_us == 0
            and (self.jitter is None or self.jitter.deviation_us == 0)
            and (self.loss is None or self.loss.mean == 0.0)
            and self.reorder_probability == 0.0
            and self.duplicate_probability == 0.0
            and self.rate_bit_per_s is None
        )

    def describe(self) -> str:
        """Return the settings as one line that `parse_channel` can read."""
        parts = []
        if self.delay_us:
            parts.append(f"delay={format_time(self.delay_us)}")
        if self.jitter is not None:
            parts.append(f"jitter={self.jitter.describe()}")
            if not self.jitter.keeps_order:
                parts.append("order=free")
        if self.loss is not None:
            parts.append(f"loss={self.loss.describe()}")
        if self.reorder_probability or self.hold_back_us != DEFAULT_HOLD_BACK_US:
            hold_back = format_time(self.hold_back_us)
            parts.append(f"reorder={format_share(self.reorder_probability)}:{hold_back}")
        if self.duplicate_probability:
            parts.append(f"duplicate={format_share(self.duplicate_probability)}")
        if self.rate_bit_per_s is not None:
            parts.append(f"rate={format_rate(self.rate_bit_per_s)}")
        if self.queue_us != DEFAULT_QUEUE_US:
            parts.append(f"queue={format_time(self.queue_us)}")
        return ",".join(parts) or "perfect"
