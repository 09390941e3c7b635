"""Which session goes on with whose scene, when several masters of one identity come and go."""

import struct

import numpy as np
import pytest

from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.master_session import MasterSession
from hapticnet.protocol.messages import Request
from hapticnet.protocol.settings import SessionSettings
from hapticnet.protocol.states import Connected, SessionLost
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import find_scene, find_source


class Laboratory:
    """A slave of open sessions, and masters on one host that have the same name."""

    def __init__(self, make_scene=None):
        preset = find_scene("paper:1")
        self.now_us = 1_000_000
        self.rng = np.random.default_rng(1)
        self.slave = SlaveNode(
            make_scene or (lambda _: Scene(preset.tissues, name=preset.name)),
            SlaveSettings(),
            self.rng,
            host_of=lambda address: address[0],
        )
        self.masters = {}
        self.events = {}

    def start(self, port):
        request = Request("deadband", {}, 0.1, 0.02, 1.0, 1000.0, 1, "master")
        self.masters[port] = MasterSession(request, SessionSettings(), self.rng)
        self.events[port] = []

    def exchange(self, port, *, position=True):
        """Let a master do what is due, and pass everything on without delay."""
        master = self.masters[port]
        master.tick(self.now_us)
        if position:
            master.send_position(self.now_us, struct.pack(">f", 0.001))
        while sent := master.datagrams_to_send():
            for data in sent:
                self.slave.receive_datagram(data, ("lab", port), self.now_us)
            for data, (_, to) in self.slave.datagrams_to_send():
                self.masters[to].receive_datagram(data, self.now_us)
        while (event := master.next_event()) is not None:
            self.events[port].append(event)

    def run(self, milliseconds, *ports):
        for _ in range(milliseconds):
            self.now_us += 1000
            for port in ports:
                self.exchange(port)

    def scene_of(self, port):
        (context,) = (each for each in self.slave.contexts if each.address == ("lab", port))
        return context.scene


@pytest.fixture
def laboratory():
    made = Laboratory()
    made.start(1)
    made.run(50, 1)
    return made


def test_a_restarted_master_gets_the_scene_of_its_silent_session(laboratory):
    scene = laboratory.scene_of(1)
    laboratory.run(300)
    laboratory.start(2)
    laboratory.run(50, 2)
    assert laboratory.scene_of(2) is scene
    assert len(laboratory.slave.contexts) == 1


def test_a_second_master_of_the_same_name_beside_a_working_one_gets_a_scene_of_its_own(laboratory):
    laboratory.start(2)
    laboratory.run(50, 1, 2)
    assert laboratory.scene_of(2) is not laboratory.scene_of(1)


def test_a_master_that_was_silent_and_works_again_keeps_its_scene(laboratory):
    scene = laboratory.scene_of(1)
    laboratory.run(300)
    laboratory.start(2)
    laboratory.exchange(2, position=False)  # half open, to continue the silent session
    laboratory.run(50, 1)  # which is heard of again
    laboratory.run(50, 1, 2)
    assert laboratory.scene_of(1) is scene
    assert laboratory.scene_of(2) is not scene
    assert [type(event) for event in laboratory.events[2]] == [Connected, SessionLost, Connected]
    assert [type(event) for event in laboratory.events[1]].count(SessionLost) == 0


def test_of_two_that_are_to_continue_one_scene_only_the_first_does(laboratory):
    scene = laboratory.scene_of(1)
    laboratory.run(300)
    for port in (2, 3):
        laboratory.start(port)
        laboratory.exchange(port, position=False)
    laboratory.run(200, 2, 3)
    assert laboratory.scene_of(2) is scene
    assert laboratory.scene_of(3) is not scene


def test_masters_touch_a_shared_object_at_the_same_time(tmp_path):
    rig = tmp_path / "rig.py"
    rig.write_text("class Wall:\n    shared = True\n\n    def step(self, sample):\n        return 0.0\n")
    source = find_source(f"{rig}:Wall")
    lab = Laboratory(lambda _: source.make())
    for port in (1, 2):
        lab.start(port)
    for _ in range(3_000):
        for port in (1, 2):
            lab.exchange(port)
        lab.now_us += 1_000
    assert not any(isinstance(event, SessionLost) for port in (1, 2) for event in lab.events[port])
    one, other = lab.slave.contexts
    assert one.scene.touched is other.scene.touched
    assert source.close() == []
