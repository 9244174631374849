"""How the node listens, what may change while it does, and how its transitions fail."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from knee_contact_ros import load_model
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.build import retuned
from knee_contact_ros.parameters.files import known_parameters, load_parameters
from knee_contact_ros.streams.topics import MESSAGE_TYPES
from tests import ROOT
from tests.helpers.messages import RosMessages, header
from tests.ros.conftest import NodeProcess, Peer, call, change_state

Start = Callable[..., NodeProcess]
MAX_GAP = 100_000_000
"""[ns], the default of `pairing.max_gap`"""
MILLISECOND = 1_000_000


def set_parameters(peer: Peer, values: Mapping[str, object]) -> tuple[bool, str]:
    """Set parameters of the node all at once."""
    changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParametersAtomically.Request(parameters=changes)
    result = call(peer, SetParametersAtomically, "/knee_contact/set_parameters_atomically", request).result
    return result.successful, result.reason


def test_numbers_change_between_two_ticks(peer: Peer, start_node: Start) -> None:
    """The motion goes on; from the next interval on with the new constants, bit for bit as in the Python calls."""
    start_node()
    peer.wait_for_node()
    changes = {
        "contact.damping": 900.0,
        "fidelity.tolerance": 1e-8,
        "fidelity.force_tolerance": 0.1,
        "femur.mass": 4.0,
        "load.share": 0.7,
    }
    model = load_model({})
    stream, shares = model.stream(), [0.5, 0.7]
    expected = []
    for i in range(40):
        if i == 20:
            peer.wait_until(lambda: len(peer.contacts) == 20)
            assert set_parameters(peer, changes) == (True, "")
            stream.go_on_with(retuned(model, load_parameters(changes)))
        axial = 800.0 + 300.0 * np.sin(0.4 * i)
        peer.send(i * 5 * MILLISECOND, 0.2, axial)
        expected.append(stream.tick_ns(i * 5 * MILLISECOND, 0.2, shares[i >= 20] * axial))
    peer.wait_until(lambda: len(peer.contacts) == 40)
    for name in ("penetration_depth", "penetration_rate", "error_estimate", "status"):
        assert [getattr(contact, name) for contact in peer.contacts] == [getattr(tick, name) for tick in expected], name
    refused = set_parameters(peer, {"contact.damping": 5.0, "contact.law": "hertz"})
    assert refused == (False, "parameter contact.law cannot change while the node is configured, only after a cleanup")
    assert set_parameters(peer, {"fidelity.budget": 7})[0] is False


def test_what_may_change_is_what_is_documented_and_nothing_else(peer: Peer, start_node: Start) -> None:
    """Each parameter is set to another value, allowed or not: of most the node says first that they cannot change."""
    page = (ROOT / "docs" / "reference" / "parameters.md").read_text(encoding="utf-8").partition("## knee_load")[0]
    live = re.findall(r"^\| `([\w.]+)` \|.*\| yes \|$", page, re.MULTILINE)
    named = {*live, *(f"lateral.{name}" for name in live if name.startswith(("femur.", "contact.")))}
    start_node("-p", "autostart:=true")
    peer.wait_for_node()
    reasons = {}
    for name, (default, _, limits) in known_parameters().items():
        end = limits.most if limits.most not in (default, np.inf) else limits.least  # rclpy checks a range first
        other = not default if isinstance(default, bool) else f"{default}_" if isinstance(default, str) else end
        reasons[name] = set_parameters(peer, {name: type(default)(other)})[1]
    assert {name for name, reason in reasons.items() if "cannot change" not in reason} == named


def test_a_live_recording_is_computed_again_from_itself(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """With what happened to the node between two ticks: the same bytes."""
    recording, redone = tmp_path / "live.mcap", tmp_path / "redone.mcap"
    node = start_node("-p", f"record.path:={recording}", "-p", "load.share:=0.6")
    peer.wait_for_node()
    for i in range(60):
        if i == 20:
            peer.wait_until(lambda: len(peer.contacts) == 20)
            assert set_parameters(peer, {"contact.damping": 900.0, "load.share": 0.7}) == (True, "")
        if i == 40:
            peer.wait_until(lambda: len(peer.contacts) == 40)
            assert call(peer, Trigger, "/knee_contact/reset", Trigger.Request()).success
        peer.send(i * 5 * MILLISECOND, 0.2, 800.0 + 300.0 * np.sin(0.4 * i))
    peer.wait_until(lambda: len(peer.contacts) == 60)
    node.stop()
    found = read_provenance(recording)
    assert found is not None
    solve(recording, found, redone, lambda _done, _total: None)
    answers = [read_raw(path) for path in (recording, redone)]
    assert len(answers[0]) == 60
    assert answers[0] == answers[1]


def read_raw(path: Path) -> list[RawMessage]:
    """The answers in a recording."""
    with BagReader(path, {"/knee_contact": MESSAGE_TYPES["knee_contact"]}) as bag:
        return list(bag.raw_messages())


def test_the_user_decides_on_the_qos(peer: Peer, start_node: Start) -> None:
    """Standard overrides, for inputs and outputs."""
    start_node(
        "-p", "qos_overrides./joint_states.subscription.reliability:=best_effort",
        "-p", "qos_overrides./joint_states.subscription.depth:=7",
        "-p", "qos_overrides./knee_contact.publisher.reliability:=best_effort",
    )  # fmt: skip
    peer.wait_for_node()
    (listening,) = peer.node.get_subscriptions_info_by_topic("/joint_states")
    (other,) = peer.node.get_subscriptions_info_by_topic("/joint_reaction_force")
    (speaking,) = peer.node.get_publishers_info_by_topic("/knee_contact")
    (beside,) = peer.node.get_publishers_info_by_topic("/knee_contact/wrench")
    assert listening.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert other.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert speaking.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert beside.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    angles = "knee_contact: joint_states"
    peer.wait_until(lambda: peer.diagnostics.get(angles, {}).get("reliability") == "best effort")


def test_a_reliability_that_is_given_stays(peer: Peer, start_node: Start) -> None:
    """Whoever cannot be heard by that is named."""
    node = start_node("-p", "qos_overrides./joint_states.subscription.reliability:=reliable")
    peer.wait_for_node()
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = peer.node.create_publisher(JointState, "joint_states", best_effort)
    other = peer.node.create_publisher(WrenchStamped, "joint_reaction_force", best_effort)
    force = "knee_contact: joint_reaction_force"
    peer.wait_until(lambda: peer.diagnostics.get(force, {}).get("reliability") == "best effort")
    peer.wait_until(other.get_subscription_count)
    assert not publisher.get_subscription_count()
    assert peer.diagnostics["knee_contact: joint_states"]["reliability"] == "reliable"
    _, output = node.stop()
    assert output.count("a publisher of /joint_states cannot be heard: its QoS does not fit the override") == 1
    assert output.count("a publisher of /joint_reaction_force is best effort; the node listens in the same way") == 1


def test_a_node_that_falls_behind_says_so(peer: Peer, start_node: Start) -> None:
    """Answers that come later than the deadline are counted; one that waits for its angle is late, too."""
    start_node("-p", "deadline:=0.05", "-p", "pairing.wait:=0.3")
    peer.wait_for_node()
    peer.send(0, 0.2, 900.0)
    peer.send_force(5 * MILLISECOND, 900.0)
    peer.wait_until(lambda: len(peer.contacts) == 2)
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("missed deadlines") == "1")


def test_a_qos_override_is_checked_when_it_is_set(peer: Peer, start_node: Start) -> None:
    """Whether it is any, whether there is such a topic, and whether it can still count."""
    start_node("-p", "qos_overrides./joint_states.subscription.depth:=7")
    peer.wait_for_node()
    refused = {
        "qos_overrides./joint_states.subscription.durability": ("volatile", "unknown parameter qos_overrides./joint"),
        "qos_overrides./joint_states.publisher.depth": (7, "unknown parameter qos_overrides./joint_states.publisher"),
        "qos_overrides./knee.subscription.depth": (7, "allowed: qos_overrides./joint_states.subscription.*, qos_over"),
        "qos_overrides./joint_states.subscription.depth": (8, "cannot change while the node is configured"),
    }
    for name, (value, words) in refused.items():
        successful, reason = set_parameters(peer, {name: value})
        assert not successful
        assert words in reason
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert change_state(peer, transition)
    assert set_parameters(peer, {"qos_overrides./joint_states.subscription.depth": 8}) == (True, "")
    successful, reason = set_parameters(peer, {"qos_overrides./joint_states.subscription.depth": -8})
    assert (successful, "-8 is not allowed" in reason) == (False, True)


def test_what_makes_no_sense_is_told(peer: Peer, start_node: Start) -> None:
    """A stiffness in N/mm^1.5: in the log, in /diagnostics and in the ticks' status."""
    node = start_node("-p", "contact.stiffness:=2500")
    peer.wait_for_node()
    for i in range(10):
        peer.send(i * 10 * MILLISECOND, 0.2, 800.0)
    peer.wait_until(lambda: len(peer.contacts) == 10)
    assert all(contact.status & Status.IMPLAUSIBLE for contact in peer.contacts)
    peer.wait_until(lambda: "10 of 10 ticks are up to 295 mm deep" in peer.problems.get("knee_contact: ticks", ""))
    assert set_parameters(peer, {"contact.stiffness": 2400.0}) == (True, "")
    peer.wait_until(lambda: peer.problems["knee_contact: ticks"] == "ok")  # in a second without ticks
    _, said = node.stop()
    for words in ("contact.stiffness 2500 N/m^1.5 gives", "contact.stiffness 2400 N/m^1.5 gives", "(IMPLAUSIBLE)"):
        assert ["WARN" in line for line in said.splitlines() if words in line] == [True], words


def test_a_load_of_the_other_sign_is_told(peer: Peer, start_node: Start) -> None:
    node = start_node()
    peer.wait_for_node()
    for i in range(121):
        peer.send(i * 10 * MILLISECOND, 0.2, -800.0)
    words = "the load was negative throughout (-400 to -400 N): compression is force.y < 0 in joint_reaction_force"
    peer.wait_until(lambda: peer.problems.get("knee_contact: load", "").startswith(words))
    assert peer.diagnostics["knee_contact: load"] == {"from [N]": "-400.0", "to [N]": "-400.0"}
    peer.spin(2.5)  # two reports more
    assert node.stop()[1].count(words) == 1


def test_a_split_that_cannot_be_used_is_told(peer: Peer, start_node: Start) -> None:
    """By the frontal moment: 43.75 N m between compartments 70 mm apart move 625 N from one to the other."""
    node = start_node("-p", "load.compartment:=moment_balance", "-p", "diagnostics.load_deviation:=0.1")
    peer.wait_for_node()
    for i, moment in enumerate((0.0, 43.75, -43.75)):
        peer.send_angle(i * 5 * MILLISECOND, 0.2)
        force = RosMessages.Vector3(x=0.0, y=-900.0, z=0.0)
        wrench = RosMessages.Wrench(force=force, torque=RosMessages.Vector3(x=moment, y=0.0, z=0.0))
        stamp = header(RosMessages, i * 5 * MILLISECOND, "tibia_r")
        peer.force.publish(RosMessages.WrenchStamped(header=stamp, wrench=wrench))
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
