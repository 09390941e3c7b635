"""Robots and leaders of ROS 2, over DDS and without ROS.

``hapticnet slave --scene hapticnet_ros2:Robot:namespace=/PSM1,axes=3`` and
``hapticnet master --operator hapticnet_ros2:Leader:namespace=/MTML,axes=3``.
"""

from hapticnet_ros2.leader import Leader
from hapticnet_ros2.robot import Robot

__all__ = ["Leader", "Robot"]
