"""A scheme written once: its steps as plain functions, and the encoder and decoder that call them sample by sample.

A scheme has two sides. The sender keeps a state, which includes what the receiver applies. At each sample it is silent
or sends a message: a tuple of numbers, rounded as the receiver gets them. The receiver updates its state with each
message and applies a stimulus at every sample. `payload` turns messages into bytes.

The same functions run here in a stream and in `codec.recording`, compiled, over whole recordings. They are therefore
written in the subset of Python that numba compiles: numbers, tuples, named tuples, loops, and calls of such functions.
A state is never changed in place. A memory of many updates is kept in tables (lists of lists, or arrays), which belong
to the rule; every sender and every receiver has its own rule.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Final, NamedTuple, Never, Protocol

from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector, checked_vector

Table = list[list[float]]
"""Rows of numbers that a step may change."""

MakeTable = Callable[[int, int], Any]
"""``(rows, columns) -> table of zeros``."""


class Past(NamedTuple):
    """The newest samples, the present one included.

    Attributes
    ----------
    times_us, samples
        Sampling times [µs] and stimuli. Do not read indices above `newest`.
    first, newest
        Index of the first sample to use, and of the present one.
    """

    times_us: Sequence[float]
    samples: Sequence[Sequence[float]]
    first: int
    newest: int


NO_PAST: Final = Past((), (), 0, 0)


def not_mirrored(sender: Any) -> None:
    """Default of `Steps.mirror`: the sender does not know the state of the receiver."""


def unchanged(sender: Any) -> Any:
    """Return the state."""
    return sender


def never(rule: Any, sender: Any, t_us: int, x: Vector) -> bool:
    """Default of `Steps.ends_past`: return False."""
    return False


def ignore_motion(rule: Any, state: Any, t_us: int, position: Vector) -> Any:
    """Default of `Steps.watch` and `Steps.move`: return the state unchanged."""
    return state


def learn_nothing(rule: Any, sender: Any, t_us: int, x: Vector) -> Any:
    """Default of `Steps.learn`: return the state unchanged."""
    return sender


EMPTY_INTERVAL: Final = (math.inf, -math.inf)
"""An interval that contains no number."""


def no_interval(rule: Any, sender: Any) -> tuple[float, float]:
    """Default of `Steps.silent_interval`: return an empty interval, so that every stimulus is tested."""
    return EMPTY_INTERVAL


class Steps(NamedTuple):
    """The functions that define a scheme. `rule` holds its numbers.

    Attributes
    ----------
    start_sender, start_receiver
        ``(rule, axes) -> state``.
    is_silent
        ``(rule, sender, t_us, x) -> bool``: whether x need not be sent. False if x is not finite.
    send
        ``(rule, sender, t_us, x, past) -> (message, sender)``.
    refreshed
        ``(sender) -> sender``: a state that sends the next stimulus, after an update is believed lost. Never compiled.
    receive
        ``(rule, receiver, t_us, message) -> receiver``.
    apply
        ``(rule, receiver, t_us) -> x``.
    payload_bytes
        ``(rule, message) -> int``: size of the payload [B].
    mirror
        ``(sender) -> receiver``: the state of the receiver if nothing is lost. Omit it if that state depends on what
        the sender does not know, such as the receiver's own positions.
    watch, move
        ``(rule, state, t_us, position) -> state``: take in a position; `watch` at the sender before `is_silent`, `move`
        at the receiver before `apply`.
    at_rest
        ``(sender) -> sender``: what the sender does instead of `watch` if the position is not known. Never compiled.
    learn
        ``(rule, sender, t_us, x) -> sender``: take in every stimulus, before `is_silent` and after `watch`.
    ends_past
        ``(rule, sender, t_us, x) -> bool``: whether to forget the samples before x, for example at an impact.
    silent_interval
        ``(rule, sender) -> (low, high)``: a range of stimuli of one axis that are silent until the next message,
        whenever they come. Only a shortcut for streams: it must agree with `is_silent`. Never compiled.
    """

    start_sender: Callable[..., Any]
    is_silent: Callable[..., bool]
    send: Callable[..., tuple[Any, Any]]
    refreshed: Callable[..., Any]
    start_receiver: Callable[..., Any]
    receive: Callable[..., Any]
    apply: Callable[..., Vector]
    payload_bytes: Callable[..., int]
    mirror: Callable[..., Any] = not_mirrored
    watch: Callable[..., Any] = ignore_motion
    move: Callable[..., Any] = ignore_motion
    at_rest: Callable[..., Any] = unchanged
    learn: Callable[..., Any] = learn_nothing
    ends_past: Callable[..., bool] = never
    silent_interval: Callable[..., tuple[float, float]] = no_interval


class Form(Protocol):
    """How messages become bytes."""

    def pack(self, message: Any) -> bytes:
        """Return the payload of a message."""
        ...

    def unpack(self, payload: bytes, receiver: Any) -> Any:
        """Return the message in a payload for a receiver in some state; PeerError if `pack` cannot have made it."""
        ...


class Scheme:
    """A codec made of steps: base class of every codec of this package. Satisfies `Codec`."""

    __slots__ = ()
    name: ClassVar[str]
    needs_position: ClassVar[bool] = False
    builds_on_earlier: ClassVar[bool] = False
    """Whether a receiver that missed an update must refuse those after it."""
    steps: ClassVar[Steps]
    law: WeberLaw

    def rule(self, axes: int, table: MakeTable) -> Any:
        """Return the numbers and tables of the rule as a named tuple; tuples in it are constant tables."""
        raise NotImplementedError

    def form(self, axes: int) -> Form:
        """Return the form of its messages."""
        raise NotImplementedError

    def past_samples(self) -> int:
        """Return how many samples `send` reads, the present one included."""
        return 0

    def encoder(self, axes: int) -> "StepEncoder":
        """Return a new encoder for stimuli of 1 to 3 axes."""
        if self.steps.learn is not learn_nothing:
            return LearningEncoder(self, axes)
        if self.steps.watch is not ignore_motion:
            return MotionEncoder(self, axes)
        if self.steps.silent_interval is not no_interval and axes == 1:
            return IntervalEncoder(self, axes)
        return PastEncoder(self, axes) if self.past_samples() else StepEncoder(self, axes)

    def decoder(self, axes: int) -> "StepDecoder":
        """Return a new decoder for stimuli of 1 to 3 axes."""
        if self.steps.receive is hold:
            return HoldDecoder(self, axes)
        return MotionDecoder(self, axes) if self.steps.move is not ignore_motion else StepDecoder(self, axes)


def table_of_lists(rows: int, columns: int) -> Table:
    """Return a table of zeros for a stream."""
    return [[0.0] * columns for _ in range(rows)]


class StepEncoder:
    """The sending half of a scheme in a stream. Satisfies `Encoder`."""

    __slots__ = ("_axes", "_is_silent", "_pack", "_rule", "_send", "_sender", "_steps")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        self._axes = axes
        self._steps = scheme.steps
        self._rule = scheme.rule(axes, table_of_lists)
        self._pack = scheme.form(axes).pack
        self._is_silent, self._send = scheme.steps.is_silent, scheme.steps.send
        self._sender = scheme.steps.start_sender(self._rule, axes)

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload to transmit, or None."""
        if len(stimulus) != self._axes:
            refuse_axes(stimulus, self._axes, "stimulus")
        sender = self._sender
        if self._is_silent(self._rule, sender, t_us, stimulus):
            return None
        x = checked_vector(stimulus, "stimulus")
        message, self._sender = self._send(self._rule, sender, t_us, x, NO_PAST)
        return self._pack(message)

    def refresh(self) -> None:
        """Make the next stimulus a transmitted one."""
        self._sender = self._steps.refreshed(self._sender)


class IntervalEncoder(StepEncoder):
    """Encoder of one axis for a scheme with a `silent_interval`: silence costs two comparisons."""

    __slots__ = ("_high", "_low", "_silent_interval")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._silent_interval = scheme.steps.silent_interval
        self._low, self._high = EMPTY_INTERVAL

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload to transmit, or None."""
        try:
            (component,) = stimulus
        except ValueError:
            refuse_axes(stimulus, 1, "stimulus")
        if self._low <= component <= self._high:
            return None
        sender = self._sender
        if self._is_silent(self._rule, sender, t_us, stimulus):
            return None
        x = checked_vector(stimulus, "stimulus")
        message, self._sender = self._send(self._rule, sender, t_us, x, NO_PAST)
        self._low, self._high = self._silent_interval(self._rule, self._sender)
        return self._pack(message)

    def refresh(self) -> None:
        """Make the next stimulus a transmitted one."""
        self._low, self._high = EMPTY_INTERVAL
        super().refresh()


class MotionEncoder(StepEncoder):
    """Encoder of a scheme whose rule depends on the motion of the tool."""

    __slots__ = ()

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit, or None."""
        before = self._sender
        if position is None:
            self._sender = self._steps.at_rest(before)
        else:
            position = checked_position(position, self._axes)
            self._sender = self._steps.watch(self._rule, before, t_us, position)
        try:
            return StepEncoder.encode(self, t_us, stimulus)
        except SampleError:
            self._sender = before
            raise


class LearningEncoder(StepEncoder):
    """Encoder of a scheme that learns from every sample, and from the motion of the tool."""

    __slots__ = ("_learn", "_watch")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._learn, self._watch = scheme.steps.learn, scheme.steps.watch

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit, or None."""
        if len(stimulus) != self._axes:
            refuse_axes(stimulus, self._axes, "stimulus")
        x = checked_vector(stimulus, "stimulus")
        rule, sender = self._rule, self._sender
        if position is None:
            sender = self._steps.at_rest(sender)
        else:
            if len(position) != self._axes:
                refuse_axes(position, self._axes, "position")
            sender = self._watch(rule, sender, t_us, checked_vector(position, "position"))
        self._sender = sender = self._learn(rule, sender, t_us, x)
        if self._is_silent(rule, sender, t_us, x):
            return None
        message, self._sender = self._send(rule, sender, t_us, x, NO_PAST)
        return self._pack(message)


class PastEncoder(StepEncoder):
    """Encoder of a scheme whose messages depend on past samples."""

    __slots__ = ("_samples", "_times_us")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._times_us: deque[int] = deque(maxlen=scheme.past_samples())
        self._samples: deque[Vector] = deque(maxlen=scheme.past_samples())

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:  # noqa: ARG002
        """Return the payload to transmit, or None."""
        if len(stimulus) != self._axes:
            refuse_axes(stimulus, self._axes, "stimulus")
        sender = self._sender
        times_us, samples = self._times_us, self._samples
        if self._is_silent(self._rule, sender, t_us, stimulus):
            times_us.append(t_us)
            samples.append(stimulus)
            return None
        x = checked_vector(stimulus, "stimulus")
        if self._steps.ends_past(self._rule, sender, t_us, x):
            times_us.clear()
            samples.clear()
        times_us.append(t_us)
        samples.append(x)
        past = Past(times_us, samples, 0, len(times_us) - 1)
        message, self._sender = self._send(self._rule, sender, t_us, x, past)
        return self._pack(message)


def checked_position(position: Vector, axes: int) -> Vector:
    """Return a position; SampleError if it is not finite, out of range or has other axes than the stimuli."""
    if len(position) != axes:
        refuse_axes(position, axes, "position")
    return checked_vector(position, "position")


def refuse_axes(values: Vector, axes: int, what: str) -> Never:
    """Raise the SampleError of a vector with the wrong number of axes."""
    raise SampleError(f"{what} has {len(values)} axes; it must have {axes}")


class StepDecoder:
    """The receiving half of a scheme in a stream. Satisfies `Decoder`."""

    __slots__ = ("_apply", "_receive", "_receiver", "_rule", "_unpack")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        self._rule = scheme.rule(axes, table_of_lists)
        self._unpack = scheme.form(axes).unpack
        self._receive, self._apply = scheme.steps.receive, scheme.steps.apply
        self._receiver = scheme.steps.start_receiver(self._rule, axes)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Take in a payload."""
        receiver = self._receiver
        self._receiver = self._receive(self._rule, receiver, t_us, self._unpack(payload, receiver))

    def reconstruct(
        self,
        t_us: int,
        position: Vector | None = None,  # noqa: ARG002
        position_us: int | None = None,  # noqa: ARG002
    ) -> Vector:
        """Return the stimulus to apply."""
        return self._apply(self._rule, self._receiver, t_us)

    def foretell(self, t_us: int, position: Vector, position_us: int) -> Vector:  # noqa: ARG002
        """Return the stimulus to apply at a time to come."""
        return self._apply(self._rule, self._receiver, t_us)


class MotionDecoder(StepDecoder):
    """Decoder of a scheme that applies a stimulus which depends on the motion of the tool."""

    __slots__ = ("_axes", "_move")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._axes = axes
        self._move = scheme.steps.move

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply."""
        if position is not None:
            if len(position) != self._axes:
                refuse_axes(position, self._axes, "position")
            moved_us = t_us if position_us is None else position_us
            self._receiver = self._move(self._rule, self._receiver, moved_us, checked_vector(position, "position"))
        return self._apply(self._rule, self._receiver, t_us)

    def foretell(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus to apply at a time and a position to come; the receiver stays where it is."""
        receiver = self._move(self._rule, self._receiver, position_us, checked_position(position, self._axes))
        return self._apply(self._rule, receiver, t_us)


class HoldDecoder(StepDecoder):
    """Decoder of the zero-order hold, whose state is the stimulus it applies."""

    __slots__ = ()

    def decode(self, t_us: int, payload: bytes) -> None:  # noqa: ARG002
        """Take in a payload, as `hold` does."""
        self._receiver = self._unpack(payload, self._receiver)[1]

    def reconstruct(
        self,
        t_us: int,  # noqa: ARG002
        position: Vector | None = None,  # noqa: ARG002
        position_us: int | None = None,  # noqa: ARG002
    ) -> Vector:
        """Return the held stimulus."""
        held: Vector = self._receiver
        return held

    def foretell(self, t_us: int, position: Vector, position_us: int) -> Vector:  # noqa: ARG002
        """Return the held stimulus."""
        held: Vector = self._receiver
        return held


def hold_nothing(rule: Any, axes: int) -> Vector:
    """Return zeros, which are held before the first message."""
    return (0.0,) * axes


def hold(rule: Any, receiver: Vector, t_us: int, message: Any) -> Vector:
    """Return the value of a message, which is held from now on."""
    value: Vector = message[1]
    return value


def held(rule: Any, receiver: Vector, t_us: int) -> Vector:
    """Return the held stimulus."""
    return receiver


ZERO_ORDER_HOLD: Final[Mapping[str, Callable[..., Any]]] = {
    "start_receiver": hold_nothing,
    "receive": hold,
    "apply": held,
}
"""The receiver of every scheme that holds: its messages are ``(form, value)``."""
