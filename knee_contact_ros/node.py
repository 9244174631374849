"""The ROS 2 node `knee_contact`.

Subscribes to `joint_states` (sensor_msgs/JointState) and `joint_reaction_force` (geometry_msgs/WrenchStamped, what the
femur exerts on the tibia, tibia frame). Publishes `knee_contact` (knee_contact_ros/KneeContact) and
`knee_contact/wrench` (geometry_msgs/WrenchStamped), one each per force sample, and `/diagnostics` once a second.
Parameters: `parameters.py`.

It is a managed node: configure reads the parameters and opens the outputs, activate starts the stream. With the
parameter `autostart` (the default) it does both by itself.
"""

from __future__ import annotations

import signal
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from knee_contact_ros.core.model import PLAIN
from knee_contact_ros.errors import UsageError
from knee_contact_ros.graph import joining
from knee_contact_ros.node_parameters import NodeParameters
from knee_contact_ros.parameters import NODE_NAME, check_parameter_file
from knee_contact_ros.session import Session
from knee_contact_ros.topics import INPUTS

SPIN_PERIOD = 0.1
"""How often [s] the main loop looks for a signal to stop."""


class KneeContactNode(LifecycleNode):
    """The managed node: its life cycle; what it does while configured is a `Session`."""

    def __init__(self) -> None:
        """Read and check the parameters.

        Raises:
            UsageError: a parameter is unknown or not allowed.
        """
        super().__init__(
            NODE_NAME, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True
        )
        self.node_parameters = NodeParameters(self)
        self.session: Session | None = None

    def open_session(self) -> None:
        """What configure does.

        Raises:
            UsageError: see `Session`.
        """
        self.session = Session(self, self.node_parameters.read())
        self.node_parameters.fixed = True

    def compile_model(self) -> None:
        """Have the kernel ready before the node is active, so that the first tick is as quick as the others."""
        if self.session and self.session.pipeline.model.kernel is PLAIN:
            self.get_logger().info(
                "making the model ready; the first time on a machine it compiles for some ten seconds"
            )
            self.session.pipeline.compile()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, build the model, open the outputs; a bad parameter leaves the node unconfigured."""
        try:
            if self.session is None:
                self.open_session()
            self.compile_model()
        except UsageError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the stream."""
        if self.session:
            self.session.start()
            topics = " and ".join(self.resolve_topic_name(topic) for topic in INPUTS)
            self.get_logger().info(f"active, listening to {topics}")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the stream; answer what still waits."""
        if self.session:
            self.session.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the outputs; the parameters may change again."""
        self.finish()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and close."""
        self.finish()
        return super().on_shutdown(state)

    def finish(self) -> None:
        """End in whatever state the node is: answer what waits, complete the files."""
        if self.session:
            self.session.stop()
            self.session.close()
            self.session.destroy_publishers()
            self.get_logger().info(f"{self.session.ticks.ticks} ticks, {self.session.pipeline.refused} samples refused")
        self.session = None
        self.node_parameters.fixed = False


class Stop:
    """SIGINT and SIGTERM: noted, or, while the model compiles, an interruption."""

    def __init__(self) -> None:
        self.asked = False
        self.interrupts = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.asked = True
        if self.interrupts:
            raise KeyboardInterrupt


def run_node(arguments: list[str]) -> int:
    """Run the node until SIGINT or SIGTERM; complete its files before returning.

    Raises:
        UsageError: a parameter is unknown or not allowed, an output file cannot be written, or ROS does not let us in.
    """
    for flag, path in pairwise(arguments):
        if flag == "--params-file":
            check_parameter_file(Path(path))
    try:
        rclpy.init(args=["knee-contact", *arguments], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy's own errors derive from it
        raise UsageError(f"ROS arguments: {str(error).splitlines()[0]}") from None
    stop, node = Stop(), None
    try:
        with joining():
            node = KneeContactNode()
        start(node, stop)
        executor = EventsExecutor()
        executor.add_node(node)
        while not stop.asked:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
    finally:
        if node is not None:
            node.finish()  # whatever has happened: what was recorded is completed
            node.destroy_node()
        rclpy.shutdown()
    return 0


def start(node: KneeContactNode, stop: Stop) -> None:
    """Activate the node if it starts by itself; compiling may be interrupted.

    Raises:
        UsageError: see `run_node`.
    """
    if not node.node_parameters.read().autostart:
        return
    node.open_session()
    try:
        stop.interrupts = True
        node.compile_model()
    except KeyboardInterrupt:
        return
    finally:
        stop.interrupts = False
    node.trigger_configure()
    node.trigger_activate()
