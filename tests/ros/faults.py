"""What may go wrong between two good samples, and what it costs: the part of docs/reference/faults.md about streams."""

import math
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from knee_contact_ros.model.types import Status
from knee_contact_ros.node.managed_node import MEANINGLESS
from knee_contact_ros.streams.messages import JointState as Joints
from knee_contact_ros.streams.messages import (
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from tests.helpers.messages import RosMessages, header
from tests.ros.conftest import STEP, Peer, call, change_state, set_parameters, trigger

HALF = 12
"""Good samples before a fault, and as many after it"""
SECOND = 1_000_000_000
OK, REJECTED = Status.OK, Status.INPUT_REJECTED
LISTENER = """
import rclpy
from knee_contact_ros.msg import KneeContact
from rclpy.node import Node

rclpy.init()
node = Node("listener")
node.create_subscription(KneeContact, "knee_contact", lambda _message: None, 10)
while not node.count_publishers("knee_contact"):
    rclpy.spin_once(node, timeout_sec=0.1)
print("listening", flush=True)
rclpy.spin(node)
"""
"""A program that listens to the answers reliably, says so, and reads on and on"""


REFUSED = (
    ("femur.geometry", "profile", "femur.geometry cannot change while the node is configured"),
    ("contact.damping", -1.0, "contact.damping"),
    ("contact.dampping", 1.0, "contact.dampping"),
    ("contact.damping", "much", "contact.damping"),
    ("femur.mass", [1.0, 2.0], "femur.mass"),
    ("fidelity.tolerance", math.nan, "fidelity.tolerance"),
    ("contact.damping", None, "contact.damping"),
)
"""Parameters, values, and words of the reason"""


def angle_at(number: float) -> float:
    """Linear, so that a sample in between changes nothing."""
    return 0.2 + 0.01 * number


BETWEEN = angle_at(HALF - 0.5)


class Sample(NamedTuple):
    """A good sample and the status that its answer must have."""

    stamp: int
    angle: float
    axial: float
    status: int = OK


class Fault(NamedTuple):
    """Something that goes wrong between two good samples."""

    name: str
    inject: Callable[[Peer, int], list[Sample] | None]
    """Do it at a stamp [ns]; returns samples that must be answered beside the good ones"""
    counters: tuple[str, ...] = ()
    """Reasons of the samples that it makes the node refuse"""
    status: int = OK
    """Of the first good sample after it"""
    shift: int = 0
    """By how much the stamps jump there [ns]"""


def joints(peer: Peer, stamp: int, names: list[str], position: list[float]) -> None:
    peer.angle.publish(
        JointState(header=header(RosMessages, stamp, ""), name=names, position=position)
    )


def force_bytes(stamp: int, axial: float) -> bytes:
    return encode_wrench_stamped(
        WrenchStamped(stamp, "tibia_r", (0.0, -axial, 0.0), (0.0, 0.0, 0.0))
    )


def times(number: int, inject: Callable[[Peer, int], object]) -> Callable[[Peer, int], None]:
    """The same so many times."""

    def again(peer: Peer, stamp: int) -> None:
        for _ in range(number):
            inject(peer, stamp)

    return again


def lost_angle(peer: Peer, stamp: int) -> list[Sample]:
    """The angle at this stamp does not come: after a while its force is answered with the last angle."""
    peer.send_force(stamp, 700.0)
    answered = len(peer.contacts)
    peer.wait_until(lambda: len(peer.contacts) == answered + 1)
    return [Sample(stamp, angle_at(HALF - 1), 700.0, Status.INPUT_HELD)]


def parameter_storm(peer: Peer, _stamp: int) -> None:
    client = peer.client(SetParameters, "/knee_contact/set_parameters")
    change = Parameter("fidelity.budget", value=0).to_parameter_msg()
    for _ in range(40):  # in parts, for a service forgets what is asked by more than ten at once
        calls = [client.call_async(SetParameters.Request(parameters=[change])) for _ in range(5)]
        for each in calls:
            peer.wait_until(each.done)
        assert all(call.result().results[0].successful for call in calls)


def refused_parameters(peer: Peer, _stamp: int) -> None:
    """Fixed, out of range, names there are not, types that are wrong, a value not set: the caller gets the reason."""
    for name, value, words in REFUSED:
        accepted, reason = set_parameters(peer, {name: value})
        assert not accepted
        assert words in reason


def unfit_transitions(peer: Peer, _stamp: int) -> None:
    """Such as to configure what is active, or what there is not."""
    for transition in (*range(10), 99, 255):
        if transition not in (
            Transition.TRANSITION_DEACTIVATE,
            Transition.TRANSITION_ACTIVE_SHUTDOWN,
        ):
            assert not change_state(peer, transition)
    labelled = ChangeState.Request(transition=Transition(label="dance"))
    assert not call(peer, ChangeState, "/knee_contact/change_state", labelled).success


def asked(service: str, number: int, success: bool) -> Callable[[Peer, int], None]:
    """A service, so many times."""

    def ask(peer: Peer, _stamp: int) -> None:
        assert {trigger(peer, service)[0] for _ in range(number)} == {success}

    return ask


def signalled(peer: Peer, _stamp: int) -> None:
    """Signals that mean nothing to the node."""
    for number in MEANINGLESS:
        os.kill(peer.node_process, number)
    peer.spin(0.3)


def frozen(peer: Peer, stamp: int) -> list[Sample]:
    """The machine gives the node no time for half a second."""
    os.kill(peer.node_process, signal.SIGSTOP)
    samples = [Sample(stamp + i, BETWEEN, 600.0) for i in range(50)]
    for sample in samples:
        peer.send(*sample[:3])
    peer.spin(0.5)
    os.kill(peer.node_process, signal.SIGCONT)
    return samples


def clock_jump(peer: Peer, _stamp: int) -> None:
    """Nobody computes with /clock: answers depend on stamps alone."""
    publisher = peer.node.create_publisher(Clock, "/clock", 10)
    for seconds in (100, 5, 10_000):
        publisher.publish(Clock(clock=RosMessages.Time(sec=seconds)))
    peer.spin(0.1)
    peer.node.destroy_publisher(publisher)


def stalled_subscriber(peer: Peer, _stamp: int) -> None:
    """Somebody else listens, reliably, and then reads no more."""
    listener = subprocess.Popen(
        [sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True
    )
    assert listener.stdout
    assert listener.stdout.readline() == "listening\n"
    listener.send_signal(signal.SIGSTOP)
    peer.stalled.append(listener)


def other_publisher(
    reliability: ReliabilityPolicy, angle: float, ahead: int
) -> Callable[[Peer, int], None]:
    """Somebody else publishes angles, too: one, so much ahead [ns]."""

    def join(peer: Peer, stamp: int) -> None:
        node = Node("other")
        publisher = node.create_publisher(
            JointState, "joint_states", QoSProfile(depth=10, reliability=reliability)
        )
        peer.introduce("/knee_contact")  # newer than the publisher, which the node then knows
        publisher.publish(
            encode_joint_state(Joints(stamp + ahead, "", ("knee",), (angle,), (), ()))
        )
        peer.spin(0.2)
        node.destroy_node()

    return join


def burst(peer: Peer, stamp: int) -> list[Sample]:
    """Hundreds of samples at once: more than are computed while they come."""
    samples = [Sample(stamp + i, BETWEEN, 600.0) for i in range(300)]
    for sample in samples:
        peer.send_angle(sample.stamp, sample.angle)
    for sample in samples:
        peer.send_force(sample.stamp, sample.axial)
    return samples


def far_ahead(peer: Peer, stamp: int) -> None:
    for i in range(3):
        peer.send_angle(stamp + 10**16 + i * STEP, 0.9)


def nothing(_peer: Peer, _stamp: int) -> None:
    """The fault lies in the stamps."""


NAN, INF = math.nan, math.inf
RELIABLE = ReliabilityPolicy.RELIABLE
FAULTS = [
    Fault("angle NaN", lambda p, t: p.send_angle(t, NAN), ("not_finite",), REJECTED),
    Fault("angle infinite", lambda p, t: p.send_angle(t, -INF), ("not_finite",), REJECTED),
    Fault("force NaN", lambda p, t: p.send_force(t, NAN), ("not_finite",), REJECTED),
    Fault("force infinite", lambda p, t: p.send_force(t, INF), ("not_finite",), REJECTED),
    Fault("angle beyond 10 rad", lambda p, t: p.send_angle(t, 57.3), ("out_of_range",), REJECTED),
    Fault("force beyond 1e6 N", lambda p, t: p.send_force(t, 2e6), ("out_of_range",), REJECTED),
    Fault(
        "joint missing",
        lambda p, t: p.send_angle(t, 0.2, joint="elbow"),
    ),
    Fault(
        "fewer positions than names",
        lambda p, t: joints(p, t, ["hip", "knee"], [0.1]),
        ("lengths_differ",),
        REJECTED,
    ),
    Fault("empty joint state", lambda p, t: joints(p, t, [], []), ("joint_missing",), REJECTED),
    Fault(
        "angle doubled",
        lambda p, t: p.send_angle(t - STEP // 2, 0.9),
        ("angle_not_in_order",),
        REJECTED,
    ),
    Fault(
        "force doubled",
        lambda p, t: p.send_force(t - STEP // 2, 9.0),
        ("load_not_in_order",),
        REJECTED,
    ),
    Fault(
        "angle stamp ahead",
        lambda p, t: p.send_angle(t + SECOND // 5, 0.9),
        ("angle_off_time",),
        REJECTED,
    ),
    Fault(
        "force stamp ahead",
        lambda p, t: p.send_force(t + SECOND // 5, 9.0),
        ("load_off_time",),
        REJECTED,
    ),
    Fault(
        "angle stamp a little ahead",
        lambda p, t: p.send_angle(t + 8 * STEP, 0.9),
        ("angle_off_time",),
        REJECTED,
    ),
    Fault(
        "angle stamp behind",
        lambda p, t: p.send_angle(t - SECOND // 5, 0.9),
        ("angle_off_time",),
        REJECTED,
    ),
    Fault(
        "force stamp behind",
        lambda p, t: p.send_force(t - SECOND // 5, 9.0),
        ("load_off_time",),
        REJECTED,
    ),
    Fault("angle stamps of a year to come", far_ahead, 3 * ("angle_off_time",), REJECTED),
    Fault(
        "angle late",
        lambda p, t: p.send_angle(t - 2 * STEP, 0.9),
        ("angle_not_in_order",),
        REJECTED,
    ),
    Fault(
        "force late",
        lambda p, t: p.send_force(t - 2 * STEP, 9.0),
        ("load_not_in_order",),
        REJECTED,
    ),
    Fault(
        "bytes that are no message",
        lambda p, t: p.angle.publish(b"\x00\x01\x00\x00no"),
        ("undecodable",),
        REJECTED,
    ),
    Fault(
        "truncated message",
        lambda p, t: p.force.publish(force_bytes(t, 1.0)[:-9]),
        ("undecodable",),
        REJECTED,
    ),
    Fault(
        "stamp before 1970",
        lambda p, t: p.force.publish(
            struct.pack("<4siI", b"\x00\x01\x00\x00", -5, 0) + force_bytes(t, 1.0)[12:]
        ),
        ("bad_stamp",),
        REJECTED,
    ),
    Fault("time jumps ahead", nothing, status=Status.STALE_INPUT, shift=1000 * SECOND),
    Fault(
        "angle stamps stand still",
        times(5, lambda p, t: p.send_angle(t - STEP // 2, 0.9)),
        5 * ("angle_not_in_order",),
        REJECTED,
    ),
    Fault(
        "stamp not set",
        times(2, lambda p, _: p.send_angle(0, 0.9)),
        ("angle_off_time", "no_stamp"),
        REJECTED,
    ),
    Fault(
        "one wrong stamp in both streams at once",
        lambda p, t: p.send(t - 100 * SECOND, 0.9, 9.0),
        ("angle_off_time", "load_off_time"),
        REJECTED,
    ),
    Fault(
        "second publisher with its own clock",
        other_publisher(RELIABLE, 0.9, 60 * SECOND),
        ("angle_off_time",),
        REJECTED,
    ),
    Fault(
        "one huge message",
        lambda p, t: joints(p, t, ["knee"], [0.1] * 40_000),
        ("too_large",),
        REJECTED,
    ),
    Fault("no content", lambda p, _: p.angle.publish(b"\0\1\0\0"), ("undecodable",), REJECTED),
    Fault(
        "force in another frame",
        lambda p, t: p.send_force(t, 700.0, frame="tibia_l"),
        ("frame_changed",),
        REJECTED,
    ),
    Fault("streams pause", nothing, status=Status.STALE_INPUT, shift=SECOND // 2),
    Fault("time jumps back", nothing, status=Status.TIME_RESET, shift=-SECOND // 2),
    Fault("angle lost", lost_angle),
    Fault("burst of samples", burst),
    Fault("/clock jumps", clock_jump),
    Fault("parameter storm", parameter_storm),
    Fault("parameters refused", refused_parameters),
    Fault("life cycle request that does not fit", unfit_transitions),
    Fault("reset storm", asked("reset", 20, success=True), status=Status.TIME_RESET),
    Fault("start of a recording without a name", asked("start_recording", 5, success=False)),
    Fault("stop of no recording", asked("stop_recording", 5, success=False)),
    Fault("signals that mean nothing", signalled),
    Fault("node frozen", frozen),
    Fault("subscriber stops reading", stalled_subscriber),
    Fault(
        "best-effort publisher joins", other_publisher(ReliabilityPolicy.BEST_EFFORT, BETWEEN, 0)
    ),
]
