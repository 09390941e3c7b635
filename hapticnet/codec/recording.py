"""Whole recordings: the messages that a codec sends, and the stimuli that the receiver applies, with and without loss.

Every codec is streamed sample by sample. Codecs made of steps run compiled instead if the ``fast`` extra is installed
and the recording is long enough for it to pay: the same functions in one loop, so the results are equal to the bit.
"""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hapticnet.arrays import FloatArray, IntArray, as_recording, refuse_out_of_range
from hapticnet.codec.base import Codec, Encoding
from hapticnet.codec.steps import Past, Steps, ignore_motion, learn_nothing, not_mirrored
from hapticnet.codec.streams import Scheme
from hapticnet.compiled import compiled, fast_extra_installed
from hapticnet.errors import PeerError, SampleError
from hapticnet.vectors import in_range, put, row

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TypeGuard

    from hapticnet.samples import Vector

COMPILE_ABOVE_SAMPLES = 1_000_000
"""Recordings longer than this run compiled.

Loading the machine code takes 0.4 s, in which a stream encodes several hundred thousand samples. Compiling takes 2 to
6 s (motion-predictive: 15 s), once for each codec, number of axes and version of hapticnet.
"""

STEPS: Final = Steps(*[ignore_motion] * 8)
IN_MOTION: Final = False
LEARNS: Final = False
MIRRORED: Final = False
"""Placeholders: `run_steps` is compiled with the steps of a scheme, whether it uses the motion, whether it learns from
every sample, and whether it has a `mirror`."""

LARGEST_TIME_US: Final = 2**61  # times [µs] up to which differences fit 64 bits


def encode_array(codec: Codec, t_us: IntArray, stimuli: FloatArray, positions: FloatArray | None = None) -> Encoding:
    """Encode and decode a recording as slave and master do if nothing is lost.

    Times [µs] have the shape (n,), stimuli [N] and positions [m], if they are known, the shape (n, a) with 1 ≤ a ≤ 3,
    or (n,). Raise SampleError if the shapes do not fit, or a stimulus, or a position that the codec uses, is not finite
    or out of range.
    """
    stimuli, t_us, positions = _checked(t_us, stimuli, positions)
    if is_made_of_steps(codec) and is_long(t_us):
        return _encode_compiled(codec, t_us, stimuli, positions)
    return encode_streamed(codec, t_us, stimuli, positions)


def is_long(t_us: IntArray) -> bool:
    """Return whether a recording with these times runs compiled."""
    return len(t_us) > COMPILE_ABOVE_SAMPLES and fast_extra_installed()


def is_made_of_steps(codec: Codec) -> "TypeGuard[Scheme]":
    """Return whether a codec consists of its steps alone; a subclass by a user may have its own encoder or decoder."""
    kind: Any = getattr(codec, "inner", type(codec))  # a user's class before `plugins` guarded it
    return isinstance(codec, Scheme) and kind.encoder is Scheme.encoder and kind.decoder is Scheme.decoder


def encode_streamed(codec: Codec, t_us: IntArray, stimuli: FloatArray, positions: FloatArray | None = None) -> Encoding:
    """Encode and decode a recording as `encode_array` does, always sample by sample."""
    stimuli, t_us, positions = _checked(t_us, stimuli, positions)
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    encode, decode, reconstruct = encoder.encode, decoder.decode, decoder.reconstruct
    sent: list[int] = []
    sizes: list[int] = []
    decoded: list[Vector] = []
    index = 0
    try:
        for index, at_us, stimulus, position in _samples(t_us, stimuli, positions):
            payload = encode(at_us, stimulus, position)
            if payload is not None:
                decode(at_us, payload)
                sent.append(index)
                sizes.append(len(payload))
            decoded.append(reconstruct(at_us, position))
    except SampleError as error:
        raise SampleError(f"sample {index}: {error}") from error
    return _encoding(stimuli, sent, sizes, decoded)


def encode_lossy(
    codec: Codec,
    t_us: IntArray,
    stimuli: FloatArray,
    positions: FloatArray | None = None,
    *,
    loss: float,
    repair_us: int | None,
    rng: np.random.Generator,
) -> tuple[Encoding, IntArray]:
    """Encode and decode a recording over a channel that loses updates; also return which updates arrived.

    A share `loss` (0 to 1) of the updates is lost at random. An update that is lost or refused is replaced
    by the first stimulus at least `repair_us` later, unless a later update has arrived, as a session does after about a
    round trip; None: never.
    """
    stimuli, t_us, positions = _checked(t_us, stimuli, positions)
    encoder, decoder = codec.encoder(stimuli.shape[1]), codec.decoder(stimuli.shape[1])
    sent: list[int] = []
    sizes: list[int] = []
    decoded: list[Vector] = []
    received: list[int] = []
    missing_since_us: int | None = None
    for index, at_us, stimulus, position in _samples(t_us, stimuli, positions):
        if missing_since_us is not None and repair_us is not None and at_us - missing_since_us >= repair_us:
            encoder.refresh()
            missing_since_us = None
        try:
            payload = encoder.encode(at_us, stimulus, position)
        except SampleError as error:
            raise SampleError(f"sample {index}: {error}") from error
        if payload is not None:
            sent.append(index)
            sizes.append(len(payload))
            arrives = rng.random() >= loss
            if arrives:
                try:
                    decoder.decode(at_us, payload)
                except PeerError:  # it builds on an update that was lost
                    arrives = False
            if arrives:
                received.append(index)
                missing_since_us = None
            elif missing_since_us is None:
                missing_since_us = at_us
        decoded.append(decoder.reconstruct(at_us, position))
    return _encoding(stimuli, sent, sizes, decoded), np.array(received, dtype=np.int64)


def _encode_compiled(scheme: Scheme, t_us: IntArray, stimuli: FloatArray, positions: FloatArray | None) -> Encoding:
    samples, axes = stimuli.shape
    steps = scheme.steps
    in_motion, mirrored = scheme.needs_position and positions is not None, steps.mirror is not not_mirrored
    where = positions if in_motion and positions is not None else stimuli
    if in_motion:
        refuse_out_of_range(where, "position")
    loop = compiled(
        run_steps,
        name=f"{scheme.name} {'in motion' if in_motion else 'at rest'}",
        using={
            "STEPS": steps,
            "IN_MOTION": in_motion,
            "LEARNS": steps.learn is not learn_nothing,
            "MIRRORED": mirrored,
        },
    )
    rules = _rule_of_arrays(scheme, axes), _rule_of_arrays(scheme, axes)
    sent, sizes = np.empty(samples, dtype=np.int64), np.empty(samples, dtype=np.uint16)
    decoded = np.empty_like(stimuli)
    count = loop(
        *rules,
        steps.start_sender(rules[0], axes),
        steps.start_receiver(rules[1], axes),
        (0.0,) * axes,
        t_us,
        stimuli,
        where,
        sent,
        sizes,
        decoded,
    )
    if count < 0:
        last = int(sent[~count])
        refuse_out_of_range(stimuli[last : last + 1], first=last)
    return Encoding(sent=sent[:count], decoded=decoded, payload_bytes=sizes[:count])


def run_steps(
    rule: Any,
    receiver_rule: Any,
    sender: Any,
    receiver: Any,
    zeros: "Vector",
    t_us: Any,
    stimuli: Any,
    positions: Any,
    sent: IntArray,
    sizes: Any,
    decoded: Any,
) -> int:
    """Run a scheme over a recording: write what it sends and applies, and return the number of stimuli sent.

    If a stimulus is out of range, stop and return the complement of its place in `sent`.
    """
    count = first = 0
    for i in range(stimuli.shape[0]):
        now_us, x = t_us[i], row(stimuli, i, zeros)
        if IN_MOTION:
            sender = STEPS.watch(rule, sender, now_us, row(positions, i, zeros))
        if LEARNS:
            sent[count] = i
            if not in_range(x):
                return ~count
            sender = STEPS.learn(rule, sender, now_us, x)
        if not STEPS.is_silent(rule, sender, now_us, x):
            sent[count] = i
            if not in_range(x):
                return ~count
            if STEPS.ends_past(rule, sender, now_us, x):
                first = i
            message, sender = STEPS.send(rule, sender, now_us, x, Past(t_us, stimuli, first, i))
            if not MIRRORED:
                receiver = STEPS.receive(receiver_rule, receiver, now_us, message)
            sizes[count] = STEPS.payload_bytes(rule, message)
            count += 1
        if MIRRORED:
            receiver = STEPS.mirror(sender)
        if IN_MOTION:
            receiver = STEPS.move(receiver_rule, receiver, now_us, row(positions, i, zeros))
        put(decoded, i, STEPS.apply(receiver_rule, receiver, now_us))
    return count


def _rule_of_arrays(scheme: Scheme, axes: int) -> Any:
    rule = scheme.rule(axes, _array_table)
    return rule._replace(**{key: np.array(each) for key, each in rule._asdict().items() if type(each) is tuple})


def _array_table(rows: int, columns: int) -> FloatArray:
    return np.zeros((rows, columns))


def _checked(
    t_us: IntArray, stimuli: FloatArray, positions: FloatArray | None
) -> tuple[FloatArray, IntArray, FloatArray | None]:
    """Return recording, times and positions as arrays of fitting shapes."""
    stimuli = as_recording(stimuli)
    times = np.ascontiguousarray(t_us, dtype=np.int64)
    if times.shape != stimuli.shape[:1]:
        raise SampleError(f"{times.size} time stamps for {len(stimuli)} samples; the counts must match")
    # Compiled, because two passes of numpy over the times take longer than the deadband's whole loop.
    scan = compiled(extremes) if is_long(times) else extremes_of_few
    first_us, last_us = scan(times)
    if not -LARGEST_TIME_US <= first_us <= last_us <= LARGEST_TIME_US:
        raise SampleError(f"time stamps from {first_us} to {last_us} µs; they must be within ±2^61")
    if positions is not None:
        positions = as_recording(positions)
        if positions.shape != stimuli.shape:
            raise SampleError(f"positions of shape {positions.shape} for stimuli of shape {stimuli.shape}")
    return stimuli, times, positions


def extremes_of_few(times: IntArray) -> tuple[int, int]:
    """Return the earliest and the latest time; zeros if there are none."""
    return (int(times.min()), int(times.max())) if times.size else (0, 0)


def extremes(times: Any) -> tuple[int, int]:
    """Return the same in one pass, for compilation."""
    earliest = latest = times[0] if len(times) else 0
    for k in range(len(times)):
        earliest, latest = min(earliest, times[k]), max(latest, times[k])
    return earliest, latest


def _samples(
    t_us: IntArray, stimuli: FloatArray, positions: FloatArray | None
) -> "Iterator[tuple[int, int, Vector, Vector | None]]":
    where: list[Vector | None] = [None] * len(stimuli)
    if positions is not None:
        where = list(zip(*positions.T.tolist(), strict=True))
    return zip(range(len(stimuli)), t_us.tolist(), zip(*stimuli.T.tolist(), strict=True), where, strict=True)


def _encoding(stimuli: FloatArray, sent: list[int], sizes: list[int], decoded: "list[Vector]") -> Encoding:
    return Encoding(
        sent=np.array(sent, dtype=np.int64),
        decoded=np.array(decoded, dtype=np.float64).reshape(stimuli.shape),
        payload_bytes=np.array(sizes, dtype=np.uint16),
    )
