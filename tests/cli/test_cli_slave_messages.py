"""What a slave says of HELLOs that it drops without an answer: somebody may be writing a peer."""

from types import SimpleNamespace

import msgpack
import numpy as np

from hapticnet.cli.slave import MOST_UNREAD, SlaveMessages
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.wire import Kind, pack
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene


def make():
    node = SlaveNode(lambda _: Scene(paper_scene(1).tissues), SlaveSettings(), np.random.default_rng(1))
    warned = []
    console = SimpleNamespace(warn=warned.append, status=lambda _: None)
    return node, warned, SlaveMessages(console, node, None)


def hello(*fields, padding=400):
    return pack(Kind.HELLO, 0, 0, msgpack.packb([*fields, bytes(padding)]))


def test_a_hello_that_is_too_short_is_told_once():
    node, warned, messages = make()
    for _ in range(3):
        node.receive_datagram(hello(1, b"", b"", b"", padding=80), ("10.0.0.7", 5000), 0)
        messages.check(0)
    (line,) = warned
    assert line == "a HELLO from 10.0.0.7:5000 was dropped: HELLO of 97 bytes; pad it to at least 400"


def test_strangers_cannot_fill_the_log():
    node, warned, messages = make()
    for number in range(100):
        node.receive_datagram(hello(f"\n{number}" + 300 * "x"), ("10.0.0.7", 5000), 0)
        node.receive_datagram(hello(1, b"", b"", b"", padding=number), ("10.0.0.7", 5000), 0)
        messages.check(0)
    assert len(warned) == MOST_UNREAD
    assert all(line.isprintable() and len(line) < 300 for line in warned)
