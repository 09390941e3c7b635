"""The motion-predictive deadband: transmit how the stimulus follows time and the receiver's own position.

Our own codec (docs/build/decisions.md, 0012). In contact, force follows position far more than time, and the receiver
knows its own position without delay. This is a local contact model, as in model-mediated teleoperation (Hannaford 1989;
Mitra & Niemeyer 2008), sent under a perceptual deadband.

Four predictors run at the sender, each like a separate codec: the zero-order hold, the curve of
`adaptive_predictive`, a surface with the stiffness of the last milliseconds, and a coupling of learned stiffness and
viscosity with a curve for the rest. When an update is needed, the predictor that has needed the fewest packets
recently sends it. If that has taken more packets than a deadband, the sender goes on as the deadband would.

If the encoder is told the round trip, it sends what was felt truest recently: the surface, the better of curve and
hold, or a fifth predictor, the coupling of similar samples (`motion_felt`).
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple, TypeAlias

from hapticnet.checks import check_parameter
from hapticnet.codec.schemes.contact import Coupling, is_due, no_coupling, observed
from hapticnet.codec.schemes.motion import (
    HOLD,
    LARGEST_STIFFNESS,
    UNSENT,
    Line,
    Message,
    Motion,
    MotionForm,
    line_at,
    line_of,
    message_bytes,
    moved_on,
    no_line,
    unknown_motion,
    unseen,
)
from hapticnet.codec.schemes.motion_felt import (
    COUPLED_LINE,
    FELT_EVERY,
    HELD_LINE,
    LEAST_ROUND_TRIP_US,
    NOTHING_FELT,
    SIMILAR_LINE,
    SURFACE_LINE,
    TIMED_LINE,
    Felt,
    feel,
    felt_tables,
    similar_coupling,
)
from hapticnet.codec.schemes.predictors import (
    KEPT,
    MotionRule,
    Numbers,
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
from hapticnet.codec.steps import MakeTable, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import law_numbers, threshold_around
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector
from hapticnet.vectors import distance, minus, single

VELOCITY_LAG_S: Final = 0.005
"""Time constant of the velocity's low-pass [s]: five samples at 1 kHz, in which a hand hardly changes its speed."""

TESTED_EVERY: Final = 2  # predictors are tested at every second sample, which is enough to compare them, and costs half
FORGETTING: Final = 0.98  # factor on the packets counted so far at each packet sent: about twenty are remembered

MOST_OVER: Final = 1.02
SPARE: Final = 2.0  # packets are at most those of a deadband times the one or plus the other, but for repairs


class Predictors(NamedTuple):
    """The predictors and their knowledge."""

    surface: Line  # The one drawn last
    curve: Predictor
    coupled: Predictor
    coupling: Coupling
    packets: tuple[float, float, float, float]  # Packets that surface, coupling, curve and hold have needed recently


Rival: TypeAlias = tuple[Vector, float, float, float]
"""``(value, threshold, packets, ours)``: what a deadband codec would hold, the threshold around it [N], and the packets
that it and this codec have needed."""

Sender: TypeAlias = tuple[bool, Motion, Line, int, Predictors, Rival, Felt]
"""``(is_known, motion, line, newest, predictors, rival, felt)``: the receiver's line, and the predictors.

Like `Motion`, it changes at every sample, so it is a plain tuple.

is_known
    Whether the receiver is known to follow `line`; False after a loss.
newest
    Index of the newest sample in the rule's tables.
"""

Receiver: TypeAlias = tuple[Motion, Line]  # ``(motion, line)``: the receiver's own motion, and the line it follows


def start(rule: Any, axes: int) -> Sender:
    """Return a sender that has learned nothing yet."""
    zeros, none = (0.0,) * axes, no_line(axes)
    predictor = Predictor(none, zeros, zeros, zeros, Trend(zeros, zeros, zeros), NOTHING_LEARNED)
    predictors = Predictors(none, predictor, predictor, no_coupling(axes), (0.0, 0.0, 0.0, 0.0))
    return False, unknown_motion(axes), none, -1, predictors, (zeros, -1.0, 0.0, 0.0), NOTHING_FELT


def start_receiver(rule: Any, axes: int) -> Receiver:
    """Return a receiver that applies zeros."""
    return unknown_motion(axes), no_line(axes)


def watch(rule: Any, sender: Sender, t_us: int, position: Vector) -> Sender:
    """Follow the tool to its position."""
    is_known, motion, line, newest, predictors, rival, felt = sender
    return is_known, moved_on(motion, t_us, position, VELOCITY_LAG_S), line, newest, predictors, rival, felt


def at_rest(sender: Sender) -> Sender:
    """Note that the position of this sample is unknown."""
    is_known, motion, line, newest, predictors, rival, felt = sender
    return is_known, unseen(motion), line, newest, predictors, rival, felt


def move(rule: Any, receiver: Receiver, t_us: int, position: Vector) -> Receiver:
    """Follow the receiver's own position."""
    motion, line = receiver
    return moved_on(motion, t_us, position, VELOCITY_LAG_S), line


def learn(rule: MotionRule, sender: Sender, t_us: int, x: Vector) -> Sender:
    """Advance each predictor as if it were alone, and count its packets."""
    is_known, motion, line, newest, predictors, rival, felt = sender
    numbers = rule.numbers
    newest = remember(rule, newest, t_us, x, motion)
    held, width, packets, ours = rival
    if not (abs(x[0] - held[0]) if len(x) == 1 else distance(x, held)) <= width:
        held = drawn_hold(numbers, motion, x, x).value
        rival = held, threshold_around(numbers, held), packets + 1.0, ours
        predictors = with_hold(predictors)
    if newest % TESTED_EVERY:
        return is_known, motion, line, newest, predictors, rival, felt
    if is_due(predictors.coupling, motion, t_us):
        coupling = observed(predictors.coupling, motion, t_us, x, threshold_around(numbers, x))
        predictors = with_coupling(predictors, coupling)
    touches = follows(numbers, predictors.surface, motion, t_us, x)
    curves = follows(numbers, predictors.curve.line, motion, t_us, x)
    couples = follows(numbers, predictors.coupled.line, motion, t_us, x)
    if not (touches and curves and couples):
        predictors = redraw(rule, predictors, motion, newest, t_us, x, touches, curves, couples)
    if rule.round_trip_us[0][0] >= LEAST_ROUND_TRIP_US and newest % FELT_EVERY == 0:
        felt = feel(rule, felt, motion, t_us, x, predictors.surface, predictors.coupling)
    return is_known, motion, line, newest, predictors, rival, felt


def with_hold(predictors: Predictors) -> Predictors:
    """Return the predictors after another packet of the hold."""
    surface, curve, coupled, coupling, (of_surface, of_coupled, of_curve, of_hold) = predictors
    return Predictors(surface, curve, coupled, coupling, (of_surface, of_coupled, of_curve, of_hold + 1.0))


def with_coupling(predictors: Predictors, coupling: Coupling) -> Predictors:
    """Return the predictors with another coupling."""
    surface, curve, coupled, _, packets = predictors
    return Predictors(surface, curve, coupled, coupling, packets)


def redraw(
    rule: MotionRule,
    predictors: Predictors,
    motion: Motion,
    newest: int,
    t_us: int,
    x: Vector,
    touches: bool,
    curves: bool,
    couples: bool,
) -> Predictors:
    """Update the predictors that no longer predict the stimulus, and count a packet for each."""
    surface, curve, coupled, coupling, packets = predictors
    of_surface, of_coupled, of_curve, of_hold = packets
    numbers = rule.numbers
    if not touches:
        surface = line_of(numbers, t_us, drawn_surface(rule, motion, newest, x, coupling.stiffness))
        of_surface += 1.0
    if not curves:
        curve = redrawn(rule, curve, motion, newest, t_us, x, 0.0, 0.0)
        of_curve += 1.0
    if not couples:
        stiffness, viscosity = usable(numbers, coupling.stiffness, coupling.viscosity, motion)
        coupled = redrawn(rule, coupled, motion, newest, t_us, x, stiffness, viscosity)
        of_coupled += 1.0
    return Predictors(surface, curve, coupled, coupling, (of_surface, of_coupled, of_curve, of_hold))


def is_silent(rule: MotionRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Return whether a stimulus is within the threshold around the applied one, and its line is the wanted one."""
    is_known, motion, line, _, _, _, (_, _, _, wanted, chosen) = sender
    return is_known and wanted == chosen and follows(rule.numbers, line, motion, t_us, x)


def send(rule: MotionRule, sender: Sender, t_us: int, x: Vector, past: Any) -> tuple[Message, Sender]:
    """Send the wanted line: the truest if the round trip is known, else the one that has needed the fewest packets."""
    is_known, motion, line, newest, predictors, rival, felt = sender
    _, samples, _, _, velocity = motion
    surface, curve, coupled, coupling, packets = predictors
    of_surface, of_coupled, of_curve, of_hold = packets
    numbers = rule.numbers
    held, width, of_rival, ours = rival
    if is_known or line.kind == UNSENT:  # a refresh is due to a loss, which would have cost the rival one, too
        ours += 1.0
    written, behind, losses, wanted, _ = felt
    if rule.round_trip_us[0][0] >= LEAST_ROUND_TRIP_US and samples > 0 and max(losses[0], losses[1], losses[2]) > 0.0:
        drawn = cheapest(packets, False) if wanted == TIMED_LINE else wanted
    else:
        can_pay = ours + 1.0 <= max(of_rival + SPARE, MOST_OVER * of_rival)
        drawn = cheapest(packets, samples > 0) if can_pay else HELD_LINE
    if drawn == SURFACE_LINE:
        message = drawn_surface(rule, motion, newest, x, coupling.stiffness)
    elif drawn in (COUPLED_LINE, SIMILAR_LINE):
        stiffness, viscosity = coupling.stiffness, coupling.viscosity
        if drawn == SIMILAR_LINE:
            stiffness, viscosity, _ = similar_coupling(rule.cells, coupling, x, velocity)
        stiffness, viscosity = usable(numbers, stiffness, viscosity, motion)
        trend = trend_beside(rule, motion, newest, x, stiffness, viscosity)
        message = drawn_curve(numbers, coupled.regression, trend, motion, x, stiffness, viscosity)
    elif drawn == TIMED_LINE:
        trend = trend_beside(rule, motion, newest, x, 0.0, 0.0)
        message = drawn_curve(numbers, curve.regression, trend, motion, x, 0.0, 0.0)
    else:  # hold what the deadband would, so that from now on both need the same packets
        zeros = minus(x, x)
        message = Message(HOLD, single(held) != held, held, zeros, zeros, 0.0, 0.0)
    packets = FORGETTING * of_surface, FORGETTING * of_coupled, FORGETTING * of_curve, FORGETTING * of_hold
    predictors = Predictors(surface, curve, coupled, coupling, packets)
    rival = held, width, of_rival, ours
    felt = written, behind, losses, wanted, wanted
    return message, (True, motion, line_of(numbers, t_us, message), newest, predictors, rival, felt)


def cheapest(packets: tuple[float, float, float, float], is_placed: bool) -> int:
    """Return the line that has needed the fewest packets, of those that can be drawn with or without a position."""
    of_surface, of_coupled, of_curve, of_hold = packets
    if is_placed and of_surface <= min(of_coupled, of_curve, of_hold):
        return SURFACE_LINE
    if is_placed and of_coupled <= min(of_curve, of_hold):
        return COUPLED_LINE
    return TIMED_LINE if of_curve <= of_hold else HELD_LINE


def refreshed(sender: Sender) -> Sender:
    """Mark the receiver's state as unknown."""
    _, motion, line, newest, predictors, rival, felt = sender
    return False, motion, line, newest, predictors, rival, felt


def mirror(sender: Sender) -> Receiver:
    """Return the receiver, if it knows the same positions."""
    _, motion, line, _, _, _, _ = sender
    return motion, line


def receive(rule: MotionRule, receiver: Receiver, t_us: int, message: Message) -> Receiver:
    """Follow the line of a message."""
    motion, _ = receiver
    return motion, line_of(rule.numbers, t_us, message)


def apply(rule: MotionRule, receiver: Receiver, t_us: int) -> Vector:
    """Return the stimulus of the line at the receiver's position."""
    (is_known, _, _, position, velocity), line = receiver
    return line_at(rule.numbers, line, is_known, position, velocity, t_us)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPredictive(Scheme):
    """Transmit how the stimulus follows from time and the receiver's own position, when it leaves the prediction.

    Rule: send when ``|x - p| > threshold(|p|)``, strictly, where the receiver applies p at its position and
    velocity (`schemes.motion`). The sender runs a predictor for each of the four kinds of payload like a separate
    codec, and sends with the one that has needed the fewest packets recently; over a known round trip, with the one
    whose lines were felt truest (`schemes.motion_felt`). Without positions, it sends curves and holds only.

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
        Largest stiffness that is transmitted [N/m]: 1 to 60 000. It bounds the effect of a late update: the error is
        at most this stiffness times the distance that the hand has moved since.
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

    def __post_init__(self: Any) -> None:
        check_parameter("horizon_ms", self.horizon_ms, 1.0, 10_000.0)
        check_parameter("window_ms", self.window_ms, 1.0, 1000.0)
        check_parameter("stiffest_n_per_m", self.stiffest_n_per_m, 1.0, LARGEST_STIFFNESS)

    def rule(self: Any, axes: int, table: MakeTable) -> MotionRule:
        """Return law, the numbers of the lines, and room for the newest samples."""
        return MotionRule(
            Numbers(*law_numbers(self.law), self.horizon_ms * 1e3, self.window_ms * 1e3, self.stiffest_n_per_m),
            table(1, KEPT),
            table(KEPT, axes),
            table(KEPT, axes),
            table(KEPT, axes),
            table(1, MOST_SAMPLES),
            table(MOST_SAMPLES, axes),
            *felt_tables(axes, table),
        )

    def form(self: Any, axes: int) -> MotionForm:
        """Return the form of its messages."""
        return MotionForm(axes, self.law, stiffest=self.stiffest_n_per_m)
