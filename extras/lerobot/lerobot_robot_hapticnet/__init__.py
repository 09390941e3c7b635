"""LeRobot over hapticnet: a Robot at another place and a Teleoperator that feels it, and the scene at the robot.

LeRobot imports this module by itself and then knows ``--robot.type=hapticnet`` and ``--teleop.type=hapticnet``. Beside
the robot runs ``hapticnet slave --scene lerobot_robot_hapticnet:Follower:type=so101_follower,port=…``.
"""

from lerobot_robot_hapticnet.config import HapticnetRobotConfig, HapticnetTeleoperatorConfig
from lerobot_robot_hapticnet.follower import Follower
from lerobot_robot_hapticnet.robot import HapticnetRobot
from lerobot_robot_hapticnet.simulated import HapticnetSimulated, HapticnetSimulatedConfig
from lerobot_robot_hapticnet.teleoperator import HapticnetTeleoperator

__all__ = [
    "Follower",
    "HapticnetRobot",
    "HapticnetRobotConfig",
    "HapticnetSimulated",
    "HapticnetSimulatedConfig",
    "HapticnetTeleoperator",
    "HapticnetTeleoperatorConfig",
]
