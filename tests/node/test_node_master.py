"""What a master does with forces that no true slave would send."""

import struct

import numpy as np
import pytest

from hapticnet.codec.registry import make_codec
from hapticnet.device.simulated import PlantSettings, SimulatedDevice
from hapticnet.errors import SettingsError
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.perception import WeberLaw
from hapticnet.protocol.messages import Close, Force, Keepalive
from hapticnet.protocol.wire import Kind
from hapticnet.samples import PositionSample
from tests.peers import GRANT, HandSlave


@pytest.mark.parametrize(
    ("codec", "payload"),
    [("linear-predictive", struct.pack(">ff", 1.0, 5.0)), ("adaptive-predictive", struct.pack(">fe", 1.0, 10.0))],
)
def test_a_line_stays_at_its_end_however_long_no_other_update_comes(codec, payload):
    rng = np.random.default_rng(2)
    master = MasterNode(ScriptedOperator(InsertionSettings(), rng), None, MasterSettings(codec=codec), rng)
    slave = HandSlave(master).connect()
    master.tick(0)
    slave.say(Kind.FORCE, 1, Force(0, payload), 1000)
    for number, now_us in enumerate(range(100_000, (1 << 32) + 10_000_000, 100_000), start=2):
        master.tick(now_us)
        slave.say(Kind.KEEPALIVE, number, Keepalive(now_us & 0xFFFF_FFFF, 1), now_us)
        master.drive(now_us)
        if now_us > 300_000:
            assert master.held_force_n(now_us)[0] == pytest.approx(1.5)


class Steady:
    """A hand that moves at 80 mm/s."""

    axes = 1
    duration_us = None

    def sample(self, t_us):
        return PositionSample(t_us, (80e-9 * t_us,))


@pytest.mark.parametrize("late_us", [0, 80_000])
def test_a_decoder_knows_the_motion_of_the_hand_when_the_first_force_arrives(late_us):
    viscous = bytes([3]) + struct.pack(">ffee", 1.0, 0.0, 0.0, 10.0)  # 1 N, and 10 N·s/m times the velocity
    settings = MasterSettings(codec="motion-predictive", record=True)
    master = MasterNode(Steady(), None, settings, np.random.default_rng(2))
    slave = HandSlave(master).connect()
    decoder = make_codec("motion-predictive", WeberLaw()).decoder(1)
    for now_us in range(0, 200_000, 1000):
        master.tick(now_us)
        if now_us == 50_000 + late_us:
            slave.say(Kind.FORCE, 1, Force(50_000, viscous), now_us)
            decoder.decode(50_000, viscous)
        master.drive(now_us)
        expected_n = decoder.reconstruct(now_us, master.position_m, now_us)
        assert master.received_n == expected_n
    assert expected_n[0] == pytest.approx(1.8, rel=1e-3)


@pytest.mark.parametrize("rate_hz", [20.0, 31.0, 137.0, 333.0, 999.0, 1e5])
def test_a_device_is_driven_at_its_own_rate_and_positions_are_sent_at_the_granted_one(rate_hz):
    device = SimulatedDevice(PlantSettings(), np.random.default_rng(0))
    settings = MasterSettings(record=True)
    master = MasterNode(Steady(), device, settings, np.random.default_rng(2))
    HandSlave(master).connect(grant=GRANT._replace(rate_hz=rate_hz))
    assert master.period_us == 1000
    sent_us = []
    master.datagrams_to_send()
    for now_us in range(0, 190_000, 1000):
        master.tick(now_us)
        sent_us += [now_us for _ in master.datagrams_to_send()]
        master.drive(now_us)
    granted_us = max(1e6 / rate_hz, 1000.0)
    due_us = np.arange(len(sent_us)) * granted_us
    assert len(sent_us) == 1 + int(189_500 // granted_us)
    assert np.abs(sent_us - due_us).max() <= 1000.0, "within a tick of when they are due"
    assert master.report()["rate_hz"] == pytest.approx(min(rate_hz, 1000.0), rel=1e-3)


def test_a_keepalive_of_a_new_session_does_not_confirm_the_force_of_an_earlier_one():
    rng = np.random.default_rng(2)
    master = MasterNode(ScriptedOperator(InsertionSettings(), rng), None, MasterSettings(), rng)
    slave = HandSlave(master).connect()
    master.tick(0)
    slave.say(Kind.FORCE, 1, Force(0, struct.pack(">f", 1.0)), 1000)
    slave.say(Kind.CLOSE, 2, Close("restarts"), 2000)
    master.session.datagrams_to_send()
    slave.connect(200_000)
    for number, now_us in enumerate(range(200_000, 800_000, 10_000), start=1):
        master.tick(now_us)
        slave.say(Kind.KEEPALIVE, number, Keepalive(now_us, None), now_us)
        master.drive(now_us)
    assert master.held_force_n(800_000)[0] == 0.0


@pytest.mark.parametrize("name", ["", " ", "a\nb", "x" * 65])
def test_a_name_that_no_list_could_have_is_refused_and_not_cut_off(name):
    with pytest.raises(SettingsError, match="it must be 1 to 64 printable bytes"):
        MasterSettings(name=name)
