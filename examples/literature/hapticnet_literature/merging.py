"""The deadband with a bounded packet rate.

The deadband bounds the average rate only: at an impact every sample may leave the dead zone. After the merging of
samples in Gokhale, Nair, Chaudhuri's congestion control for telehaptics (dynamic packetization module, arXiv
1610.00609) and its successor for adaptive sampling (NaPAS, EuroHaptics 2018). Those carry all merged samples in one
packet and adapt to the network. This codec is for a receiver that holds, which needs only the newest sample, and its
window is fixed.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.deadband import DeadZone, ValueScheme, emptied, empty_zone
from hapticnet.codec.schemes.deadband import is_silent as is_in_dead_zone
from hapticnet.codec.schemes.deadband import send as send_value
from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Steps
from hapticnet.codec.values import check_step, law_numbers, value_bytes
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import in_range


class MergingRule(NamedTuple):
    """The numbers of the rule."""

    weber: float
    floor: float
    step: float
    window_us: float


class Window(NamedTuple):
    """State of the sender: the dead zone, the time of the last transmission [µs], and whether there was one."""

    zone: DeadZone
    sent_us: int
    is_open: bool


def start(rule: Any, axes: int) -> Window:
    """Return a dead zone that contains nothing, outside any window."""
    return Window(empty_zone(rule, axes), 0, False)


def is_silent(rule: MergingRule, window: Window, t_us: int, x: Vector) -> bool:
    """Tell whether a sample is inside the window or the dead zone."""
    if window.is_open and 0 <= t_us - window.sent_us < rule.window_us:
        return in_range(x)
    return is_in_dead_zone(rule, window.zone, t_us, x)


def send(rule: MergingRule, window: Window, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], Window]:
    """Send the stimulus and open a window."""
    message, zone = send_value(rule, window.zone, t_us, x, past)
    return message, Window(zone, t_us, True)


def mirror(window: Window) -> Vector:
    """Return what the receiver holds."""
    return window.zone.reference


def refreshed(window: Window) -> Window:
    """Return a dead zone that contains nothing, outside any window."""
    return Window(emptied(window.zone), 0, False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Merging(ValueScheme):
    """Transmit what leaves the dead zone, but at most once in a window.

    Rule: the deadband's, except that nothing is sent until `window_ms` after the last transmission. The first sample
    at or after the end of the window is compared with the dead zone as usual; a stimulus that left the dead zone and
    came back meanwhile is not sent. So a change after a pause is sent at once, and no window of `window_ms` holds more
    than one packet, plus those that a repair asks for (`refresh` overrides the window) and those after a time stamp
    that goes back. While the clock does not advance, a window does not end.

    Within a window the error may exceed the JND, by design: the rule bounds how long a stimulus is outside the dead
    zone, not how far. Payload: the deadband's.

    Attributes
    ----------
    window_ms
        Shortest time between two transmissions [ms]; 0: the deadband. The default, at most 100 packets a second, is
        an assumption; set it to what the network can carry.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold; 0: never.
    """

    name: ClassVar[str] = "merging"
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        mirror=mirror,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    window_ms: float = 10.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("window_ms", self.window_ms, 0.0, 1e4)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> MergingRule:  # noqa: ARG002
        """Return law, step of counts and window."""
        return MergingRule(*law_numbers(self.law), self.step_n, self.window_ms * 1e3)
