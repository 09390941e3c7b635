"""The motion-predictive deadband: transmit how the stimulus follows time and the receiver's own position.

Our own codec (docs/adr/0011). In contact, force follows position far more than time, and the receiver knows its own
position without delay. This is a local contact model, as in model-mediated teleoperation (Hannaford 1989; Mitra &
Niemeyer 2008), sent under a perceptual deadband.

Four predictors run at the sender, each as if it were a codec of its own: the zero-order hold, the curve of
`adaptive_predictive`, a surface with the stiffness of the last milliseconds, and a coupling of learned stiffness and
viscosity with a curve for what they leave. When something must be sent, the predictor that has needed the fewest
packets of late sends it. So the codec needs about as few packets as the best of the four.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.motion import Motion, moved_on, unknown_motion, unseen
from hapticnet.codec.payload.motion import (
    LARGEST_STIFFNESS,
    Line,
    Message,
    MotionForm,
    line_at,
    line_of,
    message_bytes,
    no_line,
)
from hapticnet.codec.payload.values import law_numbers, threshold_around
from hapticnet.codec.schemes.contact import Coupling, no_coupling, observed
from hapticnet.codec.schemes.predictors import (
    KEPT,
    MotionRule,
    Predictor,
    drawn_curve,
    drawn_hold,
    drawn_surface,
    follows,
    redrawn,
    remember,
    trend_beside,
    usable,
)
from hapticnet.codec.schemes.trend import MOST_SAMPLES, NOTHING_LEARNED, Trend
from hapticnet.codec.steps import MakeTable, Scheme, Steps
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector

VELOCITY_LAG_S: Final = 0.005
"""Time constant of the velocity's low-pass [s]: five samples at 1 kHz, in which a hand hardly changes its speed."""

TESTED_EVERY: Final = 2
"""Predictors are tested at every second sample, which is enough to compare them, and costs half."""

FORGETTING: Final = 0.98
"""Factor on the packets counted so far at each packet sent: about twenty are remembered."""


class Sender(NamedTuple):
    """What the receiver follows, and the predictors.

    Attributes
    ----------
    is_known
        Whether the receiver is known to follow `line`; False after a loss.
    newest
        Index of the newest sample in the rule's tables.
    packets
        Packets that surface, coupling, curve and hold have needed of late.
    """

    is_known: bool
    motion: Motion
    line: Line
    newest: int
    hold: Line
    surface: Line
    curve: Predictor
    coupled: Predictor
    coupling: Coupling
    packets: tuple[float, float, float, float]


class Receiver(NamedTuple):
    """The receiver's own motion, and what it follows."""

    motion: Motion
    line: Line


def start(rule: Any, axes: int) -> Sender:
    """Return a sender that has learned nothing."""
    zeros, none = (0.0,) * axes, no_line(axes)
    predictor = Predictor(none, zeros, zeros, zeros, Trend(zeros, zeros, zeros), NOTHING_LEARNED)
    packets = 0.0, 0.0, 0.0, 0.0
    return Sender(False, unknown_motion(axes), none, -1, none, none, predictor, predictor, no_coupling(axes), packets)


def start_receiver(rule: Any, axes: int) -> Receiver:
    """Return a receiver that applies zeros."""
    return Receiver(unknown_motion(axes), no_line(axes))


def watch(rule: Any, sender: Sender, t_us: int, position: Vector) -> Sender:
    """Follow the tool to its position."""
    return with_motion(sender, moved_on(sender.motion, t_us, position, VELOCITY_LAG_S))


def with_motion(sender: Sender, motion: Motion) -> Sender:
    """Return the sender with another motion."""
    known, _, line, newest, hold, surface, curve, coupled, coupling, packets = sender
    return Sender(known, motion, line, newest, hold, surface, curve, coupled, coupling, packets)


def at_rest(sender: Sender) -> Sender:
    """Take note that the position of this sample is not known."""
    return with_motion(sender, unseen(sender.motion))


def move(rule: Any, receiver: Receiver, t_us: int, position: Vector) -> Receiver:
    """Follow the receiver's own position."""
    return Receiver(moved_on(receiver.motion, t_us, position, VELOCITY_LAG_S), receiver.line)


def learn(rule: MotionRule, sender: Sender, t_us: int, x: Vector) -> Sender:
    """Let each predictor go on as if it were alone, and count its packets."""
    known, motion, line, newest, hold, surface, curve, coupled, coupling, packets = sender
    newest = remember(rule, newest, t_us, x, motion)
    if newest % TESTED_EVERY:
        return Sender(known, motion, line, newest, hold, surface, curve, coupled, coupling, packets)
    coupling = observed(coupling, motion, t_us, x, threshold_around(rule, x))
    of_surface, of_coupled, of_curve, of_hold = packets
    if not follows(rule, hold, motion, t_us, x):
        hold = line_of(rule, t_us, drawn_hold(rule, motion, x, x))
        of_hold += 1.0
    if not follows(rule, surface, motion, t_us, x):
        surface = line_of(rule, t_us, drawn_surface(rule, motion, newest, x, coupling.stiffness))
        of_surface += 1.0
    if not follows(rule, curve.line, motion, t_us, x):
        curve = redrawn(rule, curve, motion, newest, t_us, x, 0.0, 0.0)
        of_curve += 1.0
    if not follows(rule, coupled.line, motion, t_us, x):
        stiffness, viscosity = usable(rule, coupling, motion)
        coupled = redrawn(rule, coupled, motion, newest, t_us, x, stiffness, viscosity)
        of_coupled += 1.0
    packets = of_surface, of_coupled, of_curve, of_hold
    return Sender(known, motion, line, newest, hold, surface, curve, coupled, coupling, packets)


def is_silent(rule: MotionRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Tell whether a stimulus is within the threshold around what the receiver applies."""
    return sender.is_known and follows(rule, sender.line, sender.motion, t_us, x)


def send(rule: MotionRule, sender: Sender, t_us: int, x: Vector, past: Any) -> tuple[Message, Sender]:
    """Send what the predictor draws that has needed the fewest packets."""
    _, motion, _, newest, hold, surface, curve, coupled, coupling, packets = sender
    of_surface, of_coupled, of_curve, of_hold = packets
    fewest = min(of_surface, of_coupled, of_curve, of_hold)
    if of_surface == fewest:
        message = drawn_surface(rule, motion, newest, x, coupling.stiffness)
    elif of_coupled == fewest:
        stiffness, viscosity = usable(rule, coupling, motion)
        trend = trend_beside(rule, motion, newest, x, stiffness, viscosity)
        message = drawn_curve(rule, coupled.regression, trend, motion, x, stiffness, viscosity)
    elif of_curve == fewest:
        trend = trend_beside(rule, motion, newest, x, 0.0, 0.0)
        message = drawn_curve(rule, curve.regression, trend, motion, x, 0.0, 0.0)
    else:
        # A value that is still good is better than that of a sample which must be sent: an outlier, if there is noise.
        value = hold.offset if follows(rule, hold, motion, t_us, x) else x
        message = drawn_hold(rule, motion, value, x)
    packets = FORGETTING * of_surface, FORGETTING * of_coupled, FORGETTING * of_curve, FORGETTING * of_hold
    line = line_of(rule, t_us, message)
    return message, Sender(True, motion, line, newest, hold, surface, curve, coupled, coupling, packets)


def refreshed(sender: Sender) -> Sender:
    """Return a receiver that is not known to follow the line."""
    return sender._replace(is_known=False)


def mirror(sender: Sender) -> Receiver:
    """Return the receiver, if it knows the same positions."""
    return Receiver(sender.motion, sender.line)


def receive(rule: MotionRule, receiver: Receiver, t_us: int, message: Message) -> Receiver:
    """Follow the line of a message."""
    return Receiver(receiver.motion, line_of(rule, t_us, message))


def apply(rule: MotionRule, receiver: Receiver, t_us: int) -> Vector:
    """Return the stimulus of the line at the receiver's position."""
    return line_at(rule, receiver.line, receiver.motion, t_us)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPredictive(Scheme):
    """Transmit how the stimulus follows time and the receiver's own position, as far as either has foretold it.

    Rule: send when ``|x - p| > threshold(|p|)``, strictly, where p is what the receiver applies at its position and
    velocity. The first stimulus is always sent. A payload is complete and one of four: hold a value; a curve in time;
    a surface, ``offset + κ (κ·position)``, which does not pull; or a coupling, ``offset + K·position + B·velocity``
    and a curve in time (`payload.motion`). The sender runs a predictor for each as if it were a codec of its own, and
    sends with the one that has needed the fewest packets of late.

    Velocity: as in `codec.motion`, with a time constant of 5 ms, from the positions that each side knows. The rule
    takes the sender's for the receiver's. A receiver that is elsewhere, because the network is slow or positions are
    coded, applies what holds at its own position. Without positions, it is the better of `adaptive_predictive` and the
    deadband.

    Without loss and delay the applied stimulus is within the threshold of the true one at every sample, whatever the
    input. While an update is late or lost, the receiver follows the line; stiffness and viscosity are bounded, and a
    curve ends at its horizon.

    Attributes
    ----------
    horizon_ms
        Time in which the slope of a curve falls to zero [ms]: 1 to 10 000.
    window_ms
        Window of the slopes in time [ms]: 1 to 1000, as in adaptive-predictive.
    stiffest_n_per_m
        Largest stiffness that is transmitted [N/m]: 1 to 60 000. It bounds the effect of a late update: a hand that has
        moved by d since may feel that much times d too much.
    """

    name: ClassVar[str] = "motion-predictive"
    needs_position: ClassVar[bool] = True
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        start_receiver=start_receiver,
        receive=receive,
        mirror=mirror,
        apply=apply,
        watch=watch,
        at_rest=at_rest,
        move=move,
        learn=learn,
        payload_bytes=message_bytes,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    horizon_ms: float = 200.0
    window_ms: float = 17.0
    stiffest_n_per_m: float = 10_000.0

    def __post_init__(self) -> None:
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("window_ms", self.window_ms, 1.0, 1000.0)
        check_parameter("stiffest_n_per_m", self.stiffest_n_per_m, 1.0, LARGEST_STIFFNESS)

    def rule(self, axes: int, table: MakeTable) -> MotionRule:
        """Return law, what lines depend on, and room for the newest samples."""
        return MotionRule(
            *law_numbers(self.law),
            self.horizon_ms * 1e3,
            self.window_ms * 1e3,
            self.stiffest_n_per_m,
            table(1, KEPT),
            table(KEPT, axes),
            table(KEPT, axes),
            table(KEPT, axes),
            table(1, MOST_SAMPLES),
            table(MOST_SAMPLES, axes),
        )

    def form(self, axes: int) -> MotionForm:
        """Return the form of its messages."""
        return MotionForm(axes, self.law, stiffest=self.stiffest_n_per_m)
