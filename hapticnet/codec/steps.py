"""A scheme written once: its steps as plain functions.

A scheme has two sides. The sender keeps a state, which includes the applied stimulus. At each sample it is silent
or sends a message: a tuple of numbers, rounded as on the wire. The receiver updates its state with each
message and applies a stimulus at every sample. `payload` turns messages into bytes.

The same functions run in a stream (`codec.streams`) and, compiled, over whole recordings (`codec.recording`). They are
therefore written in the subset of Python that numba compiles: numbers, tuples, named tuples, loops, and calls of such
functions. A state is never changed in place. A history of many updates is kept in tables (lists of lists, or arrays),
which belong to the rule; every sender and every receiver has its own rule.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

from hapticnet.samples import Vector

Table = list[list[float]]  # Rows of numbers that a step may change
MakeTable = Callable[[int, int], Any]  # ``(rows, columns) -> table of zeros``


class Past(NamedTuple):
    """The newest samples, the present one included."""

    # Sampling times [µs] and stimuli. Do not read indices above `newest`.
    times_us: Sequence[float]
    samples: Sequence[Sequence[float]]
    # Index of the first sample to use, and of the present one
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


EMPTY_INTERVAL = (math.inf, -math.inf)  # an interval that contains no number


def no_interval(rule: Any, sender: Any) -> tuple[float, float]:
    """Default of `Steps.silent_interval`: return an empty interval, so that every stimulus is tested."""
    return EMPTY_INTERVAL


class Steps(NamedTuple):
    """The functions that define a scheme. `rule` holds its numbers."""

    start_sender: Callable[..., Any]  # ``(rule, axes) -> state``
    # ``(rule, sender, t_us, x) -> bool``: whether to send nothing for x. False if x is not finite.
    is_silent: Callable[..., bool]
    send: Callable[..., tuple[Any, Any]]  # ``(rule, sender, t_us, x, past) -> (message, sender)``
    # ``(sender) -> sender``: a state that sends the next stimulus, after an update is believed lost. Never compiled.
    refreshed: Callable[..., Any]
    start_receiver: Callable[..., Any]  # ``(rule, axes) -> state``
    receive: Callable[..., Any]  # ``(rule, receiver, t_us, message) -> receiver``
    apply: Callable[..., Vector]  # ``(rule, receiver, t_us) -> x``
    payload_bytes: Callable[..., int]  # ``(rule, message) -> int``: size of the payload [B]
    # ``(sender) -> receiver``: the receiver's state if nothing is lost. Omit it if it depends on values unknown to
    # the sender, such as the receiver's own positions.
    mirror: Callable[..., Any] = not_mirrored
    # ``(rule, state, t_us, position) -> state``: process a position; `watch` at the sender before `is_silent`, `move`
    # at the receiver before `apply`
    watch: Callable[..., Any] = ignore_motion
    move: Callable[..., Any] = ignore_motion
    # ``(sender) -> sender``: replaces `watch` if the position is unknown. Never compiled.
    at_rest: Callable[..., Any] = unchanged
    # ``(rule, sender, t_us, x) -> sender``: process every stimulus, before `is_silent` and after `watch`
    learn: Callable[..., Any] = learn_nothing
    # ``(rule, sender, t_us, x) -> bool``: whether to forget the samples before x, for example at an impact
    ends_past: Callable[..., bool] = never
    # ``(rule, sender) -> (low, high)``: a range of stimuli of one axis that are silent until the next message, whenever
    # they come. Only a shortcut for streams: it must agree with `is_silent`. Never compiled.
    silent_interval: Callable[..., tuple[float, float]] = no_interval


class Form(Protocol):
    """How messages become bytes."""

    def pack(self, message: Any) -> bytes:
        """Return the payload of a message."""

    def unpack(self, payload: bytes, receiver: Any) -> Any:
        """Return the message in a payload for a receiver in some state; PeerError if `pack` cannot produce it."""


def hold_nothing(rule: Any, axes: int) -> Vector:
    """Return zeros, the held value before the first message."""
    return (0.0,) * axes


def hold(rule: Any, receiver: Vector, t_us: int, message: Any) -> Vector:
    """Return the value of a message, to be held."""
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
"""The receiver of every zero-order-hold scheme: its messages are ``(form, value)``."""
