"""Payloads of sessions with announcements.

That of a FORCE is a byte, and after it a payload of the codec or a model of the contact ahead. That of a POSITION is a
byte that says which layers of the model are pierced, and the position.

A model is the number of its layers in a byte, and for each layer a byte of flags and the values that it has as float32,
big-endian, in the order of `_FIELDS`.
"""

import math
import struct
from collections.abc import Sequence
from typing import Final

from hapticnet.errors import PeerError, SampleError
from hapticnet.scene.ahead import MOST_LAYERS, LayerAhead, check_layers

OF_CODEC: Final = b"\x00"
OF_MODEL: Final = b"\x01"

PIERCED: Final = 1
BREACHES: Final = 2
VISCOUS: Final = 4
STIFFENS: Final = 8
RUBS: Final = 16
RECOVERS: Final = 32

_FIELDS: Final = (
    (0, ("surface_m", "stiffness_n_per_m")),
    (BREACHES, ("breach_force_n",)),
    (VISCOUS, ("viscosity_n_s_per_m",)),
    (STIFFENS, ("stiffening_per_m",)),
    (RUBS, ("friction_n", "presliding_m", "shaft_n")),
    (RECOVERS, ("recovery_s", "raised_m")),
)
"""The flag of each group of values, and their names. The normal follows, unless there is one axis."""


def pack_model(layers: Sequence[LayerAhead], axes: int) -> bytes:
    """Return the payload that announces `layers`.

    Raises
    ------
    SampleError
        If a value does not fit a float32.
    """
    parts = [OF_MODEL, bytes([len(layers)])]
    for layer in layers:
        flags = (
            PIERCED * layer.pierced
            | BREACHES * (layer.breach_force_n < math.inf)
            | VISCOUS * (layer.viscosity_n_s_per_m > 0.0)
            | STIFFENS * (layer.stiffening_per_m > 0.0)
            | RUBS * (layer.friction_n > 0.0)
            | RECOVERS * (layer.recovery_s > 0.0)
        )
        values = [getattr(layer, name) for flag, names in _FIELDS if flag & flags == flag for name in names]
        if axes > 1:
            values += layer.normal
        try:
            parts.append(struct.pack(f">B{len(values)}f", flags, *values))
        except OverflowError as error:
            raise SampleError(f"a layer ahead does not fit a float32: {layer}") from error
    return b"".join(parts)


def unpack_model(payload: bytes, axes: int, stiffest_n_per_m: float) -> tuple[LayerAhead, ...]:
    """Return the layers that a payload announces.

    Raises
    ------
    PeerError
        If it is malformed, or says what is not allowed.
    """
    try:
        if payload[:1] != OF_MODEL or payload[1] > MOST_LAYERS:
            raise PeerError(f"payload {payload[:2].hex()}…: no model of at most {MOST_LAYERS} layers")
        layers, at = [], 2
        for _ in range(payload[1]):
            layer, at = _unpack_layer(payload, at, axes)
            layers.append(layer)
        if at != len(payload):
            raise PeerError(f"a model of {at} bytes in a payload of {len(payload)}")
        check_layers(layers, axes, stiffest_n_per_m)
    except (IndexError, struct.error) as error:
        raise PeerError(f"a model that ends after {len(payload)} bytes") from error
    except SampleError as error:
        raise PeerError(str(error)) from error
    return tuple(layers)


def _unpack_layer(payload: bytes, at: int, axes: int) -> tuple[LayerAhead, int]:
    flags = payload[at]
    if flags >= 2 * RECOVERS:
        raise PeerError(f"a layer with unknown flags {flags:#x}")
    names = [name for flag, names in _FIELDS if flag & flags == flag for name in names]
    count = len(names) + (axes if axes > 1 else 0)
    values = struct.unpack_from(f">{count}f", payload, at + 1)
    normal = values[len(names) :] or (1.0,)
    layer = LayerAhead(**dict(zip(names, values, strict=False)), normal=normal, pierced=bool(flags & PIERCED))
    return layer, at + 1 + 4 * count


def with_state(state: int, payload: bytes) -> bytes:
    """Return the payload of a POSITION behind which layers of the model are pierced there."""
    return bytes([state]) + payload


def read_state(payload: bytes) -> tuple[int, bytes]:
    """Return which layers are pierced and the payload of the position; PeerError if there is nothing."""
    if not payload:
        raise PeerError("a position without a state")
    return payload[0], payload[1:]
