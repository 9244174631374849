"""Assist as needed: a ROS 2 node that gives way with an exoskeleton's knee torque while the contact force is large.

    knee_contact  ->  AssistLaw  ->  knee_effort_controller/commands

An example to read and to start from. It is no medical device and protects nobody: whether less assist means less
contact force depends on the person and on the device, and what it goes by is a model's number.

The command is a `std_msgs/Float64MultiArray` with one number [N m], on `<controller>/commands`: that is what the effort
controllers of ros2_control listen to (`effort_controllers/JointGroupEffortController`, or
`forward_command_controller/ForwardCommandController` with the interface `effort`). Remap the topic to your controller.
The number is the size of the assist, >= 0: where the joint's position grows with flexion and the assist extends, a
controller needs it with the other sign. They keep the last command they got, for
ever. So this node ends with a command of 0; but if it is killed or its machine fails, only a watchdog in the drive can
end the torque.

Run it beside the node, or see it at work with `knee-contact demo --companion`:

    python examples/assist_as_needed.py --ros-args --params-file examples/assist_as_needed.yaml
"""

from __future__ import annotations

import math
import signal
import sys
import time
from dataclasses import dataclass, fields

import rclpy
from knee_contact_ros.msg import KneeContact
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, Float64MultiArray

COMMANDS = "knee_effort_controller/commands"
UNTRUSTED = {
    KneeContact.STALE_INPUT: "the node's input was interrupted",
    KneeContact.TIME_RESET: "the stamps went back",
    KneeContact.INPUT_HELD: "the flexion angle was held",
    KneeContact.NOT_CONVERGED: "the model did not meet its tolerance",
    KneeContact.IMPLAUSIBLE: "the depth makes no sense",
    KneeContact.SEVERAL_PUBLISHERS: "another node sends answers, too",
}
"""Status bits of an answer that must not drive a torque: together `KneeContact.UNUSABLE`. One refused sample
(INPUT_REJECTED) is no reason: if all are refused, no answers come, and the time-out sees that."""

OTHERS_TIME = 1.0
"""Time [s] that such an answer counts: those of the other node do not say so"""


# 1. The law: plain numbers in, a torque out. No ROS, no clock: it can be tested, and read, by itself.


@dataclass(frozen=True)
class Settings:
    """What the law goes by: the node's parameters, under the same names."""

    nominal_torque: float = 10.0
    """[N m] the assist when nothing speaks against it"""
    force_limit: float = 1400.0
    """[N] the contact force above which the assist gives way; 1.9 times a body weight of 737 N"""
    release_band: float = 200.0
    """[N] how far below the limit the force must be before the assist returns"""
    fall_rate: float = 200.0
    """[N m/s] how quickly the torque gives way"""
    rise_rate: float = 20.0
    """[N m/s] how quickly it returns"""
    timeout: float = 0.1
    """[s] how old the last answer may be"""
    largest_error: float = 1e-5
    """[m] the largest `error_estimate` to trust"""
    period: float = 0.01
    """[s] between commands while no answers come"""

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            ValueError: a setting is not a positive number, or the band reaches below zero force.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, float) and math.isfinite(value) and value > 0.0):
                raise ValueError(
                    f"{field.name}: {value!r} is not allowed; it should be a number > 0"
                )
        if self.release_band >= self.force_limit:
            raise ValueError(
                f"release_band: {self.release_band:g} is not allowed; it should be below force_limit"
            )


class AssistLaw:
    """Torque from contact force: it gives way quickly, returns slowly, and goes to zero when in doubt."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.torque = 0.0
        """[N m] the last command; the start is as careful as any return"""
        self.yielding = False
        """Whether the force has been above the limit and is not yet below the band"""
        self.doubt = "no answer yet"
        """Why the torque goes to zero; empty if it does not"""
        self._force = math.inf
        self._heard = self._others_heard = -math.inf
        self._doubt_about_answer = ""
        self._commanded: float | None = None
        self._stopped = False

    def hear(self, now: float, contact_force: float, status: int, error_estimate: float) -> None:
        """Take an answer of the node, heard at `now` [s]: contact force [N], status bits, error estimate [m]."""
        if status & KneeContact.SEVERAL_PUBLISHERS:
            self._others_heard = now
        elif now - self._others_heard < OTHERS_TIME:
            status |= KneeContact.SEVERAL_PUBLISHERS
        doubts = [reason for bit, reason in UNTRUSTED.items() if status & bit]
        if not math.isfinite(contact_force):
            doubts.append(f"the contact force is {contact_force}")
        if not error_estimate <= self.settings.largest_error:  # asked so that NaN is too large
            doubts.append(f"the error estimate is {error_estimate:g} m")
        self._heard = now
        self._force = contact_force
        self._doubt_about_answer = ", ".join(doubts)
        if contact_force > self.settings.force_limit:
            self.yielding = True
        elif contact_force < self.settings.force_limit - self.settings.release_band:
            self.yielding = False

    @property
    def usable(self) -> bool:
        """Whether the last answer, as it came, may drive a torque."""
        return math.isfinite(self._heard) and not self._doubt_about_answer

    def stop(self) -> None:
        """From now on go to zero."""
        self._stopped = True

    def command(self, now: float) -> float:
        """The torque [N m] to command at `now` [s], of a clock that never goes back."""
        elapsed = 0.0 if self._commanded is None else now - self._commanded
        self._commanded = now
        self.doubt = self._find_doubt(now)
        if self.doubt or self._force > self.settings.force_limit:
            change = -self.settings.fall_rate * elapsed
        elif self.yielding:
            change = 0.0
        else:  # a command that comes late does not make up for the rise that was missed
            change = self.settings.rise_rate * min(elapsed, self.settings.timeout)
        self.torque = min(max(self.torque + change, 0.0), self.settings.nominal_torque)
        return self.torque

    def _find_doubt(self, now: float) -> str:
        if self._stopped:
            return "asked to stop"
        if now - self._heard > self.settings.timeout:
            return f"no answer for {self.settings.timeout:g} s"
        return self._doubt_about_answer


# 2. The node: hands answers to the law, and its torque to the controller.


class AssistAsNeeded(Node):
    """Subscribes to `knee_contact`; publishes a command at every answer, and every period while none come.

    Beside it `~/usable` (std_msgs/Bool) says whether the command rests on an answer that is trusted.
    """

    def __init__(self) -> None:
        """Declare the parameters and open the topics.

        Raises:
            ValueError: a parameter is not allowed.
        """
        super().__init__("assist_as_needed")
        fixed = ParameterDescriptor(read_only=True)
        names = [field.name for field in fields(Settings)]
        values = {
            name: self.declare_parameter(name, getattr(Settings, name), fixed).value
            for name in names
        }
        self.law = AssistLaw(Settings(**values))
        self._told = ""
        self._publisher = self.create_publisher(Float64MultiArray, COMMANDS, QoSProfile(depth=1))
        self._usable = self.create_publisher(Bool, "~/usable", QoSProfile(depth=1))
        # Only the newest answer counts, so nothing is queued or sent again; this also hears reliable publishers.
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(KneeContact, "knee_contact", self._on_contact, newest)
        # Time-outs go by a clock that nothing can stop or set, unlike simulated time.
        self.create_timer(
            self.law.settings.period, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def finished(self) -> bool:
        """Whether it was asked to stop and has come to zero."""
        return self.law.doubt == "asked to stop" and self.law.torque == 0.0

    def finish(self) -> None:
        """Wait until the last command has arrived."""
        self._publisher.wait_for_all_acked(Duration(seconds=1))

    def _on_contact(self, contact: KneeContact) -> None:
        # Its age counts from now, and not from its stamp, which may be that of a recording.
        self.law.hear(
            time.monotonic(), contact.contact_force, contact.status, contact.error_estimate
        )
        self._publish()

    def _publish(self) -> None:
        torque = self.law.command(time.monotonic())
        self._publisher.publish(Float64MultiArray(data=[torque]))
        self._usable.publish(Bool(data=not self.law.doubt))
        self._tell()

    def _tell(self) -> None:
        """Log what changes."""
        law = self.law
        limit = self.law.settings.force_limit
        state = f"no assist: {law.doubt}" if law.doubt else "assisting"
        if law.yielding and not law.doubt:
            state = f"giving way: the contact force is above {limit:g} N"
        if state != self._told:
            self.get_logger().info(f"{state} ({law.torque:.1f} N m)")
        self._told = state


# 3. Running it until SIGINT or SIGTERM, and to zero after that.


def main() -> int:
    """Run the node; return the exit code."""
    rclpy.init(
        signal_handler_options=SignalHandlerOptions.NO
    )  # for ROS's handlers end it without a last command
    try:
        node = AssistAsNeeded()
    except (ValueError, RuntimeError) as error:  # ROS's own errors are of the latter kind
        print(f"assist_as_needed: {str(error).splitlines()[0]}", file=sys.stderr)
        return 2
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: node.law.stop())
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not node.finished:
        executor.spin_once(timeout_sec=0.1)
    node.finish()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
