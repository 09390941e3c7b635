"""The force of a scene along the motion of a hand, without a network."""

import numpy as np
import pytest

from hapticnet.channel.emulator import Emulator
from hapticnet.channel.spec import parse_channel
from hapticnet.errors import SettingsError
from hapticnet.experiment.trials import paper_trial
from hapticnet.node.loopback import Loopback
from hapticnet.node.master import MasterNode
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.operator.scripted import InsertionSettings, ScriptedOperator
from hapticnet.scene.scene import Scene
from hapticnet.scene.sources import paper_scene

ONCE = InsertionSettings(insertions=1)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_recording_breaches_every_tissue_at_its_force(rate_hz):
    trial = paper_trial(1, rate_hz, insertions=2)
    assert trial.stimuli.shape == trial.positions.shape == (*trial.t_us.shape, 1)
    assert (np.diff(trial.t_us) == 1e6 / rate_hz).all()
    assert trial.t_us[0] == 1e6 / rate_hz
    assert (np.diff(np.sign(trial.stimuli[:, 0])) < 0).sum() == 6
    assert 4.5 < trial.stimuli.max() <= 5.0
    assert (trial.positions == trial.positions.astype(np.float32)).all()
    assert paper_trial(1, rate_hz, insertions=2).stimuli.tobytes() == trial.stimuli.tobytes()


def test_it_is_what_the_slave_records_over_a_perfect_channel():
    expected = paper_trial(2, motion=ONCE)
    channels = [Emulator(parse_channel("perfect"), np.random.default_rng(n)) for n in (1, 2)]
    operator = ScriptedOperator(ONCE, np.random.default_rng(2))
    loopback = Loopback(
        MasterNode(operator, None, MasterSettings(rate_hz=1000.0, record=True), np.random.default_rng(3)),
        SlaveNode(lambda _: Scene(paper_scene(2).tissues), SlaveSettings(record=True), np.random.default_rng(4)),
        forward=channels[0],
        feedback=channels[1],
    )
    loopback.run(operator.duration_us)
    (context,) = loopback.slave.contexts
    recorded = context.recording.table()
    assert recorded["t_us"].tolist() == expected.t_us.tolist()
    assert recorded["force_n"].tobytes() == np.ascontiguousarray(expected.stimuli[:, 0]).tobytes()
    breached = np.diff(np.sign(recorded["force_n"]), prepend=0.0) < 0.0
    assert recorded["breaches"].tolist() == np.cumsum(breached).tolist(), "each contact ends with a breach"


@pytest.mark.parametrize("rate_hz", [0.0, 0.01, -1.0, float("nan"), 2e6])
def test_a_rate_that_cannot_be_is_refused(rate_hz):
    with pytest.raises(SettingsError, match="rate is"):
        paper_trial(1, rate_hz, motion=ONCE)
    with pytest.raises(SettingsError, match="seed of the paper's scene is -1"):
        paper_trial(-1)
