import lerobot_interface  # noqa: F401 - stands for lerobot where that is not installed; must come first
import pytest
from plugin_helpers import HANDS, simulated

import hapticnet as hn
from lerobot_robot_hapticnet import Follower


@pytest.fixture(autouse=True)
def _own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    HANDS.clear()


@pytest.fixture
def beside(tmp_path):
    """A slave beside a simulated robot."""
    robot = simulated(tmp_path)
    scene = Follower(robot, units_per_m=1000.0)
    with hn.ThreadedSlave(scene, listen="127.0.0.1:0") as slave:
        yield slave, robot, scene
    scene.close()
