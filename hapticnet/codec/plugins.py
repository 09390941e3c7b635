"""Codecs of users: loaded from a file, a module or an entry point, and tested on a few samples before use."""

import math
import re
import sys
from dataclasses import MISSING, fields
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final

from hapticnet.codec.base import Codec, Decoder, Encoder, Predictive
from hapticnet.errors import PeerError, SampleError, SettingsError
from hapticnet.files import user_path
from hapticnet.samples import MAX_AXES, Vector
from hapticnet.user_code import load_user_code, raised, short

ENTRY_POINT_GROUP: Final = "hapticnet.codecs"

LARGEST_PAYLOAD: Final = 1024  # largest payload [B] that fits into a datagram on every network, with room for headers

REHEARSED_N: Final = (0.0, 0.2, 0.5, 2.0, 2.01, 2.5, -1.0, -1.0, 0.0, 5.0, 0.001, 1.0)
"""Forces of the rehearsal [N]: rest, rises, a sign change, repeats."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")

_loaded: dict[tuple[str, int], type[Any]] = {}


def user_class(source: str) -> type[Any]:
    """Return the codec class at ``FILE.py:Class`` or ``package.module:Class``, checked; reread if its file changed.

    Raise SettingsError if the file or module cannot be imported, or the class is missing or not a codec.
    """
    file = user_path(source.rpartition(":")[0])
    key = source, file.stat().st_mtime_ns if file.is_file() else 0
    if key not in _loaded:
        found = load_user_code(source, "codec")
        if not isinstance(found, type):
            raise SettingsError(f"codec {source}: {short(found)} is not a class")
        _loaded[key] = checked_class(found, source)
    return _loaded[key]


def installed_codecs() -> dict[str, EntryPoint]:
    """Return the entry points of installed packages that offer codecs, by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def checked_class(found: Any, source: str) -> type[Any]:
    """Test a class (docs/refer/api.md lists its required members); return it with its exceptions converted to ours.

    Raise SettingsError if the class is not a codec or fails the test; the message says why and names `source`.
    """
    parameters = getattr(found, "__dataclass_params__", None)
    if parameters is None or not parameters.frozen:
        raise SettingsError(f"codec {source}: not a frozen dataclass; decorate it with @dataclass(frozen=True)")
    known = {field.name: field for field in fields(found)}
    for name, kind in (("name", str), ("needs_position", bool)):
        if name in known or not isinstance(getattr(found, name, None), kind):
            raise SettingsError(f"codec {source}: needs a class variable {name}: ClassVar[{kind.__name__}]")
    if not _NAME.fullmatch(found.name):
        raise SettingsError(
            f"codec {source}: name is {found.name!r}; use 1 to 64 letters, digits, dots, dashes and underscores"
        )
    for name in ("encoder", "decoder"):
        if not callable(getattr(found, name, None)):
            raise SettingsError(f"codec {source}: has no method {name}(axes)")
    if "law" not in known:
        raise SettingsError(f"codec {source}: has no field law: WeberLaw = field(default_factory=WeberLaw)")
    for name, field in known.items():
        if field.default is MISSING and field.default_factory is MISSING:
            raise SettingsError(f"codec {source}: field {name} has no default")
        if name != "law" and not isinstance(field.default, (int, float)):
            raise SettingsError(f"codec {source}: parameter {name} is {field.default!r}; parameters are numbers")
    try:
        codec = found()
    except BaseException as error:
        raise SettingsError(f"codec {source}: making it raised {raised(error)}") from error
    rehearse(codec, source)
    return _guarded(found, source)


def rehearse(codec: Codec, source: str) -> None:
    """Run a codec over a few samples of one to three axes, with and without positions.

    A codec may refuse two or three axes with a SampleError.

    Raise SettingsError if it raises or returns something other than what `codec.base` describes.
    """
    for axes in range(1, MAX_AXES + 1):
        for moving in (False, True):
            try:
                _rehearse(codec, axes, moving)
            except SampleError as error:
                if axes == 1:
                    raise SettingsError(f"codec {source}: {error}") from error
            except _Fault as fault:
                raise SettingsError(f"codec {source}: {fault}") from fault
            except BaseException as error:
                raise SettingsError(
                    f"codec {source}: a rehearsal with {axes}-axis forces raised {raised(error)}"
                ) from error


class _Fault(Exception):  # noqa: N818 - private to this module
    """Fault found by a rehearsal."""


def _rehearse(codec: Codec, axes: int, moving: bool) -> None:
    encoder, decoder = codec.encoder(axes), codec.decoder(axes)
    if encoder is codec.encoder(axes) or decoder is codec.decoder(axes):
        raise _Fault("encoder(axes) and decoder(axes) must return a new object each time")
    _check_applied(decoder.reconstruct(0), axes)
    for index, force_n in enumerate((*REHEARSED_N, 1.0)):
        t_us = 1000 * index
        stimulus = tuple(force_n * scale for scale in (1.0, -0.5, 0.1)[:axes])
        position = tuple(1e-3 * index * scale for scale in (1.0, 0.2, 0.0)[:axes]) if moving else None
        last = index == len(REHEARSED_N)
        if last:
            encoder.refresh()
        payload = encoder.encode(t_us, stimulus, position)
        _check_payload(payload)
        if payload is None and (index == 0 or last):
            which = "the first sample after refresh()" if last else "the first sample"
            raise _Fault(f"encode must send {which}; it returned None")
        if payload is not None:
            decoder.decode(t_us, payload)
        _check_applied(decoder.reconstruct(t_us, position, t_us), axes)


def _check_payload(payload: Any) -> None:
    if payload is not None and type(payload) is not bytes:
        raise _Fault(f"encode returned {short(payload)}; it must return bytes or None")
    if payload is not None and len(payload) > LARGEST_PAYLOAD:
        raise _Fault(f"encode returned {len(payload)} bytes; a payload has at most {LARGEST_PAYLOAD}")


def _check_applied(applied: Any, axes: int) -> None:
    good = type(applied) is tuple and len(applied) == axes
    if not good or not all(isinstance(each, (int, float)) and math.isfinite(each) for each in applied):
        raise _Fault(f"reconstruct returned {short(applied)}; it must return {axes} finite floats as a tuple")


def _guarded(found: type[Any], source: str) -> type[Any]:
    """Return a subclass whose exceptions are errors of hapticnet.

    Its attributes `source` and `origin` name where the class is defined: as the user wrote it, and as a file or module;
    `inner` is the class itself.
    """
    file = getattr(sys.modules.get(found.__module__), "__file__", None)
    origin = f"{Path(file).resolve() if file else found.__module__}:{found.__qualname__}"

    def encoder(self: Any, axes: int) -> Encoder:
        return _Encoder(started(super(made, self).encoder, axes), source)

    def decoder(self: Any, axes: int) -> Decoder:
        inner = started(super(made, self).decoder, axes)
        return (_Predictive if isinstance(inner, Predictive) else _Decoder)(inner, axes, source)

    def started(method: Any, axes: int) -> Any:
        try:
            return method(axes)
        except BaseException as error:
            raise SettingsError(f"codec {source}: {method.__name__}({axes}) raised {raised(error)}") from error

    scope = {"__doc__": found.__doc__, "__module__": found.__module__, "encoder": encoder, "decoder": decoder}
    names = {"source": source, "origin": origin, "inner": found}
    made: type[Any] = type(found.__name__, (found,), {**scope, **names})
    return made


class _Encoder:
    """The encoder of a user. Satisfies `Encoder`."""

    __slots__ = ("_encode", "_refresh", "_source")

    def __init__(self, inner: Encoder, source: str) -> None:
        self._encode, self._refresh, self._source = inner.encode, inner.refresh, source

    def encode(self, t_us: int, stimulus: Vector, position: Vector | None = None) -> bytes | None:
        """Return the payload or None; exceptions of the user's encoder become a SampleError."""
        try:
            payload = self._encode(t_us, stimulus, position)
            _check_payload(payload)
        except SampleError:
            raise
        except BaseException as error:
            raise SampleError(f"codec {self._source}: encode failed: {raised(error)}") from error
        return payload

    def refresh(self) -> None:
        """Transmit the next stimulus; exceptions of the user's encoder become a SampleError."""
        try:
            self._refresh()
        except BaseException as error:
            raise SampleError(f"codec {self._source}: refresh failed: {raised(error)}") from error


class _Decoder:
    """The decoder of a user; its results are checked, because they go to a device. Satisfies `Decoder`."""

    __slots__ = ("_axes", "_checked", "_decode", "_inner", "_reconstruct", "_source")

    def __init__(self, inner: Any, axes: int, source: str) -> None:
        self._decode, self._reconstruct, self._source = inner.decode, inner.reconstruct, source
        self._axes, self._inner = axes, inner
        self._checked: Vector | None = None

    def decode(self, t_us: int, payload: bytes) -> None:
        """Process a payload; exceptions of the user's decoder become a PeerError."""
        try:
            self._decode(t_us, payload)
        except PeerError:
            raise
        except BaseException as error:
            raise PeerError(f"codec {self._source}: decode failed: {raised(error)}") from error

    def reconstruct(self, t_us: int, position: Vector | None = None, position_us: int | None = None) -> Vector:
        """Return the stimulus to apply; exceptions of the user's decoder become a SampleError."""
        try:
            applied: Vector = self._reconstruct(t_us, position, position_us)
            if applied is not self._checked:  # a hold returns the same tuple again and again
                _check_applied(applied, self._axes)
                self._checked = applied
        except SampleError:
            raise
        except BaseException as error:
            raise SampleError(f"codec {self._source}: reconstruct failed: {raised(error)}") from error
        return applied


class _Predictive(_Decoder):
    """The decoder of a user that can predict. Satisfies `Predictive`."""

    __slots__ = ()

    def predict(self, t_us: int, position: Vector, position_us: int) -> Vector:
        """Return the stimulus to apply at a future time; exceptions of the user's decoder become a SampleError."""
        try:
            applied: Vector = self._inner.predict(t_us, position, position_us)
            _check_applied(applied, self._axes)
        except SampleError:
            raise
        except BaseException as error:
            raise SampleError(f"codec {self._source}: predict failed: {raised(error)}") from error
        return applied
