"""Model-mediated teleoperation: send what is touched, a wall, instead of its force; the master renders it.

After B. Hannaford, "A design framework for teleoperators with kinesthetic feedback" (IEEE Trans. Robotics and
Automation 5, 1989), P. Mitra and G. Niemeyer, "Model-mediated telemanipulation" (IJRR 27, 2008), and X. Xu, B. Cizmeci,
C. Schuwerk and E. Steinbach, "Model-mediated teleoperation" (IEEE Access 4, 2016). The wall's surface is where contact
began, and faces the first force; its stiffness k is learned at each sample in contact, k += λ·(F − k·depth). Published
(S. Bernhard, chai3d, examples/GLFW/32-spring): λ is 0.1 (per metre), k begins at 200 N/m, and the deadband of a
parameter is 10 %.

A wall that changes while a hand presses it can give the hand energy. A change that raises the force is therefore
blended in over `blend_ms`; one that lowers it is applied at once. Blending does not remove that energy, but spreads it
over a time that is long for a hand. In a scene that is not a wall, the force may be larger than any of the scene.
"""

import struct
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple

from hapticnet.checks import check_parameter
from hapticnet.codec.steps import MakeTable, Steps
from hapticnet.codec.streams import Scheme
from hapticnet.codec.values import SINGLE_BYTES, ValueForm, law_numbers, threshold_around
from hapticnet.errors import PeerError
from hapticnet.perception import WeberLaw
from hapticnet.rounding import as_single
from hapticnet.samples import LARGEST_COMPONENT, Vector
from hapticnet.vectors import distance, dot, in_range, largest_component, limited, magnitude, minus, single, times

WALL: Final = 0  # form of a message: a wall; the other is that of a value

STIFFEST_N_PER_M: Final = 1e6

SAME_SIDE: Final = 0.5  # least cosine between the force and the wall's normal; below it, another side is touched


class WallRule(NamedTuple):
    """The numbers of the rule."""

    weber: float
    floor: float
    gain: float
    first: float
    deadband: float
    blend_s: float
    round_trip_us: Any  # unused


class Sender(NamedTuple):
    """What has been learned, and what the receiver has: a wall (stiffness along its normal, surface) or a value."""

    is_placed: bool
    position: Vector
    is_free: bool  # whether the newest sample was without contact, at `free`
    free: Vector
    wall: Vector  # stiffness along the normal [N/m]; zeros: no wall
    surface_m: float
    stiffness: float  # learned last [N/m]
    is_held: bool
    form: int
    held: Vector
    held_m: float
    threshold: float


class Receiver(NamedTuple):
    """A wall or a value; the receiver's own position and its time; and what is still to be blended in [N]."""

    form: int
    value: Vector
    surface_m: float
    is_placed: bool
    position: Vector
    t_us: int
    missing_n: float


def start(rule: WallRule, axes: int) -> Sender:
    """Return a sender that knows no wall."""
    zeros = (0.0,) * axes
    return Sender(False, zeros, False, zeros, zeros, 0.0, rule.first, False, WALL, zeros, 0.0, 0.0)


def watch(rule: WallRule, sender: Sender, t_us: int, position: Vector) -> Sender:
    """Follow the tool to its position."""
    _, _, is_free, free, wall, surface_m, stiffness, is_held, form, held, held_m, threshold = sender
    return Sender(True, position, is_free, free, wall, surface_m, stiffness, is_held, form, held, held_m, threshold)


def at_rest(sender: Sender) -> Sender:
    """Return a sender whose position is not known, so that it sends values."""
    return sender._replace(is_placed=False)


def learn(rule: WallRule, sender: Sender, t_us: int, x: Vector) -> Sender:
    """Find the wall's surface where contact begins, and its stiffness from each force."""
    is_placed, position, is_free, free, wall, surface_m, stiffness, is_held, form, held, held_m, threshold = sender
    if not is_placed:
        return sender
    size, known = magnitude(x), magnitude(wall)
    depth_m = dot(wall, position) / known - surface_m if known > 0.0 else 0.0
    if size <= rule.floor:
        is_free, free = True, position
        if known * depth_m > 2.0 * rule.floor:  # it has given way
            wall = times(wall, 0.0)
    elif in_range(x):
        normal = times(x, 1.0 / size)
        if known > 0.0 and depth_m > 0.0 and not is_free and dot(wall, normal) > SAME_SIDE * known:
            normal = times(wall, 1.0 / known)
        else:
            outside = is_free and dot(normal, minus(position, free)) > 0.0
            surface_m = dot(normal, free) if outside else dot(normal, position) - size / stiffness
        is_free = False
        learned = stiffness + rule.gain * (size - stiffness * (dot(normal, position) - surface_m))
        stiffness = min(max(learned, 1.0), STIFFEST_N_PER_M)
        wall = times(normal, stiffness)
    return Sender(
        is_placed, position, is_free, free, wall, surface_m, stiffness, is_held, form, held, held_m, threshold
    )


def is_silent(rule: WallRule, sender: Sender, t_us: int, x: Vector) -> bool:
    """Return whether the receiver has this wall, or a value close enough."""
    if not sender.is_held or not in_range(x):
        return False
    if not shows_wall(sender):
        return sender.form != WALL and distance(x, sender.held) <= sender.threshold
    moved_n = magnitude(sender.held) * abs(sender.surface_m - sender.held_m)
    changed = distance(sender.wall, sender.held)
    return sender.form == WALL and changed <= rule.deadband * magnitude(sender.held) and moved_n <= rule.floor


def shows_wall(sender: Sender) -> bool:
    """Return whether there is a wall to send; else the stimulus is sent."""
    return sender.is_placed and largest_component(sender.wall) > 0.0


def send(rule: WallRule, sender: Sender, t_us: int, x: Vector, past: Any) -> tuple[tuple[int, Vector, float], Sender]:
    """Send the wall, or the stimulus where there is none."""
    is_placed, position, is_free, free, wall, surface_m, stiffness, _, form, held, held_m, threshold = sender
    if shows_wall(sender):
        form, held, held_m = WALL, single(wall), as_single(surface_m)
    else:
        form, held, held_m = SINGLE_BYTES, single(x), 0.0
        threshold = threshold_around(rule, held)
    sender = Sender(is_placed, position, is_free, free, wall, surface_m, stiffness, True, form, held, held_m, threshold)
    return (form, held, held_m), sender


def refreshed(sender: Sender) -> Sender:
    """Forget what the receiver has."""
    return sender._replace(is_held=False)


def start_receiver(rule: WallRule, axes: int) -> Receiver:
    """Return a receiver that applies zeros."""
    zeros = (0.0,) * axes
    return Receiver(SINGLE_BYTES, zeros, 0.0, False, zeros, 0, 0.0)


def whole_n(receiver: Receiver) -> float:
    """Return the force [N] of the wall, where nothing is left to be blended in."""
    stiffness = magnitude(receiver.value)
    if receiver.form != WALL or stiffness == 0.0 or not receiver.is_placed:
        return 0.0
    return max(stiffness * (dot(receiver.value, receiver.position) / stiffness - receiver.surface_m), 0.0)


def receive(rule: WallRule, receiver: Receiver, t_us: int, message: tuple[int, Vector, float]) -> Receiver:
    """Take over a wall or a value; what a wall pushes harder is still missing."""
    before_n = magnitude(apply(rule, receiver, t_us))
    form, value, surface_m = message
    _, _, _, is_placed, position, at_us, _ = receiver
    changed = Receiver(form, value, surface_m, is_placed, position, at_us, 0.0)
    return Receiver(form, value, surface_m, is_placed, position, at_us, max(whole_n(changed) - before_n, 0.0))


def move(rule: WallRule, receiver: Receiver, t_us: int, position: Vector) -> Receiver:
    """Follow the receiver's own tool to its position."""
    form, value, surface_m, is_placed, _, at_us, missing_n = receiver
    elapsed_s = 1e-6 * (t_us - at_us) if is_placed and t_us > at_us else 0.0
    missing_n = missing_n * (rule.blend_s / (rule.blend_s + elapsed_s)) if rule.blend_s > 0.0 else 0.0
    return Receiver(form, value, surface_m, True, position, t_us, missing_n)


def apply(rule: WallRule, receiver: Receiver, t_us: int) -> Vector:
    """Return the force of the wall at the receiver's own position, or the value."""
    if receiver.form != WALL:
        return receiver.value
    size = whole_n(receiver) - receiver.missing_n
    if not size > 0.0:
        return times(receiver.value, 0.0)
    return limited(times(receiver.value, size / magnitude(receiver.value)), LARGEST_COMPONENT)


def message_bytes(rule: WallRule, message: tuple[int, Vector, float]) -> int:
    """Return the size of a payload [B]."""
    form, value, _ = message
    return 1 + 4 + 4 * len(value) if form == WALL else 1 + form * len(value)


class WallForm:
    """Messages ``(form, value, surface)`` as bytes. Satisfies `Form`."""

    def __init__(self, axes: int) -> None:
        self._value, self._wall = ValueForm(axes, wide=False), struct.Struct(f">B{axes + 1}f")

    def pack(self, message: tuple[int, Vector, float]) -> bytes:
        """Return the payload of a message."""
        form, value, surface_m = message
        return self._wall.pack(1, surface_m, *value) if form == WALL else b"\0" + self._value.pack((form, value))

    def unpack(self, payload: bytes, receiver: object = None) -> tuple[int, Vector, float]:  # noqa: ARG002
        """Return the message in a payload; PeerError if it is none."""
        if payload[:1] == b"\0":
            form, value = self._value.unpack(payload[1:])
            return form, value, 0.0
        if len(payload) != self._wall.size or payload[0] != 1:
            raise PeerError(f"neither a value nor a wall: {payload[:32].hex()}")
        _, surface_m, *wall = self._wall.unpack(payload)
        # NaN compares false with everything, so this form rejects it too.
        if not all(abs(each) <= STIFFEST_N_PER_M for each in wall) or not abs(surface_m) <= 2.0 * LARGEST_COMPONENT:
            raise PeerError(f"a wall out of range: {surface_m} m, {wall} N/m")
        return WALL, tuple(wall), surface_m


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelMediated(Scheme):
    """Send a wall's surface and stiffness when they change; the master renders it at its own position.

    Rule: send when the learned stiffness differs from the one sent by more than `deadband` of it, when the surface has
    moved by more than the threshold at rest over the stiffness, and when the wall appears or gives way. Nothing bounds
    the error in between. Payload: surface and stiffness along the normal, float32. Without a wall or a position it is
    the deadband with float32.

    Attributes
    ----------
    gain
        How fast the stiffness is learned [1/m]: its change at each sample over the error of the force.
    first_n_per_m
        Stiffness [N/m] before any contact.
    deadband
        Change of the stiffness that is sent, as a share of the stiffness.
    blend_ms
        Time constant [ms] with which a wall that pushes harder is blended in.
    """

    name: ClassVar[str] = "model-mediated"
    needs_position: ClassVar[bool] = True
    renders_model: ClassVar[bool] = True
    steps: ClassVar[Steps] = Steps(
        start_sender=start,
        watch=watch,
        at_rest=at_rest,
        learn=learn,
        is_silent=is_silent,
        send=send,
        refreshed=refreshed,
        start_receiver=start_receiver,
        receive=receive,
        move=move,
        apply=apply,
        payload_bytes=message_bytes,
    )
    law: WeberLaw = field(default_factory=WeberLaw)
    gain: float = 0.1
    first_n_per_m: float = 200.0
    deadband: float = 0.1
    blend_ms: float = 50.0

    def __post_init__(self) -> None:
        check_parameter("gain", self.gain, 0.0, 1e4, "1/m")
        check_parameter("first_n_per_m", self.first_n_per_m, 1.0, STIFFEST_N_PER_M, "N/m")
        check_parameter("deadband", self.deadband, 0.0, 1.0)
        check_parameter("blend_ms", self.blend_ms, 0.0, 1e4, "ms")

    def rule(self, axes: int, table: MakeTable) -> WallRule:  # noqa: ARG002
        """Return the numbers of the rule."""
        law = law_numbers(self.law)
        parameters = float(self.gain), float(self.first_n_per_m), float(self.deadband), 1e-3 * self.blend_ms
        return WallRule(*law, *parameters, table(1, 1))

    def form(self, axes: int) -> WallForm:
        """Return the form of its messages."""
        return WallForm(axes)
