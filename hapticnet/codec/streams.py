"""The encoder and the decoder of a scheme in a stream, which run its steps sample by sample."""

from collections import deque
from typing import Any, ClassVar, Never

from hapticnet.checks import axes_of
from hapticnet.codec.base import Description
from hapticnet.codec.steps import (
    EMPTY_INTERVAL,
    NO_PAST,
    Form,
    MakeTable,
    Past,
    Steps,
    Table,
    hold,
    ignore_motion,
    learn_nothing,
    no_interval,
)
from hapticnet.errors import SampleError
from hapticnet.perception import WeberLaw
from hapticnet.samples import Vector, checked_vector


class Scheme(metaclass=Description):
    """A codec made of steps: base class of every codec of this package. Satisfies `Codec`."""

    __slots__ = ()
    name: ClassVar[str]
    needs_position: ClassVar[bool] = False
    builds_on_earlier: ClassVar[bool] = False
    """Whether a receiver that missed an update must refuse those after it."""
    receiver_has_tables: ClassVar[bool] = False
    """Whether the receiver also uses the tables of its rule."""
    renders_model: ClassVar[bool] = False
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


def table_of_rows(rows: int, columns: int) -> Table:
    """Return a table of zeros for a stream."""
    return [[0.0] * columns for _ in range(rows)]


def no_table(rows: int, columns: int) -> Table:  # noqa: ARG001
    """Return an empty table, for a receiver without tables."""
    return []


class StepEncoder:
    """The sending half of a scheme in a stream. Satisfies `Encoder`."""

    __slots__ = ("_axes", "_is_silent", "_pack", "_rule", "_send", "_sender", "_steps")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        self._axes = axes
        self._steps = scheme.steps
        self._rule = scheme.rule(axes, table_of_rows)
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
        """Force the next stimulus to be transmitted."""
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
        """Force the next stimulus to be transmitted."""
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

    def set_round_trip(self, round_trip_us: int) -> None:
        """Tell how old a position is when the answer to it is applied; 0 if that is not known. See `Delayed`."""
        self._rule.round_trip_us[0][0] = float(round_trip_us)


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
    """Return a position; SampleError if it is not finite, out of range or differs in axes from the stimuli."""
    if len(position) != axes:
        refuse_axes(position, axes, "position")
    return checked_vector(position, "position")


def refuse_axes(values: Vector, axes: int, what: str) -> Never:
    """Raise the SampleError of a vector with the wrong number of axes."""
    raise SampleError(f"{what} has {axes_of(len(values))}; it must have {axes}")


class StepDecoder:
    """The receiving half of a scheme in a stream. Satisfies `Decoder`."""

    __slots__ = ("_apply", "_receive", "_receiver", "_rule", "_unpack")

    def __init__(self, scheme: Scheme, axes: int) -> None:
        self._rule = scheme.rule(axes, table_of_rows if scheme.receiver_has_tables else no_table)
        self._unpack = scheme.form(axes).unpack
        self._receive, self._apply = scheme.steps.receive, scheme.steps.apply
        self._receiver = scheme.steps.start_receiver(self._rule, axes)

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload."""
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

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:  # noqa: ARG002
        """Return the stimulus to apply at a future time."""
        return self._apply(self._rule, self._receiver, t_us)


class MotionDecoder(StepDecoder):
    """Decoder of a scheme whose stimulus depends on the motion of the tool."""

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

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus to apply at a future time and position; the receiver's state does not change."""
        receiver = self._move(self._rule, self._receiver, position_us, checked_position(position, self._axes))
        return self._apply(self._rule, receiver, t_us)


class HoldDecoder(StepDecoder):
    """Decoder of the zero-order hold, whose state is the stimulus it applies."""

    __slots__ = ()

    def decode(self, t_us: int, payload: bytes) -> None:  # noqa: ARG002
        """Process a payload, as `hold` does."""
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

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:  # noqa: ARG002
        """Return the held stimulus."""
        held: Vector = self._receiver
        return held
