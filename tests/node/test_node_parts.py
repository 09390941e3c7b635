"""Pose and wrench, grip and several fingers over an emulated network."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.cli.master import in_words
from hapticnet.control.couplings import EnergyBounded
from hapticnet.control.ports import Port
from hapticnet.device.user import UserActuator
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment.analysis import matched
from hapticnet.node.coupled import MasterCoupling, PartsEnd, ports_of_parts
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.base import UserOperator
from hapticnet.parts import LEVER_M, PartsLaw, parse_parts
from hapticnet.perception import WeberLaw
from hapticnet.rotations import inverse, product, quaternion_of, vector_near
from hapticnet.scene.base import UserScene
from hapticnet.vectors import dot
from hapticnet.web.ticks import Ticks

POSE = ("force:3", "torque:3", "grip:1")
LOSSY = "delay=10ms,jitter=uniform:3ms,loss=5%"


class Knob:
    """A knob to press, turn and squeeze: a spring in each part."""

    parts = POSE

    def step(self, sample):
        x = sample.position_m
        return (400.0 * max(x[0], 0.0), 0.0, 0.0, 0.0, 0.0, 0.3 * x[5], -300.0 * max(0.04 - x[6], 0.0))

    def copy(self):
        return Knob()


class Turning:
    """A hand that presses, turns and squeezes, slowly enough to follow."""

    parts = POSE

    def __init__(self):
        self.felt = []

    def sample(self, t_us):
        t = 1e-6 * t_us
        press, turn, squeeze = (math.sin(rate * t) for rate in (1.1, 1.7, 0.9))
        return (0.01 * press, 0.0, 0.0, 0.0, 0.0, 0.6 * turn, 0.04 + 0.01 * squeeze)

    def feel(self, _, force):
        self.felt.append(force)


def run(seconds=6.0, **settings):
    hand = Turning()
    link = hn.virtual_link(scene=Knob(), operator=hand, **settings)
    link.run(seconds=seconds)
    return link, hand


def test_without_delay_every_part_is_felt_within_its_jnd():
    link, hand = run()
    report = link.report()
    assert list(report.felt_parts) == ["force", "torque", "grip"]
    for part, felt in report.felt_parts.items():
        assert felt.exceed_jnd_fraction <= 0.03, part  # a force arrives a tick after its position
        assert felt.above_2_jnd_fraction == 0.0, part
        assert report.slave["parts"][part]["exceed_jnd_fraction"] == 0.0
    assert report.packet_rate_reduction > 0.9
    largest = np.abs(hand.felt).max(axis=0)
    assert largest[[1, 2, 3, 4]].max() == 0.0
    assert largest[[0, 5, 6]] == pytest.approx([4.0, 0.18, 3.0], rel=0.06)


@pytest.mark.parametrize("codec", ["deadband", "motion-predictive", "adaptive-predictive"])
def test_a_lost_update_of_one_part_is_repaired(codec):
    link, _ = run(codec=codec, forward=LOSSY, feedback=LOSSY)
    slave, master = link.slave_samples(), link.master_samples()
    at_slave, at_master = matched(slave, master)
    late = 25  # ticks of delay, jitter and repair; the hand moves 1 % in them
    for column in ("force_x_n", "torque_z_nm", "grip_n"):
        held = master["held_x_n" if column == "force_x_n" else f"held_{column}"][at_master]
        true = slave[column][at_slave]
        assert np.abs(held[late:] - true[:-late]).max() < 0.25 * np.abs(true).max()


def test_copies_of_a_scene_answer_for_the_place_of_every_part():
    link, _ = run(codec="raw", predicted=True, forward="delay=20ms", feedback="delay=20ms", seconds=12.0)
    ahead = link.report().felt_parts
    link, _ = run(codec="raw", forward="delay=20ms", feedback="delay=20ms", seconds=12.0)
    behind = link.report().felt_parts
    for part in ahead:
        assert ahead[part].rmse_n < 0.3 * behind[part].rmse_n


def test_when_the_link_falls_silent_every_part_decays_to_zero():
    link, hand = run(seconds=1.0)
    assert any(hand.felt[-1])
    link._loopback.feedback = link._loopback.forward = Silent()
    link.run(seconds=0.5)
    assert hand.felt[-1] == (0.0,) * 7


class Silent:
    """A channel on which nothing arrives."""

    def push(self, item, size_bytes, now_us):
        pass

    def due(self, _):
        return []

    def next_timer_us(self):
        return None


def test_each_part_is_passive_with_a_coupling_at_its_own_port():
    link, _ = run(coupling="energy-bounded", codec="raw", forward="delay=60ms", feedback="delay=60ms", seconds=10.0)
    master = link.master_samples()
    for held, place, lever in (
        ("held_x_n", "position_x_m", 1.0),
        ("held_torque_z_nm", "rotation_z_rad", LEVER_M),
        ("held_grip_n", "opening_m", 1.0),
    ):
        moves = np.diff(master[place])
        work_j = np.cumsum(master[held][:-1] * moves)
        absorbed_j = np.cumsum(EnergyBounded().damping * (lever * moves) ** 2 / 1e-3)  # by hand and device
        assert min(work_j + absorbed_j) > -5e-3  # the allowance of each contact [J]
    assert set(link.report().master["coupling"]) == {"name", "force", "torque", "grip"}


def test_no_coupling_exceeds_the_largest_force_of_the_device_in_a_part(monkeypatch):
    class Loud:
        name = "loud"
        held_back = 0

        def master(self, _port):
            return self

        def limit(self, force_n, *_, **__):
            return (50.0, *force_n[1:])

    monkeypatch.setattr("hapticnet.node.coupled.parse_coupling", lambda _: Loud())
    law = PartsLaw.of(parse_parts(POSE), WeberLaw())
    coupling = MasterCoupling(MasterSettings(), law, UserOperator(Turning()), 1000, 3.0)
    limited = coupling.limit((0.0,) * 7, (0.0,) * 7, 0, follows=False)
    assert limited == (3.0, 0.0, 0.0, pytest.approx(5.0), 0.0, 0.0, 50.0)


def test_a_scene_with_other_parts_refuses_and_names_both():
    class Rod(Knob):
        parts = ("force:3", "torque:3")

        def step(self, _):
            return (0.0,) * 6

    link = hn.virtual_link(scene=Rod(), operator=Turning())
    link.run(seconds=0.5)
    with pytest.raises(UnavailableError):
        link.report()
    assert link._loopback.master.refused
    assert link._loopback.master.end_reason.endswith(
        "the master has the parts force:3 torque:3 grip:1; scene 'Rod' has force:3 torque:3"
    )


def test_what_is_for_one_part_only_and_a_scene_without_a_hand_are_refused_at_once():
    with pytest.raises(SettingsError, match="for one part only"):
        hn.virtual_link(scene=Knob(), operator=Turning(), coupling="wave-variables")
    with pytest.raises(SettingsError, match="a model of what is touched, which is for one part only"):
        hn.virtual_link(scene=Knob(), operator=Turning(), codec="model-mediated")
    with pytest.raises(SettingsError, match="give an operator"):
        hn.virtual_link(scene=Knob())


def test_the_persons_own_thresholds_are_those_of_the_slave():
    link, _ = run(part_laws={"torque": (0.5, 0.1)}, seconds=3.0)
    coarse = link.report().sent
    assert coarse < run(seconds=3.0)[0].report().sent
    link._loopback.master.change(law=hn.WeberLaw(multiplier=2.0))
    link.run(seconds=3.0)
    assert link.report().slave["multiplier"] == 2.0
    assert [law.threshold_n(0.0) for law in link._loopback.slave.contexts[-1].codec.law.laws] == pytest.approx(
        [0.05, 0.2, 0.35]
    )


def test_several_fingers_have_a_force_and_a_position_each():
    class Pinch:
        parts = ("force:1@thumb", "force:1@index")

        def step(self, sample):
            thumb, index = sample.position_m
            return (200.0 * max(thumb, 0.0), 600.0 * max(index, 0.0))

    class Fingers:
        parts = Pinch.parts

        def sample(self, t_us):
            return (0.01 * math.sin(1e-6 * t_us), 0.01 * math.sin(2e-6 * t_us))

    link = hn.virtual_link(scene=Pinch(), operator=Fingers())
    link.run(seconds=4.0)
    table = link.slave_samples()
    assert table["thumb_force_n"].max() == pytest.approx(2.0, rel=0.01)
    assert table["index_force_n"].max() == pytest.approx(6.0, rel=0.01)
    assert {"thumb_position_m", "index_position_m", "thumb_held_n", "index_held_n"} <= set(table)


def test_a_device_renders_the_first_part_and_a_page_shows_it():
    pressed = []
    device = UserActuator(SimpleNamespace(apply=lambda force_n, _: pressed.append(force_n)))
    settings = MasterSettings(device_takes="norm")
    master = MasterNode(UserOperator(Turning()), device, settings, np.random.default_rng(1))
    slave = SlaveNode(lambda _: UserScene(Knob()), SlaveSettings(), np.random.default_rng(2))
    ticks = Ticks(master, 0)
    forward, feedback = (Emulator(parse_channel("perfect"), np.random.default_rng(3)) for _ in range(2))
    loopback = Loopback(master, slave, forward=forward, feedback=feedback)
    for _ in range(2000):
        loopback.run(1000)
        ticks.add(loopback.now_us)
    assert pressed[-1] == pytest.approx(abs(master.held_n[0]))
    assert max(pressed) > 3.0
    assert master.held_n[5] != 0.0
    assert ticks._rows[-1][3] == pytest.approx(abs(master.held_n[0]))


def test_the_person_is_told_where_the_axes_of_a_scene_point():
    class Table(Knob):
        frame = "x away from you, z up"

    link = hn.virtual_link(scene=Table(), operator=Turning())
    link.run(seconds=0.1)
    connected = link._loopback.master.next_event()
    assert connected.grant.frame == "x away from you, z up"
    assert "scene Table (x away from you, z up), 1000 Hz" in in_words(connected, link._loopback.master, "here")
    with pytest.raises(SettingsError, match="frame is 3; it must be text"):
        UserScene(SimpleNamespace(step=lambda _: 0.0, frame=3))


@pytest.mark.parametrize("away_rad", [0.3, 1.0, 2.0])
def test_a_torque_is_paid_for_along_the_turn_and_not_along_the_rotation_vector(away_rad):
    law = PartsLaw.of(parse_parts(("force:1", "torque:3")), hn.WeberLaw())
    ports = ports_of_parts(Port(4, law, 1000), law)
    end = PartsEnd(law, [EnergyBounded().master(port) for port in ports])
    given_j = absorbed_j = 0.0
    torque, before = (0.0, 0.0, 0.0), None
    for t_us in range(0, 20_000_000, 1000):  # on a cone, which ends where it began: its rotation vector, not the turn
        angle = 0.5e-6 * t_us
        place = (away_rad * math.cos(angle), away_rad * math.sin(angle), 0.5)
        turn = quaternion_of(place)
        if before is not None:
            moved = vector_near(product(turn, inverse(before)))
            given_j -= dot(torque, moved)
            absorbed_j += EnergyBounded().damping * LEVER_M**2 * dot(moved, moved) / 1e-3
        before = turn
        torque = end.limit((0.0, 0.0, 0.0, -1.0), (0.0, *place), t_us, follows=False)[1:]
    assert given_j - absorbed_j < 5e-3  # the allowance of a contact [J]
