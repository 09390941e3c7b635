"""The golden vectors of tests/vectors, and constants: one source for Python, C and the documents."""

import ctypes
import json
import re
import struct
import subprocess
import sys
import unicodedata

import msgpack
import pytest

import peer

VECTORS = peer.HERE.parents[1] / "tests" / "vectors"
PROTOCOL = {each["name"]: each for each in json.loads((VECTORS / "protocol.json").read_text())["datagrams"]}
TRACES = json.loads((VECTORS / "traces.json").read_text())
MODELS = json.loads((VECTORS / "models.json").read_text())
LAW_KEYS = "weber_fraction", "floor_n", "multiplier"
LIMIT = 1200
NOT_WRITTEN = re.compile("vibration|parts|notice of a shape")  # what the library never asks for


def law_of(case):
    return {name: case[name] for name in LAW_KEYS}


def bits(vector):
    return [(float(component) + 0.0).hex() for component in vector]  # but for the sign of zero


def test_the_constants_are_those_of_hapticnet():
    """After a change: make -C peers/c constants PYTHON=$PWD/.venv/bin/python."""
    made = subprocess.run([sys.executable, peer.HERE / "make_constants.py"], capture_output=True, text=True, check=True)
    assert (peer.HERE / "include" / "hapticnet_constants.h").read_text() == made.stdout


@pytest.mark.parametrize("name", [name for name in PROTOCOL if not NOT_WRITTEN.search(name)])
def test_each_datagram_is_read_and_written_again_to_the_byte(lib, name):
    data, out = bytes.fromhex(PROTOCOL[name]["hex"]), ctypes.create_string_buffer(LIMIT)
    size = lib.shim_repack(data, ctypes.c_size_t(len(data)), out)
    assert out.raw[:size].hex() == data.hex()


@pytest.mark.parametrize("case", MODELS["models"], ids=lambda case: case["name"])
def test_models_of_the_contact_ahead_press_as_the_vectors_say(lib, case):
    path, begins = case["path"], case["begins"]
    axes, payload, force = len(path[0][1]), bytes.fromhex(case["payload"]), peer.vector([])
    model = peer.state(lib, b"model")
    assert lib.shim_read_model(model, payload, ctypes.c_size_t(len(payload)), axes)
    before = path[begins - 1] if begins else None
    for index, (t_us, place) in enumerate(path[begins:]):
        was = (ctypes.c_int64(before[0]), peer.vector(before[1])) if before and not index else (ctypes.c_int64(0), None)
        lib.shim_model(model, index == 0, ctypes.c_int64(t_us), peer.vector(place), *was, force)
        assert list(force[:axes]) == pytest.approx(case["forces"][index], rel=1e-6, abs=1e-12)


def test_a_vibration_that_nobody_asked_for_is_stray(lib):
    master = OpenMaster(lib).master
    master.receive_datagram(bytes.fromhex(PROTOCOL["vibration"]["hex"]), 1000)
    assert master.counts == (0, 1, 0)


class OpenMaster:
    """A master with the session 0xdeadbeef of the vectors, whose WELCOME had sequence 0 and arrived at 0 us."""

    def __init__(self, lib, *, codec="deadband", grant=None, more=None, **law):
        given = (more or {}) | ({"law": law} if law else {})
        self.master = peer.Master(lib, lambda: 0x01020304, lambda _: self.place, codec=codec, **given)
        self.place = (0.0,)
        self.master.tick(0)
        (self.hello,) = self.master.datagrams_to_send()
        welcome = bytes.fromhex(PROTOCOL["welcome"]["hex"])
        if grant is not None:
            body = msgpack.packb([0x01020304, grant])
            welcome = msgpack.packb([*msgpack.unpackb(welcome)[:4], body])
        self.master.receive_datagram(welcome, 0)


@pytest.mark.parametrize("trace", TRACES["traces"], ids=lambda trace: trace["name"])
def test_the_master_acknowledges_and_decodes_as_the_traces_say(lib, trace):
    opened = OpenMaster(lib, codec=trace["codec"], **law_of(trace))
    received = ctypes.c_double()
    for tick in trace["ticks"]:
        opened.place = tick["position_m"]
        opened.master.tick(tick["now_us"])
        (position,) = opened.master.datagrams_to_send()
        t_us, newest, payload, *_ = msgpack.unpackb(msgpack.unpackb(position)[4])
        assert (t_us, newest) == (tick["now_us"], tick["newest"])
        assert payload == struct.pack(">f", *tick["position_m"])
        for each in tick["arrives"]:
            opened.master.receive_datagram(bytes.fromhex(each["hex"]), tick["now_us"])
        lib.shim_received(opened.master.pointer, ctypes.c_int64(tick["now_us"]), ctypes.byref(received))
        assert bits([received.value]) == bits(tick["stimulus_n"])


def test_texts_are_those_that_hapticnet_prints(lib):
    hidden = {"Cc", "Cf", "Cs", "Co", "Zl", "Zp", "Zs"}
    for code in range(0x110000):
        text, category = chr(code), unicodedata.category(chr(code))
        data = text.encode("utf-8", "surrogatepass")
        if category != "Cn":  # which code points exist depends on the version of Unicode
            assert lib.shim_is_text(data, ctypes.c_size_t(len(data))) == (category not in hidden or text == " "), hex(
                code
            )
    for broken in (b"\xc0\x80", b"\x80", b"\xe0\x80\x80", b"\xf4\x90\x80\x80", b"\xff", b"\xc3", b"\xf0\x9f\x98"):
        assert not lib.shim_is_text(broken, ctypes.c_size_t(len(broken)))
