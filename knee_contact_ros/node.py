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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from knee_contact_ros.errors import UsageError
from knee_contact_ros.graph import joining
from knee_contact_ros.node_parameters import NodeParameters
from knee_contact_ros.parameters import NODE_NAME, check_parameter_file
from knee_contact_ros.session import Session
from knee_contact_ros.topics import INPUTS

SPIN_PERIOD = 0.1
"""How often [s] the main loop looks for a signal to stop."""


class Stop:
    """SIGINT and SIGTERM: noted, or, while the model compiles, an interruption."""

    def __init__(self) -> None:
        self.asked = False
        self._interrupts = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Let a signal raise KeyboardInterrupt meanwhile; so does one that has come before."""
        self._interrupts = True
        try:
            if self.asked:
                raise KeyboardInterrupt
            yield
        finally:
            self._interrupts = False

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.asked = True
        if self._interrupts:
            raise KeyboardInterrupt


class KneeContactNode(LifecycleNode):
    """The managed node: its life cycle; what it does while configured is a `Session`."""

    def __init__(self, stop: Stop) -> None:
        """Read and check the parameters.

        Raises:
            UsageError: a parameter is unknown or not allowed.
        """
        super().__init__(
            NODE_NAME, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True
        )
        self.node_parameters = NodeParameters(self)
        self.session: Session | None = None
        self._stop = stop
        self._qos_given = frozenset(f"qos_overrides.{name}" for name in self.get_parameters_by_prefix("qos_overrides"))

    def configure(self) -> None:
        """Read the parameters, build the model and have its kernel ready, open the outputs.

        Raises:
            UsageError: see `Session`.
            KeyboardInterrupt: the process has been told to stop while it compiled.
        """
        try:
            self.session = Session(self, self.node_parameters.read(), self._qos_given)
            self.get_logger().info(
                "making the model ready; the first time on a machine it compiles for half a minute or more"
            )
            with self._stop.interrupting():
                self.session.pipeline.compile()
            self.node_parameters.user = self.session.retune
        except BaseException:
            self.finish()
            raise

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `configure`; a bad parameter leaves the node unconfigured."""
        try:
            if self.session is None:
                self.configure()
        except UsageError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except KeyboardInterrupt:
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the stream."""
        result = super().on_activate(state)
        if self.session:
            self.session.start()
            topics = " and ".join(self.resolve_topic_name(topic) for topic in INPUTS)
            self.get_logger().info(f"active, listening to {topics}")
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the stream; answer what still waits."""
        if self.session:
            self.session.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the outputs; all parameters may change again."""
        self.finish()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and close."""
        self.finish()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the outputs; the node is unconfigured then and can be configured anew."""
        self.get_logger().error("a transition has failed; the node is unconfigured")
        self.finish()
        return super().on_error(state)

    def finish(self) -> None:
        """End in whatever state the node is: answer what waits, complete the files."""
        session, self.session = self.session, None
        self.node_parameters.user = None
        if session:
            session.stop()
            session.close()
            session.destroy_endpoints()
            self.get_logger().info(f"{session.ticks.ticks} ticks, {session.pipeline.refused} samples refused")


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
            node = KneeContactNode(stop)
        if node.node_parameters.read().autostart:
            start(node)
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


def start(node: KneeContactNode) -> None:
    """Configure and activate the node; it may be told to stop meanwhile.

    Raises:
        UsageError: see `run_node`.
    """
    with suppress(KeyboardInterrupt):
        node.configure()
        node.trigger_configure()
        if node.trigger_activate() != TransitionCallbackReturn.SUCCESS:
            raise UsageError("the node could not be activated; its log says why")
