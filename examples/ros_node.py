"""A ROS 2 node: positions and forces on topics. python3 examples/ros_node.py --ros-args -p slave:=host:47800."""

import rclpy
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.node import Node

import hapticnet as hn


class Touch(Node):
    """Pass /tool (PointStamped, m) to a slave, and the force to /touch (WrenchStamped, N)."""

    def __init__(self) -> None:
        super().__init__("hapticnet")
        slave = self.declare_parameter("slave", "127.0.0.1:47800").value
        self.master = hn.TickedMaster(slave, rate_hz=500.0, start=(0.0, 0.0, 0.0), name=self.get_name())
        self.forces = self.create_publisher(WrenchStamped, "touch", 10)
        self.create_subscription(PointStamped, "tool", self.on_tool, 10)
        self.create_timer(1.0 / 500.0, self.on_timer)

    def on_tool(self, message: PointStamped) -> None:
        """Keep the newest position."""
        self.master.position = (message.point.x, message.point.y, message.point.z)

    def on_timer(self) -> None:
        """Exchange datagrams without waiting, and publish the force."""
        message = WrenchStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        force = message.wrench.force
        force.x, force.y, force.z = (-each for each in self.master.tick())  # positive along the axes, as in ROS
        self.forces.publish(message)
        for event in self.master.take_events():
            self.get_logger().info(str(event))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Touch())
