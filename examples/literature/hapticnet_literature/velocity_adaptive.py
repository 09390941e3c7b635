"""The deadband that widens while the hand moves.

The force JND grows with the speed of the hand, and a deadband may follow it: Zadeh 2008;
Kammerl, Vittorias, Nitsch, Faerber, Steinbach, Hirche, "Perception-based data reduction for haptic force-feedback
signals using velocity-adaptive deadbands", Presence 19(5), 2010, 450-462, which reports reductions of up to 96 %.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.deadband import ValueScheme
from hapticnet.codec.schemes.motion import Motion, moved_on, unknown_motion
from hapticnet.codec.steps import ZERO_ORDER_HOLD, MakeTable, Steps
from hapticnet.codec.values import check_step, law_numbers, rounded, value_bytes
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance, magnitude


class SpeedRule(NamedTuple):
    """The numbers of the rule."""

    weber: float
    floor: float
    step: float
    gain_s_m: float
    largest: float
    time_constant_s: float


class Sender(NamedTuple):
    """What the receiver holds, its norm `size`, the motion of the hand, and its speed [m/s]."""

    is_held: bool
    reference: Vector
    size: float
    motion: Motion
    speed_m_s: float


def start(rule: Any, axes: int) -> Sender:
    """Return a hand at rest, and no reference."""
    zeros = (0.0,) * axes
    return Sender(False, zeros, 0.0, unknown_motion(axes), 0.0)


def watch(rule: SpeedRule, sender: Sender, t_us: int, position: Vector) -> Sender:
    """Follow the hand to its position."""
    is_held, reference, size, motion, _ = sender
    motion = moved_on(motion, t_us, position, rule.time_constant_s)
    return Sender(is_held, reference, size, motion, magnitude(motion[4]))


def at_rest(sender: Sender) -> Sender:
    """Return a hand whose position is not known, so that it counts as at rest."""
    return sender._replace(speed_m_s=0.0)


def is_silent(rule: SpeedRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Tell whether a stimulus is inside the dead zone at the present speed."""
    if not sender.is_held:
        return False
    fraction = rule.weber + rule.gain_s_m * sender.speed_m_s
    threshold = (fraction if fraction < rule.largest else rule.largest) * sender.size
    return distance(x, sender.reference) <= (threshold if threshold > rule.floor else rule.floor)


def send(rule: SpeedRule, sender: Sender, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector], Sender]:
    """Send the stimulus."""
    form, reference, _ = rounded(rule, x)
    return (form, reference), Sender(True, reference, magnitude(reference), sender.motion, sender.speed_m_s)


def mirror(sender: Sender) -> Vector:
    """Return what the receiver holds."""
    return sender.reference


def refreshed(sender: Sender) -> Sender:
    """Forget what the receiver holds."""
    return sender._replace(is_held=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityAdaptive(ValueScheme):
    """Transmit a stimulus only when the hand, at its present speed, can tell it apart from the one being held.

    Rule: send when ``|x - ref| > multiplier · max(fraction · |ref|, floor_n)``, strictly, with `ref` the last
    transmitted stimulus as it was rounded for the wire, and
    ``fraction = max(weber_fraction, min(weber_fraction + speed_gain_s_m · |v|, largest_fraction))``.
    The threshold depends on the present speed: when the hand slows down, the deadband narrows, so a stimulus that does
    not change may leave it. The receiver holds and does not know the speed.

    Speed: with each position p, ``v ← (τ·v + p - p_before) / (τ + dt)``, the low-passed difference quotient (backward
    Euler of ``τ·dv/dt = dp/dt - v``), per axis; |v| is its norm, so that jitter cancels instead of adding up. A
    repeated time stamp is ignored; after one that goes back, the hand counts as at rest.

    At rest, and if positions are not known, it is the deadband. In motion the error exceeds the JND *at rest* on
    purpose, but not the threshold above. Payload: the deadband's.

    Attributes
    ----------
    speed_gain_s_m
        Growth of the Weber fraction with speed [1 per m/s]. The linear form is after Kammerl 2010; the default is an
        assumption (0.1 m/s doubles the paper's fraction of 0.05); replace it by a measurement of the person.
    largest_fraction
        Largest fraction, 0 to 1. Also an assumption: the growth was not measured further.
    time_constant_ms
        τ of the speed's low-pass [ms]; 0: the bare difference quotient.
    step_n
        Payload of int16 multiples of this [N] where that moves the stimulus by no more than the threshold at rest; 0:
        never.
    """

    name: ClassVar[str] = "velocity-adaptive"
    needs_position: ClassVar[bool] = True
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        mirror=mirror,
        watch=watch,
        at_rest=at_rest,
        payload_bytes=value_bytes,
        **ZERO_ORDER_HOLD,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    speed_gain_s_m: float = 0.5
    largest_fraction: float = 0.25
    time_constant_ms: float = 10.0
    step_n: float = 0.0

    def __post_init__(self) -> None:
        check_parameter("speed_gain_s_m", self.speed_gain_s_m, 0.0, 1e3)
        check_parameter("largest_fraction", self.largest_fraction, 0.0, 1.0)
        check_parameter("time_constant_ms", self.time_constant_ms, 0.0, 1e4)
        check_step(self.step_n)

    def rule(self, axes: int, table: MakeTable) -> SpeedRule:  # noqa: ARG002
        """Return law, step of counts, and how the fraction follows the speed."""
        multiplier = self.law.multiplier
        weber, floor = law_numbers(self.law)
        largest = max(multiplier * self.largest_fraction, weber)
        gain_s_m, time_constant_s = multiplier * self.speed_gain_s_m, self.time_constant_ms * 1e-3
        return SpeedRule(weber, floor, self.step_n, gain_s_m, largest, time_constant_s)
