"""The C library as Python objects, by way of tests/shim.c."""

import ctypes
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

HERE = Path(__file__).parents[1]
LIMIT = 1200
STATES = ("connecting", "established", "stale", "closing", "closed")

Law = Mapping[str, float]
LAW: Law = {"weber_fraction": 0.05, "floor_n": 0.025, "multiplier": 1.0}
Entropy = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)


class Counts(ctypes.Structure):
    _fields_ = [("malformed", ctypes.c_uint32), ("stray", ctypes.c_uint32), ("too_old", ctypes.c_uint32)]


class Parameter(ctypes.Structure):
    _fields_ = [("name", ctypes.c_char_p), ("value", ctypes.c_double)]


class Request(ctypes.Structure):
    _fields_ = [
        ("codec", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("parameters", Parameter * 5),
        ("weber_fraction", ctypes.c_double),
        ("floor_n", ctypes.c_double),
        ("multiplier", ctypes.c_double),
        ("rate_hz", ctypes.c_double),
        ("axes", ctypes.c_uint),
        ("position_share", ctypes.c_double),
        ("announced", ctypes.c_bool),
        ("predicted", ctypes.c_bool),
        ("more", ctypes.c_void_p),
    ]


def build(target: str, folder: Path, *more: str) -> Path:
    """Make a target of the library in a folder; return the folder."""
    done = subprocess.run(["make", "-s", "-C", HERE, f"BUILD={folder}", *more, target], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return folder


def load(folder: Path) -> Any:
    """Return the library that was built there."""
    lib = ctypes.CDLL(str(folder / "shim.so"))
    lib.shim_bytes.restype = ctypes.c_size_t
    for name in ("shim_decoder", "shim_decode", "shim_is_text"):
        getattr(lib, name).restype = ctypes.c_bool
    for name in ("shim_read_model", "shim_read_line", "shim_read_bound"):
        getattr(lib, name).restype = ctypes.c_bool
    for name in (
        "hn_master_send",
        "hn_slave_receive",
        "hn_slave_answer",
        "hn_slave_close",
        "shim_repack",
        "hn_more_bytes",
    ):
        getattr(lib, name).restype = ctypes.c_size_t
    for name in (
        "hn_master_init",
        "hn_master_seal",
        "hn_slave_init",
        "hn_slave_seal",
        "hn_master_reason",
        "hn_master_scene",
    ):
        getattr(lib, name).restype = ctypes.c_char_p
    lib.hn_slave_position.restype = ctypes.c_bool
    lib.hn_more_init.restype = ctypes.c_void_p
    lib.hn_master_counts.restype = lib.hn_slave_counts.restype = Counts
    return lib


def vector(values: Sequence[float]) -> Any:
    return (ctypes.c_double * 3)(*values)


def state(lib: Any, what: bytes) -> Any:
    """Return memory for a state, as aligned as an int64 and full of what must not matter."""
    return memory(lib.shim_bytes(what))


def memory(size: int) -> Any:
    words = (size + 7) // 8
    return (ctypes.c_uint64 * words)(*[0xA5A5A5A5A5A5A5A5] * words)


class Decoder:
    """A decoder of the library."""

    def __init__(self, lib: Any, codec: str, parameters: Mapping[str, float], law: Law, axes: int) -> None:
        self._lib, self._axes, self._state = lib, axes, state(lib, b"decoder")
        names = (ctypes.c_char_p * len(parameters))(*(name.encode() for name in parameters))
        values = (ctypes.c_double * len(parameters))(*parameters.values())
        numbers = [ctypes.c_double(law[name]) for name in ("weber_fraction", "floor_n", "multiplier")]
        count = len(parameters)
        self.good = lib.shim_decoder(self._state, codec.encode(), axes, *numbers, count, names, values)

    def decode(self, t_us: int, payload: bytes) -> bool:
        good: bool = self._lib.shim_decode(self._state, ctypes.c_int64(t_us), payload, ctypes.c_size_t(len(payload)))
        return good

    def applied(self, t_us: int, position_m: Sequence[float]) -> list[float]:
        stimulus = vector([])
        self._lib.shim_apply(self._state, ctypes.c_int64(t_us), vector(position_m), stimulus)
        return list(stimulus[: self._axes])


class Master:
    """A master of the library, with the calls of a `MasterNode`."""

    def __init__(
        self,
        lib: Any,
        random32: Callable[[], int],
        hand: Callable[[int], Sequence[float]],
        *,
        codec: str = "deadband",
        parameters: Mapping[str, float] | None = None,
        law: Law = LAW,
        rate_hz: float = 1000.0,
        axes: int = 1,
        name: str = "C",
        position_share: float = 0.0,
        announced: bool = False,
        predicted: bool = False,
    ) -> None:
        self._lib, self._hand, self.axes = lib, hand, axes
        self._state, self._out = state(lib, b"master"), ctypes.create_string_buffer(LIMIT)
        given = (Parameter * 5)(*((key.encode(), value) for key, value in (parameters or {}).items()))
        request = Request(codec.encode(), name.encode(), given, **law, rate_hz=rate_hz, axes=axes)
        request.position_share, request.announced, request.predicted = position_share, announced, predicted
        if size := lib.hn_more_bytes(ctypes.byref(request)):
            self._more = memory(size)
            request.more = lib.hn_more_init(self._more, ctypes.byref(request))
        self._entropy = Entropy(lambda _: random32())
        self.kept = request  # its texts stay where they are
        wrong = lib.hn_master_init(self._state, ctypes.byref(request), self._entropy, None)
        self.wrong = wrong.decode() if wrong is not None else None
        self.period_us = round(1e6 / rate_hz)
        self.held_n = (0.0,) * axes
        self.position_m: tuple[float, ...] | None = None
        self._start_us: int | None = None

    def seal(self, private: bytes, slave_public: bytes, psk: bytes | None) -> bool:
        """Ask for sealed sessions only."""
        self._keys = state(self._lib, b"keys")
        wrong = self._lib.hn_master_seal(self._state, self._keys, private, slave_public, psk)
        return wrong is None

    def tick(self, now_us: int) -> None:
        self.position_m = tuple(self._hand(now_us - (self._start_us or now_us)))
        self._lib.hn_master_tick(self._state, vector(self.position_m), ctypes.c_int64(now_us))

    def drive(self, now_us: int) -> None:
        force_n = vector([])
        self._lib.hn_master_force(self._state, force_n, ctypes.c_int64(now_us))
        self.held_n = tuple(force_n[: self.axes])

    def receive_datagram(self, data: bytes, now_us: int) -> None:
        self._lib.hn_master_receive(self._state, data, ctypes.c_size_t(len(data)), ctypes.c_int64(now_us))
        if self._start_us is None and self.state == "established":
            self._start_us = now_us  # as a script of hapticnet's master starts

    def datagrams_to_send(self) -> list[bytes]:
        sent = []
        while size := self._lib.hn_master_send(self._state, self._out):
            sent.append(self._out.raw[:size])
        return sent

    def close(self, reason: str, now_us: int) -> None:
        self._lib.hn_master_close(self._state, reason.encode(), ctypes.c_int64(now_us))

    @property
    def pointer(self) -> Any:
        return self._state

    @property
    def state(self) -> str:
        return STATES[self._lib.hn_master_state(self._state)]

    @property
    def end_reason(self) -> str | None:
        return self.reason[0] if self.state == "closed" else None

    @property
    def reason(self) -> tuple[str, int]:
        code = ctypes.c_uint()
        return self._lib.hn_master_reason(self._state, ctypes.byref(code)).decode(), code.value

    @property
    def scene_name(self) -> str:
        name: str = self._lib.hn_master_scene(self._state).decode()
        return name

    @property
    def counts(self) -> tuple[int, int, int]:
        counts = self._lib.hn_master_counts(self._state)
        return counts.malformed, counts.stray, counts.too_old


class Slave:
    """A slave of the library with a scene, with the calls of a `SlaveNode` that a `Loopback` needs."""

    def __init__(self, lib: Any, random32: Callable[[], int], scene: Any, name: str = "in C") -> None:
        self._lib, self._scene, self._axes = lib, scene, scene.axes
        self._state, self._out = state(lib, b"slave"), ctypes.create_string_buffer(LIMIT)
        self._entropy, self._name = Entropy(lambda _: random32()), name.encode()
        self._outbox: list[tuple[bytes, Any]] = []
        lib.hn_slave_init(self._state, self._name, scene.axes, self._entropy, None)

    def seal(self, private: bytes, masters: Sequence[tuple[bytes, bytes]]) -> bool:
        """Serve sealed sessions only, of masters by their public key and the key that both share."""
        self._keys, self._listed = state(self._lib, b"slave keys"), b"".join(map(b"".join, masters))
        count = ctypes.c_size_t(len(masters))
        wrong = self._lib.hn_slave_seal(self._state, self._keys, private, self._listed, count)
        return wrong is None

    def receive_datagram(self, data: bytes, address: Any, now_us: int) -> None:
        place, now = repr(address).encode()[:28], ctypes.c_int64(now_us)
        sizes = ctypes.c_size_t(len(data)), ctypes.c_size_t(len(place))
        size = self._lib.hn_slave_receive(self._state, data, sizes[0], place, sizes[1], now, self._out)
        self._send(size, address)
        position_m = vector([])
        if self._lib.hn_slave_position(self._state, position_m):
            force_n = self._scene.step(SimpleNamespace(t_us=0, position_m=tuple(position_m[: self._axes]))).force_n
            self._send(self._lib.hn_slave_answer(self._state, vector(force_n), now, self._out), address)

    def _send(self, size: int, address: Any) -> None:
        if size:
            self._outbox.append((self._out.raw[:size], address))

    def datagrams_to_send(self) -> list[tuple[bytes, Any]]:
        outbox, self._outbox = self._outbox, []
        return outbox

    def next_timer_us(self) -> None:
        """Return None: a slave sends only when it receives."""

    def close(self, reason: str, code: int, address: Any) -> None:
        self._send(self._lib.hn_slave_close(self._state, reason.encode(), ctypes.c_uint(code), self._out), address)

    @property
    def counts(self) -> tuple[int, int, int]:
        counts = self._lib.hn_slave_counts(self._state)
        return counts.malformed, counts.stray, counts.too_old
