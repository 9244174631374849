"""Nodes that compute nothing: what rclpy itself takes for the same topics, in a process of the same shape.

`python -m benchmarks.latency.bare events|single|bytes|beside|realtime`, until SIGINT or SIGTERM.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from knee_contact_ros.msg import KneeContact
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from knee_contact_ros.node.output_process import lower_priority
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
)
from knee_contact_ros.system.realtime import begin_realtime
from knee_contact_ros.system.ros import make_executor

# As in managed_node.py, session.py and inputs.py, which are not imported: a bare node's process holds nothing else.
INPUT_QOS = QoSProfile(depth=1000)
OUTPUT_QOS = QoSProfile(depth=100)
SPIN_PERIOD = 0.1

EVENTS, SINGLE, BYTES, BESIDE, REALTIME = "events", "single", "bytes", "beside", "realtime"
LOADS = ((0.9e-3, 0.03, 0), (7e-3, 0.2, 10))
"""Processor time [s] of a piece of work, the time [s] from one to the next, and niceness: as recorder and scene do"""
SHARE = sum(work / period for work, period, _ in LOADS)
"""What that is of a processor"""
STAMP = slice(4, 12)
"""Bytes of the stamp in a message that begins with a header"""


class Ordinary:
    """A node on message objects: it answers every force with numbers of its own and of the last angle."""

    def __init__(self, node: Node) -> None:
        self.angle = 0.0
        self.contact = node.create_publisher(KneeContact, KNEE_CONTACT, OUTPUT_QOS)
        self.wrench = node.create_publisher(WrenchStamped, KNEE_CONTACT_WRENCH, OUTPUT_QOS)
        node.create_subscription(JointState, JOINT_STATES, self.on_joint_state, INPUT_QOS)
        node.create_subscription(WrenchStamped, JOINT_REACTION_FORCE, self.on_force, INPUT_QOS)

    def on_joint_state(self, message: Any) -> None:
        """Remember the flexion angle of a JointState."""
        self.angle = message.position[0]

    def on_force(self, message: Any) -> None:
        """Answer a WrenchStamped with a contact whose fields are all filled, and with a wrench."""
        force = message.wrench.force
        angle = self.angle
        load = -0.5 * force.y
        contact = KneeContact(
            header=message.header,
            flexion_angle=angle,
            load=load,
            contact_force=load,
            penetration_depth=1e-6 * load,
            gap=0.0,
            penetration_rate=1e-3 * angle,
            sliding_velocity=1e-2 * angle,
            contact_point=Point(x=1e-3 * angle, y=0.0, z=0.0),
            femoral_height=0.034 - 1e-6 * load,
            cartilage_depth=1e-6 * load,
            bone_depth=0.0,
            contact_state=KneeContact.CARTILAGE,
            fidelity=KneeContact.DYNAMIC,
            status=KneeContact.OK,
            error_estimate=1e-9,
            force_error_estimate=1e-3,
            evaluations=8,
        )
        self.contact.publish(contact)
        wrench = Wrench(
            force=Vector3(x=force.x, y=-load, z=0.0),
            torque=Vector3(x=0.0, y=0.0, z=-1e-3 * angle * load),
        )
        self.wrench.publish(WrenchStamped(header=message.header, wrench=wrench))


class Bytes:
    """A node on serialised messages: it answers every force with prepared bytes that carry the force's stamp."""

    def __init__(self, node: Node) -> None:
        self.contact = node.create_publisher(KneeContact, KNEE_CONTACT, OUTPUT_QOS)
        self.wrench = node.create_publisher(WrenchStamped, KNEE_CONTACT_WRENCH, OUTPUT_QOS)
        contact, wrench = prepared()
        self.header = contact[:4]
        self.contact_rest = contact[12:]
        self.wrench_rest = wrench[12:]
        node.create_subscription(
            JointState, JOINT_STATES, self.on_joint_state, INPUT_QOS, raw=True
        )
        node.create_subscription(
            WrenchStamped, JOINT_REACTION_FORCE, self.on_force, INPUT_QOS, raw=True
        )

    def on_joint_state(self, data: bytes) -> None:
        """Receive a serialised JointState and do nothing."""

    def on_force(self, data: bytes) -> None:
        """Answer a serialised WrenchStamped with both prepared messages."""
        start = self.header + data[STAMP]
        self.contact.publish(start + self.contact_rest)
        self.wrench.publish(start + self.wrench_rest)


def prepared() -> tuple[bytes, bytes]:
    """Serialise a contact and its wrench, stamped 0."""
    from knee_contact_ros.model.types import blank_answers
    from knee_contact_ros.streams.messages import encode_answer, encode_answer_wrench

    row = blank_answers(1).tobytes()
    return encode_answer(0, "tibia_r", row), encode_answer_wrench(0, "tibia_r", row)


def busy(work: float, period: float, niceness: int) -> None:
    """Work as an output's process does, without an output; see `LOADS`."""
    lower_priority(niceness)
    memory = bytearray(1 << 18)
    while True:
        end = time.thread_time() + work
        while time.thread_time() < end:
            memory[::64] = memory[::64]
        time.sleep(period - work)


def main(kind: str) -> None:
    """Run a bare node of a kind (`EVENTS` or another of these names) until a signal ends it."""
    if kind == REALTIME and (forbidden := begin_realtime()):
        raise SystemExit(forbidden)
    others = [
        multiprocessing.Process(target=busy, args=load, daemon=True)
        for load in LOADS
        if kind == BESIDE
    ]
    for other in others:
        other.start()
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: signals.append(number))
    rclpy.init(args=None, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("knee_contact_bare")
    answering = (Bytes if kind == BYTES else Ordinary)(node)
    if kind == SINGLE:
        executor: Executor = SingleThreadedExecutor()
        executor.add_node(node)
    else:
        executor = make_executor(node)
    try:
        while not signals:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
    finally:
        del answering
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
        for other in others:
            other.kill()


if __name__ == "__main__":
    main(sys.argv[1])
