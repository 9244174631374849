"""How the node listens, what may change while it does, and what it says of a knee that makes no sense."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from knee_contact_ros import load_model
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.build import retuned
from knee_contact_ros.parameters.files import known_parameters, load_parameters
from knee_contact_ros.streams.messages import WrenchStamped as Wrench
from knee_contact_ros.streams.messages import encode_wrench_stamped
from tests import ROOT
from tests.helpers.messages import RosMessages, header
from tests.ros.conftest import Peer, Start, call, set_parameters

MS = 1_000_000


def test_numbers_change_between_two_ticks_and_those_that_are_documented_do(peer: Peer, start_node: Start) -> None:
    """The motion goes on; from the next interval on with the new constants, bit for bit as in the Python calls."""
    start_node()
    peer.wait_for_node()
    changes = {
        "contact.damping": 900.0, "fidelity.tolerance": 1e-8, "fidelity.force_tolerance": 0.1, "femur.mass": 4.0,
        "load.share": 0.7,
    }  # fmt: skip
    model = load_model({})
    stream, shares, expected = model.stream(), [0.5, 0.7], []
    for i in range(40):
        if i == 20:
            peer.wait_until(lambda: len(peer.contacts) == 20)
            assert set_parameters(peer, changes) == (True, "")
            stream.go_on_with(retuned(model, load_parameters(changes)))
        axial = 800.0 + 300.0 * np.sin(0.4 * i)
        peer.send(i * 5 * MS, 0.2, axial)
        expected.append(stream.tick_ns(i * 5 * MS, 0.2, shares[i >= 20] * axial))
    peer.wait_until(lambda: len(peer.contacts) == 40)
    for name in ("penetration_depth", "penetration_rate", "error_estimate", "status"):
        assert [getattr(contact, name) for contact in peer.contacts] == [getattr(tick, name) for tick in expected], name
    refused = set_parameters(peer, {"contact.damping": 5.0, "contact.law": "hertz"})
    assert refused == (False, "parameter contact.law cannot change while the node is configured, only after a cleanup")
    assert set_parameters(peer, {"fidelity.budget": 7})[0] is False

    # Each parameter is set to another value, allowed or not: of most the node says first that they cannot change.
    page = (ROOT / "docs" / "reference" / "parameters.md").read_text(encoding="utf-8").partition("## knee_load")[0]
    live = re.findall(r"^\| `([\w.]+)` \|.*\| yes \|$", page, re.MULTILINE)
    named = {*live, *(f"lateral.{name}" for name in live if name.startswith(("femur.", "contact.")))}
    reasons = {}
    for name, declared in known_parameters().items():
        default = declared.default
        end = declared.most if declared.most not in (default, np.inf) else declared.least  # rclpy checks a range first
        other = not default if isinstance(default, bool) else f"{default}_" if isinstance(default, str) else end
        reasons[name] = set_parameters(peer, {name: type(default)(other)})[1]
    assert {name for name, reason in reasons.items() if "cannot change" not in reason} == named


def test_the_user_decides_on_the_qos(peer: Peer, start_node: Start) -> None:
    """Standard overrides, for inputs and outputs; whoever cannot be heard by a reliability that is given is named."""
    node = start_node(
        "-p", "qos_overrides./joint_states.subscription.reliability:=reliable",
        "-p", "qos_overrides./joint_states.subscription.depth:=7",
        "-p", "qos_overrides./knee_contact.publisher.reliability:=best_effort",
    )  # fmt: skip
    peer.wait_for_node()
    (speaking,) = peer.node.get_publishers_info_by_topic("/knee_contact")
    (beside,) = peer.node.get_publishers_info_by_topic("/knee_contact/wrench")
    assert speaking.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert beside.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = peer.node.create_publisher(JointState, "joint_states", best_effort)
    other = peer.node.create_publisher(WrenchStamped, "joint_reaction_force", best_effort)
    force = "knee_contact: joint_reaction_force"
    peer.wait_until(lambda: peer.diagnostics.get(force, {}).get("reliability") == "best effort")
    peer.wait_until(other.get_subscription_count)
    assert not publisher.get_subscription_count()
    assert peer.diagnostics["knee_contact: joint_states"]["reliability"] == "reliable"
    fixed = "qos_overrides./joint_states.subscription.depth"
    assert "cannot change while the node is configured" in set_parameters(peer, {fixed: 8})[1]
    _, output = node.stop()
    assert output.count("a publisher of /joint_states cannot be heard: its QoS does not fit the override") == 1
    assert output.count("a publisher of /joint_reaction_force is best effort; the node listens in the same way") == 1


def test_what_makes_no_sense_and_what_is_late_is_told(peer: Peer, start_node: Start) -> None:
    """A stiffness in N/mm^1.5: in the log, in /diagnostics and in the ticks' status; an angle that does not come."""
    node = start_node("-p", "contact.stiffness:=2500", "-p", "deadline:=0.05", "-p", "pairing.wait:=0.3")
    peer.wait_for_node()
    for i in range(10):
        peer.send(i * 10 * MS, 0.2, 800.0)
    peer.wait_until(lambda: len(peer.contacts) == 10)
    assert all(contact.status & Status.IMPLAUSIBLE for contact in peer.contacts)
    peer.wait_until(lambda: "10 of 10 ticks are up to 295 mm deep" in peer.problems.get("knee_contact: ticks", ""))
    assert set_parameters(peer, {"contact.stiffness": 2400.0}) == (True, "")
    peer.wait_until(lambda: peer.problems["knee_contact: ticks"] == "ok")  # in a second without ticks
    before = int(peer.diagnostics["knee_contact: ticks"]["missed deadlines"])
    peer.send_force(100 * MS, 800.0)
    peer.wait_until(lambda: int(peer.diagnostics["knee_contact: ticks"]["missed deadlines"]) == before + 1)
    _, said = node.stop()
    for words in ("contact.stiffness 2500 N/m^1.5 gives", "contact.stiffness 2400 N/m^1.5 gives", "(IMPLAUSIBLE)"):
        assert ["WARN" in line for line in said.splitlines() if words in line] == [True], words


def test_a_split_that_cannot_be_used_is_told(peer: Peer, start_node: Start) -> None:
    """By the frontal moment: 43.75 N m between compartments 70 mm apart move 625 N from one to the other."""
    node = start_node("-p", "load.compartment:=moment_balance", "-p", "diagnostics.load_deviation:=0.1")
    peer.wait_for_node()
    for i, moment in enumerate((0.0, 43.75, -43.75)):
        peer.send_angle(i * 5 * MS, 0.2)
        peer.force.publish(encode_wrench_stamped(Wrench(i * 5 * MS, "tibia_r", (0.0, -900.0, 0.0), (moment, 0.0, 0.0))))
    peer.wait_until(lambda: len(peer.contacts) == 3)
    loads = [contact.load for contact in peer.contacts]
    assert loads == pytest.approx([450.0, 450.0 - 625.0, 450.0 + 625.0], rel=1e-12)
    assert [contact.status for contact in peer.contacts] == [0, Status.DOUBTFUL_LOAD, Status.DOUBTFUL_LOAD]
    peer.wait_until(lambda: peer.problems.get("knee_contact: load"))
    last = peer.contacts[-1]
    force = 73.7068 * last.contact_force / last.load  # a tenth of 737.07 N
    depth = force / (1.5 * 7.905694e7 * last.penetration_depth**0.5)
    off = {"knee_contact: force +- [N]": f"{force:.1f}", "knee_contact: depth +- [mm]": f"{1e3 * depth:.4f}"}
    assert peer.diagnostics["knee_contact: load"] == {
        "from [N]": "-175.0", "to [N]": "1075.0",
        "share of the axial load": "-0.19 to 1.19", "above 1": "1", "below 0": "1", **off,
    }  # fmt: skip
    assert "above 1 in 33.3 % and below 0 in 33.3 %" in node.stop()[1]


def test_a_dump_of_parameters_is_loaded_and_publishers_that_disagree_are_told(peer: Peer, start_node: Start) -> None:
    node = start_node("-p", "contact.law:=two_layer_viscoelastic")
    peer.wait_for_node()
    names = list(call(peer, ListParameters, "/knee_contact/list_parameters", ListParameters.Request()).result.names)
    own = [name for name in names if name in known_parameters()]

    values = call(peer, GetParameters, "/knee_contact/get_parameters", GetParameters.Request(names=own)).values
    before = [ParameterMessage(name=name, value=value) for name, value in zip(own, values, strict=True)]
    assert len(own) > 100
    request = SetParameters.Request(parameters=before)  # as `ros2 param load` of `ros2 param dump` does
    results = call(peer, SetParameters, "/knee_contact/set_parameters", request).results
    assert {(result.successful, result.reason) for result in results} == {(True, "")}

    other = peer.node.create_publisher(JointState, "joint_states", 100)
    peer.wait_until(other.get_subscription_count)

    def alternate(start: int) -> int:
        for stamp in range(start, start + 100 * 5 * MS, 5 * MS):
            peer.send(stamp, 0.8, 900.0)
            message = JointState(header=header(RosMessages, stamp + MS, ""), name=["knee"], position=[0.0])
            other.publish(message)
            peer.spin(0.002)  # else all of one come before all of the other
        return start + 100 * 5 * MS

    now = [10**18]

    def told(entry: str, words: str) -> Callable[[], bool]:
        def look() -> bool:
            now[0] = alternate(now[0])
            return words in peer.problems.get(f"knee_contact: {entry}", "")

        return look

    peer.wait_until(told("joint_states", "publishers send it and disagree"))
    _, output = node.stop()
    assert "the joint 'knee' of joint_states goes back and forth by about 0.80 rad between samples" in output
