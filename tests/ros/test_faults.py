"""Faults injected into the streams of a running node: what each costs is the faulty sample itself, and nothing else.

Every fault comes in the middle of a stream of good samples. All good samples must be answered, with the bits that the
Python calls give for them alone; the next answer must carry the fault's status bit, and its counter must count it.
"""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState as RosJointState
from std_srvs.srv import Trigger

from knee_contact_ros import load_model
from knee_contact_ros.cdr_in import JointState, WrenchStamped
from knee_contact_ros.cdr_out import encode_joint_state, encode_wrench_stamped
from knee_contact_ros.core.types import Status
from knee_contact_ros.messages import stamp_to_ns, typestore
from tests.messages import PlainMessages, RosMessages, header
from tests.ros.conftest import NodeProcess, Peer

STEP = 5_000_000
HALF = 12
"""Good samples before a fault, and as many after it"""
SECOND = 1_000_000_000
SHARE = 0.5
WAIT = 7.0
"""How long [s] a force waits for its angle: what a burst has lost Fast DDS sends again with a heartbeat, every 3 s"""
FIELDS = ("contact_force", "penetration_depth", "gap", "penetration_rate", "femoral_height", "error_estimate")
OK, REJECTED = Status.OK, Status.INPUT_REJECTED


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


def joint_state(peer: Peer, stamp: int, **positions: float) -> None:
    peer.angle.publish(
        RosJointState(header=header(RosMessages, stamp, ""), name=list(positions), position=list(positions.values()))
    )


def bytes_of(stamp: int, angle: float) -> bytes:
    return encode_joint_state(JointState(stamp, "", ("knee",), (angle,), (), ()))


def force_bytes(stamp: int, axial: float) -> bytes:
    return encode_wrench_stamped(WrenchStamped(stamp, "tibia_r", (0.0, -axial, 0.0), (0.0, 0.0, 0.0)))


def without_position(peer: Peer, stamp: int) -> None:
    peer.angle.publish(RosJointState(header=header(RosMessages, stamp, ""), name=["hip", "knee"], position=[0.1]))


def other_order(peer: Peer, stamp: int) -> None:
    """On the straight line between its neighbours, so that it changes nothing."""
    joint_state(peer, stamp, ankle=0.1, knee=angle_at(HALF - 0.5), hip=-0.2)


def many_joints(peer: Peer, stamp: int) -> None:
    others = {f"joint_{i}": 0.0 for i in range(5000)}  # more than our own decoder takes
    joint_state(peer, stamp, **others, knee=angle_at(HALF - 0.5))


def big_endian(peer: Peer, stamp: int) -> None:
    state = typestore().types["sensor_msgs/msg/JointState"]
    position, none = np.array([angle_at(HALF - 0.5)]), np.zeros(0)
    message = state(header(PlainMessages(), stamp, ""), ["knee"], position, none, none)
    peer.angle.publish(bytes(typestore().serialize_cdr(message, state.__msgtype__, little_endian=False)))


def lost_angle(peer: Peer, stamp: int) -> list[Sample]:
    """The angle at this stamp does not come: after a while its force is answered with the last angle."""
    peer.send_force(stamp, 700.0)
    answered = len(peer.contacts)
    peer.wait_until(lambda: len(peer.contacts) == answered + 1)
    return [Sample(stamp, angle_at(HALF - 1), 700.0, Status.INPUT_HELD)]


def parameter_storm(peer: Peer, _stamp: int) -> None:
    client = peer.node.create_client(SetParameters, "/knee_contact/set_parameters")
    peer.wait_until(client.service_is_ready)
    change = Parameter("fidelity.budget", value=0).to_parameter_msg()
    for _ in range(40):  # in parts, for a service forgets what is asked by more than ten at once
        calls = [client.call_async(SetParameters.Request(parameters=[change])) for _ in range(5)]
        peer.wait_until(lambda calls=calls: all(call.done() for call in calls))
        assert all(call.result().results[0].successful for call in calls)
    peer.node.destroy_client(client)


def refused_parameter(peer: Peer, _stamp: int) -> None:
    client = peer.node.create_client(SetParameters, "/knee_contact/set_parameters")
    peer.wait_until(client.service_is_ready)
    changes = [Parameter("femur.geometry", value="profile"), Parameter("contact.damping", value=-1.0)]
    call = client.call_async(SetParameters.Request(parameters=[change.to_parameter_msg() for change in changes]))
    peer.wait_until(call.done)
    reasons = [result.reason for result in call.result().results]
    assert "femur.geometry cannot change while the node is configured" in reasons[0]
    assert "contact.damping" in reasons[1]
    peer.node.destroy_client(client)


def clock_jump(peer: Peer, _stamp: int) -> None:
    """Nobody computes with /clock: answers depend on stamps alone."""
    publisher = peer.node.create_publisher(Clock, "/clock", 10)
    for seconds in (100, 5, 10_000):
        publisher.publish(Clock(clock=RosMessages.Time(sec=seconds)))
    peer.spin(0.1)
    peer.node.destroy_publisher(publisher)


def stalled_subscriber(peer: Peer, _stamp: int) -> None:
    """Somebody else listens, reliably, and then reads no more."""
    code = "import time; from tests.ros.listener import listen; listen()"
    listener = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert listener.stdout
    assert listener.stdout.readline() == "listening\n"
    listener.send_signal(signal.SIGSTOP)
    peer.stalled.append(listener)


def other_publisher(peer: Peer, stamp: int) -> None:
    """A best-effort publisher joins; what it sends counts as well."""
    node = Node("other")
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = node.create_publisher(RosJointState, "joint_states", best_effort)
    state = peer.diagnostics
    peer.wait_until(lambda: state.get("knee_contact: joint_states", {}).get("reliability") == "best effort")
    peer.wait_until(publisher.get_subscription_count)
    peer.wait_until(peer.angle.get_subscription_count)
    publisher.publish(bytes_of(stamp, angle_at(HALF - 0.5)))
    peer.spin(0.2)
    node.destroy_node()


def burst(peer: Peer, stamp: int) -> list[Sample]:
    """Hundreds of samples at once: more than are computed while they come."""
    samples = [Sample(stamp + i, angle_at(HALF - 0.5), 600.0) for i in range(300)]
    for sample in samples:
        peer.angle.publish(bytes_of(sample.stamp, sample.angle))
    for sample in samples:
        peer.force.publish(force_bytes(sample.stamp, sample.axial))
    return samples


def nothing(_peer: Peer, _stamp: int) -> None:
    """The fault lies in the stamps."""


NAN, INF = float("nan"), float("inf")
FAULTS = [
    Fault("angle NaN", lambda p, t: p.send_angle(t, NAN), ("not_finite",), REJECTED),
    Fault("angle infinite", lambda p, t: p.send_angle(t, -INF), ("not_finite",), REJECTED),
    Fault("force NaN", lambda p, t: p.send_force(t, NAN), ("not_finite",), REJECTED),
    Fault("force infinite", lambda p, t: p.send_force(t, INF), ("not_finite",), REJECTED),
    Fault("angle beyond 10 rad", lambda p, t: p.send_angle(t, 57.3), ("out_of_range",), REJECTED),
    Fault("force beyond 1e6 N", lambda p, t: p.send_force(t, 2e6), ("out_of_range",), REJECTED),
    Fault("joint missing", lambda p, t: p.send_angle(t, 0.2, joint="elbow"), ("joint_missing",), REJECTED),
    Fault("joint without position", without_position, ("joint_missing",), REJECTED),
    Fault("empty joint state", joint_state, ("joint_missing",), REJECTED),
    Fault("joints in another order", other_order),
    Fault("thousands of joints", many_joints),
    Fault("angle doubled", lambda p, t: p.send_angle(t - STEP // 2, 0.9), ("angle_not_in_order",), REJECTED),
    Fault("force doubled", lambda p, t: p.send_force(t - STEP // 2, 9.0), ("load_not_in_order",), REJECTED),
    Fault("angle late", lambda p, t: p.send_angle(t - 2 * STEP, 0.9), ("angle_not_in_order",), REJECTED),
    Fault("force late", lambda p, t: p.send_force(t - 2 * STEP, 9.0), ("load_not_in_order",), REJECTED),
    Fault("bytes that are no message", lambda p, t: p.angle.publish(b"\x00\x01\x00\x00nonsense"), ("undecodable",),
          REJECTED),
    Fault("truncated message", lambda p, t: p.force.publish(force_bytes(t, 1.0)[:-9]), ("undecodable",), REJECTED),
    Fault("stamp before 1970", lambda p, t: p.force.publish(struct.pack("<4siI", b"\x00\x01\x00\x00", -5, 0)
                                                            + force_bytes(t, 1.0)[12:]), ("bad_stamp",), REJECTED),
    Fault("big-endian message", big_endian),
    Fault("streams pause", nothing, status=Status.STALE_INPUT, shift=SECOND // 2),
    Fault("time jumps back", nothing, status=Status.TIME_RESET, shift=-SECOND // 2),
    Fault("angle lost", lost_angle),
    Fault("burst of samples", burst),
    Fault("/clock jumps", clock_jump),
    Fault("parameter storm", parameter_storm),
    Fault("parameters refused", refused_parameter),
    Fault("subscriber stops reading", stalled_subscriber),
    Fault("best-effort publisher joins", other_publisher),
]  # fmt: skip


def angle_at(number: float) -> float:
    """Linear, so that a sample in between changes nothing."""
    return 0.2 + 0.01 * number


class Running:
    """A node that lives through all of the faults, and what it must have refused so far."""

    def __init__(self) -> None:
        self.process = NodeProcess("-p", "use_sim_time:=true", "-p", f"pairing.wait:={WAIT}")
        self.refused: Counter[str] = Counter()
        self.begin = 1000 * SECOND


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    running = Running()
    yield running
    running.process.process.kill()
    running.process.process.communicate()


@pytest.fixture
def listening(peer: Peer, running: Running) -> Iterator[Peer]:
    """Our side, with the node at rest: its next tick starts anew."""
    peer.wait_for_node()
    client = peer.node.create_client(Trigger, "/knee_contact/reset")
    peer.wait_until(client.service_is_ready)
    call = client.call_async(Trigger.Request())
    peer.wait_until(call.done)
    assert call.result().success
    yield peer
    for process in peer.stalled:
        process.kill()
        process.wait()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_costs_nothing_but_the_faulty_sample(listening: Peer, running: Running, fault: Fault) -> None:
    peer, begin = listening, running.begin
    first = [Sample(begin + i * STEP, angle_at(i), 800.0 + 40.0 * i) for i in range(HALF)]
    first[0] = first[0]._replace(status=Status.TIME_RESET)
    after = [
        Sample(begin + i * STEP + fault.shift, angle_at(i), 800.0 + 40.0 * i, fault.status if i == HALF else OK)
        for i in range(HALF, 2 * HALF)
    ]
    send(peer, first)
    extra = fault.inject(peer, begin + (HALF - 1) * STEP + STEP // 2) or []
    peer.spin(0.05)  # nothing orders the samples of two topics
    send(peer, after, already=len(first) + len(extra))
    expected = [*first, *extra, *after]
    assert [stamp_to_ns(contact.header.stamp) for contact in peer.contacts] == [sample.stamp for sample in expected]
    assert [contact.status for contact in peer.contacts] == [sample.status for sample in expected]
    model = load_model({})
    stream = model.stream()
    for contact, sample in zip(peer.contacts, expected, strict=True):
        if sample.status & Status.TIME_RESET:
            stream = model.stream()
        alone = stream.tick_ns(sample.stamp, sample.angle, SHARE * sample.axial)
        assert [getattr(contact, name) for name in FIELDS] == [getattr(alone, name) for name in FIELDS]
    running.refused.update(fault.counters)
    running.begin += 10 * SECOND


def send(peer: Peer, samples: list[Sample], already: int = 0) -> None:
    """Publish good samples and wait for all answers."""
    for sample in samples:
        peer.send(sample.stamp, sample.angle, sample.axial)
    peer.wait_until(lambda: len(peer.contacts) >= already + len(samples))


def test_all_that_was_refused_is_counted(listening: Peer, running: Running) -> None:
    """Runs last: the sums over all faults of this file."""
    expected = {reason: str(count) for reason, count in running.refused.items()}
    expected["total"] = str(running.refused.total())
    peer = listening
    peer.wait_until(lambda: "knee_contact: refused samples" in peer.diagnostics)
    assert peer.diagnostics["knee_contact: refused samples"] == expected


def test_the_documented_table_has_every_fault() -> None:
    page = (Path(__file__).parents[2] / "docs" / "node.md").read_text(encoding="utf-8")
    assert [fault.name for fault in FAULTS if f"\n| {fault.name} | " not in page] == []
