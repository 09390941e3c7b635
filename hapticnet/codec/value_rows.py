"""The codecs raw and deadband over a row of numbers, for one axis: compiled for the bank (docs/adr/0013).

The rules are the steps of the schemes; only state and payload have another form here.
"""

import math
from typing import Any, Final

import numpy as np

from hapticnet.codec.base import Codec, Decoder, Encoder
from hapticnet.codec.payload.values import ValueRule
from hapticnet.codec.schemes.deadband import EMPTY, Deadband, DeadZone, is_silent, send, silent_interval
from hapticnet.codec.schemes.raw import Raw
from hapticnet.codec.schemes.raw import send as send_raw
from hapticnet.codec.streams import HoldDecoder, IntervalEncoder, StepEncoder
from hapticnet.rounding import nearest

VALUE_FIELDS: Final[list[Any]] = [
    ("sends_all", np.bool_),  # the codec is raw
    ("weber", np.float64),
    ("floor", np.float64),
    ("count_step", np.float64),
    ("zone_n", np.float64),  # centre of the dead zone
    ("threshold_n", np.float64),
    ("silent_low_n", np.float64),
    ("silent_high_n", np.float64),
    ("held_n", np.float64),  # what the master holds if nothing is lost
]


def fits_row(codec: Codec) -> bool:
    """Tell whether a codec can run on a row."""
    return type(codec) is Raw or type(codec) is Deadband


def update(row: Any, force_n: float) -> int:
    """Return the form of the update for a force [N] (bytes of its payload), 0 for none; the master then holds it."""
    rule = ValueRule(row.weber, row.floor, row.count_step)
    if row.sends_all:
        message, _ = send_raw(rule, None, 0, (force_n,), None)
        form, value = message
        row.held_n = value[0]
        return form
    if row.silent_low_n <= force_n <= row.silent_high_n:
        return 0
    zone = DeadZone((row.zone_n,), row.threshold_n)
    if is_silent(rule, zone, 0, (force_n,)):
        return 0
    message, zone = send(rule, zone, 0, (force_n,), None)
    form, value = message
    row.zone_n, row.threshold_n = value[0], zone.threshold
    row.silent_low_n, row.silent_high_n = silent_interval(rule, zone)
    row.held_n = value[0]
    return form


def refresh(row: Any) -> None:
    """Let the next force be transmitted, whatever it is."""
    row.threshold_n = EMPTY
    row.silent_low_n, row.silent_high_n = math.inf, -math.inf


def count_of(row: Any) -> int:
    """Return the counts of the value that is held; see `counts_of`."""
    return int(nearest(row.held_n / row.count_step))


def codec_to_row(codec: Codec, encoder: Encoder, mirror: Decoder, row: Any) -> None:
    """Copy the state of an encoder, and of the mirror of its decoder, to a row."""
    assert isinstance(encoder, StepEncoder)  # noqa: S101 - `fits_row` has said so
    assert isinstance(mirror, HoldDecoder)  # noqa: S101
    row.sends_all = type(codec) is Raw
    row.weber, row.floor, row.count_step = encoder._rule
    (row.held_n,) = mirror._receiver
    if isinstance(encoder, IntervalEncoder):
        (row.zone_n,), row.threshold_n = encoder._sender
        row.silent_low_n, row.silent_high_n = encoder._low, encoder._high


def codec_from_row(encoder: Encoder, mirror: Decoder, row: Any) -> None:
    """Copy a row back to its encoder and mirror."""
    assert isinstance(mirror, HoldDecoder)  # noqa: S101 - `fits_row` has said so
    mirror._receiver = (float(row.held_n),)
    if isinstance(encoder, IntervalEncoder):
        encoder._sender = DeadZone((float(row.zone_n),), float(row.threshold_n))
        encoder._low, encoder._high = float(row.silent_low_n), float(row.silent_high_n)
