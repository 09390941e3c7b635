"""A scheme written once: its steps as plain functions, and the encoder and decoder that call them sample by sample.

A scheme divides its work as the link does. The sender keeps a state, which includes what the receiver applies; it stays
silent or sends a message, which is a tuple of numbers as the receiver gets them, after rounding. The receiver changes
its state with each message and applies a stimulus at every sample. Form and bytes of a message are the business of
`payload`.

The same functions run here in a stream, in `codec.recording` over whole recordings, and can run for many sessions at
once. They are therefore written in the subset of Python that numba compiles: numbers, tuples, named tuples, loops, and
calls of such functions. A state is never changed in place. What a rule remembers of many updates is in tables (lists of
lists, or arrays) that belong to the rule; every sender and every receiver has a rule of its own.
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
"""Returns a table of zeros with so many rows and columns."""


class Past(NamedTuple):
    """The newest samples, the present one included.

    Attributes
    ----------
    times_us, samples
        Sampling times [µs] and stimuli; indices above `newest` are not to be read.
    first, newest
        Index of the first sample that counts, and of the present one.
    """

    times_us: Sequence[float]
    samples: Sequence[Sequence[float]]
    first: int
    newest: int


NO_PAST: Final = Past((), (), 0, 0)


def unknown(sender: Any) -> None:
    """Return None: the sender does not know the state of the receiver."""


def never(rule: Any, sender: Any, t_us: int, x: Vector) -> bool:
    """Return False: nothing ends the past."""
    return False


def unmoved(rule: Any, state: Any, t_us: int, position: Vector) -> Any:
    """Return the state: motion changes nothing."""
    return state


NOTHING: Final = (math.inf, -math.inf)
"""An interval that contains no number."""


def nothing(rule: Any, sender: Any) -> tuple[float, float]:
    """Return an interval that contains no number: every stimulus is looked at."""
    return NOTHING


class Steps(NamedTuple):
    """The functions that define a scheme. `rule` holds its numbers.

    Attributes
    ----------
    start_sender, start_receiver
        ``(rule, axes) -> state``.
    is_silent
        ``(rule, sender, t_us, x) -> bool``: whether x need not be sent. False for what is not finite.
    send
        ``(rule, sender, t_us, x, past) -> (message, sender)``.
    refreshed
        ``(sender) -> sender``: a state that is not silent, because the last update is believed lost. Never compiled.
    receive
        ``(rule, receiver, t_us, message) -> receiver``.
    apply
        ``(rule, receiver, t_us) -> x``.
    payload_bytes
        ``(rule, message) -> int``: size of the payload [B].
    mirror
        ``(sender) -> receiver``: the state of the receiver as the sender knows it, if nothing is lost. `unknown`: it
        depends on what the receiver sees for itself.
    watch, move
        ``(rule, state, t_us, position) -> state``: what the sender does with each position before it decides, and the
        receiver before it applies.
    ends_past
        ``(rule, sender, t_us, x) -> bool``: whether samples before x say nothing of what follows it.
    quiet
        ``(rule, sender) -> (low, high)``: stimuli of one axis that are silent at any time until the next message, which
        a stream need not look at any further. It decides nothing else. Never compiled.
    """

    start_sender: Callable[..., Any]
    is_silent: Callable[..., bool]
    send: Callable[..., tuple[Any, Any]]
    refreshed: Callable[..., Any]
    start_receiver: Callable[..., Any]
    receive: Callable[..., Any]
    apply: Callable[..., Vector]
    payload_bytes: Callable[..., int]
    mirror: Callable[..., Any] = unknown
    watch: Callable[..., Any] = unmoved
    move: Callable[..., Any] = unmoved
    ends_past: Callable[..., bool] = never
    quiet: Callable[..., tuple[float, float]] = nothing


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
    steps: ClassVar[Steps]
    law: WeberLaw

    def rule(self, axes: int, table: MakeTable) -> Any:
        """Return the numbers and tables of the rule as a named tuple; tuples in it are tables that do not change."""
        raise NotImplementedError

    def form(self, axes: int) -> Form:
        """Return the form of its messages."""
        raise NotImplementedError

    def past_samples(self) -> int:
        """Return the length of the past that `send` reads."""
        return 0

    def encoder(self, axes: int) -> "StepEncoder":
        """Return a new encoder for stimuli of 1 to 3 axes."""
        if self.steps.watch is not unmoved:
            return WatchingEncoder(self, axes)
        if self.steps.quiet is not nothing and axes == 1:
            return QuietEncoder(self, axes)
        return PastEncoder(self, axes) if self.past_samples() else StepEncoder(self, axes)

    def decoder(self, axes: int) -> "StepDecoder":
        """Return a new decoder for stimuli of 1 to 3 axes."""
        if self.steps.receive is hold:
            return HoldDecoder(self, axes)
        return MovingDecoder(self, axes) if self.steps.move is not unmoved else StepDecoder(self, axes)


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


class QuietEncoder(StepEncoder):
    """The same for one axis and a rule that holds still between messages: silence costs two comparisons."""

    __slots__ = ("_high", "_low", "_quiet")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._quiet = scheme.steps.quiet
        self._low, self._high = NOTHING

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
        self._low, self._high = self._quiet(self._rule, self._sender)
        return self._pack(message)

    def refresh(self) -> None:
        """Make the next stimulus a transmitted one."""
        self._low, self._high = NOTHING
        super().refresh()


class WatchingEncoder(StepEncoder):
    """The same for a rule that depends on motion."""

    __slots__ = ()

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload to transmit, or None."""
        before = self._sender
        if position is not None:
            position = checked_position(position, self._axes)
            self._sender = self._steps.watch(self._rule, before, t_us, position)
        try:
            return StepEncoder.encode(self, t_us, stimulus)
        except SampleError:
            self._sender = before
            raise


class PastEncoder(StepEncoder):
    """The same for messages that depend on past samples."""

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

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002
        """Return the stimulus to apply."""
        return self._apply(self._rule, self._receiver, t_us)


class MovingDecoder(StepDecoder):
    """The same for a receiver that follows the motion of the tool."""

    __slots__ = ("_axes", "_move")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        super().__init__(scheme, axes)
        self._axes = axes
        self._move = scheme.steps.move

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:
        """Return the stimulus to apply."""
        if position is not None:
            position = checked_position(position, self._axes)
            self._receiver = self._move(self._rule, self._receiver, t_us, position)
        return self._apply(self._rule, self._receiver, t_us)


class HoldDecoder(StepDecoder):
    """The same for the zero-order hold, whose state is what it applies."""

    __slots__ = ()

    def reconstruct(self, t_us: int, position: Vector | None = None) -> Vector:  # noqa: ARG002
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
