"""A fake exoskeleton: a ROS 2 node that walks, with what a small robot of one's own publishes and obeys.

    /exo/encoder    sensor_msgs/JointState, 200 Hz: `knee_motor`, whose position falls in flexion
    /exo/insole     geometry_msgs/Vector3Stamped, 200 Hz: the force under the foot, z up [N]
    knee_effort_controller/commands    std_msgs/Float64MultiArray, in: the torque of the knee's motor [N m]

Nobody walks: angle and force are sums of simple curves, at 1.1 s a stride, which a real robot replaces by its sensors.
The torque is only printed. `docs/tutorials/your-robot.md` takes it from here.

    python examples/fake_exoskeleton.py
"""

from __future__ import annotations

import math
import signal

import rclpy
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

RATE = 200.0
"""[Hz] of both sensors"""
STRIDE, STANCE = 1.1, 0.62
"""[s] of a stride, and the part of it in which the foot is on the ground"""
WEIGHT = 737.0
"""[N] of the person"""
MOUNTED_AT = 0.1
"""[rad] of the encoder in full extension"""


def hump(time: float, at: float, width: float) -> float:
    """Curve that rises to 1 once a stride, at a part of it, and is that wide; `time` in [s]."""
    apart = (time / STRIDE - at + 0.5) % 1.0 - 0.5
    return math.exp(-((apart / width) ** 2))


def flexion(time: float) -> float:
    """Flexion angle of the knee [rad] at a time [s]: a little in stance, a lot in swing."""
    return 0.08 + 0.22 * hump(time, 0.14, 0.07) + 0.95 * hump(time, 0.76, 0.11)


def ground_force(time: float) -> float:
    """Force of the ground on the foot, upwards [N]: two humps in stance, and 0 in swing."""
    part = time / STRIDE % 1.0 / STANCE
    if part >= 1.0:
        return 0.0
    return WEIGHT * 1.1 * (math.sin(math.pi * part) + 0.3 * math.sin(3.0 * math.pi * part))


class FakeExoskeleton(Node):
    """Sensors and motor of a knee."""

    def __init__(self) -> None:
        super().__init__("fake_exoskeleton")
        self.torque: float | None = None
        self._told = True
        self._encoder = self.create_publisher(JointState, "exo/encoder", qos_profile_sensor_data)
        self._insole = self.create_publisher(Vector3Stamped, "exo/insole", qos_profile_sensor_data)
        self.create_subscription(
            Float64MultiArray, "knee_effort_controller/commands", self._on_command, 10
        )
        self._begin = self.get_clock().now()
        self.create_timer(1.0 / RATE, self._measure)
        self.create_timer(1.0, self._tell)

    def _measure(self) -> None:
        now = self.get_clock().now()
        time = (now - self._begin).nanoseconds * 1e-9
        encoder = JointState(name=["knee_motor"], position=[MOUNTED_AT - flexion(time)])
        insole = Vector3Stamped(vector=Vector3(x=0.0, y=0.0, z=ground_force(time)))
        encoder.header.stamp = insole.header.stamp = now.to_msg()
        self._encoder.publish(encoder)
        self._insole.publish(insole)

    def _on_command(self, command: Float64MultiArray) -> None:
        self.torque = command.data[0]

    def _tell(self) -> None:
        """Log the first command, and at the beginning that there is none."""
        if self._told == (self.torque is not None):
            return
        self._told = self.torque is not None
        torque = f"the motor is told {self.torque:.1f} N m" if self._told else "no command"
        self.get_logger().info(f"walking; {torque}")


def main() -> None:
    """Walk until SIGINT or SIGTERM."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = FakeExoskeleton()
    executor = SingleThreadedExecutor()
    stopped = list[int]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopped.append(number))
    executor.add_node(node)
    while not stopped:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
