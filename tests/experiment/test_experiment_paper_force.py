import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.errors import SettingsError
from hapticnet.experiment.paper_force import paper_recording
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

ONCE = InsertionSettings(insertions=1)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others():
    one, again, other = (paper_recording(seed, 500.0, motion=ONCE) for seed in (3, 3, 4))
    assert one.force_n.tobytes() == again.force_n.tobytes()
    assert one.position_m.tobytes() == again.position_m.tobytes()
    assert one.force_n.tobytes() != other.force_n.tobytes()


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_recording_breaches_every_tissue_at_its_force(rate_hz):
    recording = paper_recording(1, rate_hz, insertions=2)
    assert recording.force_n.shape == recording.position_m.shape == (*recording.t_us.shape, 1)
    assert (np.diff(recording.t_us) == 1e6 / rate_hz).all()
    assert recording.t_us[0] == 1e6 / rate_hz
    assert recording.breaches[-1] == 6
    assert 4.5 < recording.force_n.max() <= 5.0
    assert (recording.position_m == recording.position_m.astype(np.float32)).all()


def test_it_is_what_the_slave_records_over_a_perfect_channel():
    seed = 2
    expected = paper_recording(seed, motion=ONCE)
    channels = [Emulator(parse_channel("perfect"), np.random.default_rng(n)) for n in (1, 2)]
    operator = ScriptedOperator(ONCE, np.random.default_rng(seed))
    loopback = Loopback(
        MasterNode(operator, None, MasterSettings(rate_hz=1000.0, record=True), np.random.default_rng(3)),
        SlaveNode(lambda _: Scene(paper_scene(seed).tissues), SlaveSettings(record=True), np.random.default_rng(4)),
        forward=channels[0],
        feedback=channels[1],
    )
    loopback.run(operator.duration_us)
    (context,) = loopback.slave.contexts
    recorded = context.recording.table()
    assert recorded["t_us"].tolist() == expected.t_us.tolist()
    assert recorded["force_n"].tobytes() == np.ascontiguousarray(expected.force_n[:, 0]).tobytes()
    assert recorded["breaches"].tolist() == expected.breaches.tolist()


@pytest.mark.parametrize("rate_hz", [0.0, 0.01, -1.0, float("nan"), 2e6])
def test_a_rate_that_cannot_be_is_refused(rate_hz):
    with pytest.raises(SettingsError, match="rate is"):
        paper_recording(1, rate_hz, motion=ONCE)


def test_a_seed_that_cannot_be_is_refused():
    with pytest.raises(SettingsError, match="seed of the paper's scene is -1"):
        paper_recording(-1)
