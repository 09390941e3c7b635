"""MuJoCo models as scenes of hapticnet: ``hapticnet slave --scene hapticnet_mujoco:Scene:model=FILE.xml,tool=BODY``."""

from hapticnet_mujoco.leader import Leader
from hapticnet_mujoco.pose import Pose
from hapticnet_mujoco.scene import Scene
from hapticnet_mujoco.tasks import Task

__all__ = ["Leader", "Pose", "Scene", "Task"]
