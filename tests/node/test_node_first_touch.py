"""The first touch of a finger before a master asks for a session, in virtual time."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.device.simulated import Finger, PlantSettings, SimulatedDevice
from hapticnet.node.fingertip import FingerMet, FingerNotMet
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene


def both(finger: Finger, *, first_touch: bool = True) -> tuple[Loopback, SimulatedDevice]:
    """Return both nodes, and the device of the master."""
    scene = paper_scene(1)
    forward, feedback, plant, nonces, sessions = np.random.default_rng(1).spawn(5)
    operator = ScriptedOperator(InsertionSettings(insertions=1), np.random.default_rng(1))
    device = SimulatedDevice(PlantSettings(finger=finger), plant)
    loopback = Loopback(
        MasterNode(operator, device, MasterSettings(first_touch=first_touch), nonces),
        SlaveNode(lambda _: Scene(scene.tissues, name=scene.name), SlaveSettings(), sessions),
        forward=Emulator(parse_channel("perfect"), forward),
        feedback=Emulator(parse_channel("perfect"), feedback),
    )
    return loopback, device


@pytest.mark.parametrize("stiffness_n_m", [300.0, 1000.0, 3000.0])
def test_a_finger_is_met_before_the_session_with_little_more_than_a_newton(stiffness_n_m: float) -> None:
    loopback, device = both(Finger(stiffness_n_m=stiffness_n_m))
    master, largest_n, met = loopback.master, 0.0, None
    for _ in range(5_000):
        loopback.run(1_000)
        if master.connected:
            break
        largest_n = max(largest_n, device.contact_force_n)
        met = met or next((event for event in iter(master.next_event, None) if isinstance(event, FingerMet)), None)
    assert master.connected
    assert met is not None
    assert met.contact_m == pytest.approx(0.002, abs=0.0004)
    assert met.stiffness_n_m == pytest.approx(stiffness_n_m, rel=0.35)
    assert 0.8 <= largest_n <= 2.2  # the search meets a stiff finger with 2 N, as without a first touch
    assert device.contact_force_n == 0.0


def test_without_a_finger_the_session_comes_all_the_same() -> None:
    loopback, _ = both(Finger(contact_m=0.5))
    loopback.run(7_000_000)
    assert loopback.master.connected
    events = list(iter(loopback.master.next_event, None))
    assert any(isinstance(event, FingerNotMet) and "finger" in event.reason for event in events)


def test_a_master_that_is_closed_while_it_touches_ends() -> None:
    loopback, _ = both(Finger())
    loopback.run(300_000)
    assert not loopback.master.connected
    loopback.close()
    assert loopback.master.finished


def test_a_device_that_raises_while_it_touches_ends_the_session() -> None:
    loopback, device = both(Finger())

    def exchange(displacement_m: float, now_us: int) -> None:  # noqa: ARG001
        raise RuntimeError("torn off")

    device.exchange = exchange  # type: ignore[method-assign,assignment]
    loopback.run(100_000)
    assert loopback.master.failure is not None
    assert "torn off" in loopback.master.failure


def test_the_finger_is_found_only_on_request() -> None:
    loopback, device = both(Finger(), first_touch=False)
    loopback.run(200_000)
    assert loopback.master.connected
    assert device.contact_force_n == 0.0
