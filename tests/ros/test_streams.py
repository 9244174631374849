"""How the node listens and what changes while it does; what it publishes and says of strides, markers and mistakes."""

import math
import re
import time
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from knee_contact_ros import load_model
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.model.types import Status
from knee_contact_ros.node.stride_topic import encode_stride
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.build import retuned
from knee_contact_ros.parameters.files import known_parameters, load_parameters
from knee_contact_ros.streams.messages import WrenchStamped as Wrench
from knee_contact_ros.streams.messages import encode_wrench_stamped
from knee_contact_ros.streams.strides import Span, Stride, strides_of
from knee_contact_ros.streams.topics import KNEE_CONTACT, KNEE_CONTACT_MARKERS
from tests.helpers.markers import place_of
from tests.helpers.messages import RosMessages, header
from tests.helpers.patience import wait_until
from tests.hostile.test_mistakes import WAYS, by_bag
from tests.model.test_inputs import Columns, gait
from tests.ros.conftest import call, change_state, raw, set_parameters
from tests.streams.test_gait_events import BODY_WEIGHT, walking

MS = 1_000_000


def test_numbers_change_between_two_ticks(peer, start_node):
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
    stream, shares, expected = model.stream(), [0.5, 0.7], []
    for i in range(40):
        if i == 20:
            peer.wait_until(lambda: len(peer.contacts) == 20)
            assert set_parameters(peer, changes) == (True, "")
            stream.continue_with(retuned(model, load_parameters(changes)))
        axial = 800.0 + 300.0 * np.sin(0.4 * i)
        peer.send(i * 5 * MS, 0.2, axial)
        expected.append(stream.tick(0.005 * i, 0.2, shares[i >= 20] * axial))
    peer.wait_until(lambda: len(peer.contacts) == 40)
    for name in ("penetration_depth", "penetration_rate", "error_estimate", "status"):
        assert [getattr(contact, name) for contact in peer.contacts] == [
            getattr(tick, name) for tick in expected
        ], name
    refused = set_parameters(peer, {"contact.damping": 5.0, "contact.law": "hertz"})
    assert refused == (
        False,
        "parameter contact.law cannot change while the node is configured, only after a cleanup",
    )
    assert set_parameters(peer, {"fidelity.budget": 7})[0] is False


def test_the_user_decides_on_the_qos(peer, start_node):
    """Standard overrides, for inputs and outputs; whoever cannot be heard by a reliability that is given is named."""
    node = start_node(
        "qos_overrides./joint_states.subscription.reliability:=reliable",
        "qos_overrides./joint_states.subscription.depth:=7",
        "qos_overrides./joint_states.subscription.reliabilty:=best_effort",
        "qos_overrides./knee_contact.publisher.reliability:=best_effort",
    )
    peer.wait_for_node()
    (speaking,) = peer.node.get_publishers_info_by_topic("/knee_contact")
    (beside,) = peer.node.get_publishers_info_by_topic("/knee_contact/wrench")
    assert speaking.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert beside.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = peer.node.create_publisher(JointState, "joint_states", best_effort)
    warned = []
    other = peer.node.create_publisher(
        WrenchStamped,
        "joint_reaction_force",
        best_effort,
        event_callbacks=PublisherEventCallbacks(incompatible_qos=warned.append),
    )
    force = "knee_contact: joint_reaction_force"
    peer.wait_until(lambda: peer.diagnostics.get(force, {}).get("reliability") == "best effort")
    peer.wait_until(other.get_subscription_count)
    assert not warned, "a robot that starts after the node has nothing to warn of"
    assert not publisher.get_subscription_count()
    assert peer.diagnostics["knee_contact: joint_states"]["reliability"] == "reliable"
    fixed = "qos_overrides./joint_states.subscription.depth"
    assert "cannot change while the node is configured" in set_parameters(peer, {fixed: 8})[1]
    output = node.stop()
    assert (
        output.count(
            "reliabilty has no effect: did you mean qos_overrides./joint_states.subscription.reliabili"
        )
        == 1
    )
    assert (
        output.count(
            "a publisher of /joint_states cannot be heard: its QoS does not fit the override"
        )
        == 1
    )


def test_what_makes_no_sense_and_what_is_late_is_told(peer, start_node):
    """A stiffness in N/mm^1.5: in the log, in /diagnostics and in the ticks' status; an angle that does not come."""
    node = start_node("contact.stiffness:=2500", "deadline:=0.05", "pairing.wait:=0.3")
    peer.wait_for_node()
    for i in range(10):
        peer.send(i * 10 * MS, 0.2, 800.0)
    peer.wait_until(lambda: len(peer.contacts) == 10)
    assert all(contact.status & Status.IMPLAUSIBLE for contact in peer.contacts)
    peer.wait_until(
        lambda: (
            "10 of 10 ticks are up to 295 mm deep" in peer.problems.get("knee_contact: ticks", "")
        )
    )
    assert set_parameters(peer, {"contact.stiffness": 2400.0}) == (True, "")
    peer.wait_until(
        lambda: peer.problems["knee_contact: ticks"] == "ok"
    )  # in a second without ticks
    before = int(peer.diagnostics["knee_contact: ticks"]["missed deadlines"])
    peer.send_force(100 * MS, 800.0)
    peer.wait_until(
        lambda: int(peer.diagnostics["knee_contact: ticks"]["missed deadlines"]) == before + 1
    )
    said = node.stop()
    for words in (
        "contact.stiffness 2500 N/m^1.5 gives",
        "contact.stiffness 2400 N/m^1.5 gives",
        "(IMPLAUSIBLE)",
    ):
        assert ["WARN" in line for line in said.splitlines() if words in line] == [True], words


@pytest.mark.parametrize("in_file", [False, True])
def test_a_parameter_that_the_law_does_not_use_is_named_once(in_file, peer, start_node, tmp_path):
    """Also when others are changed later."""
    unused = "contact.layer_depth"
    lines = ["/**/knee_contact:", "  ros__parameters:", f"    {unused}: 1.0e-3"]
    (tmp_path / "knee.yaml").write_text("\n".join(lines))
    given = ["--params-file", str(tmp_path / "knee.yaml")] if in_file else [f"{unused}:=1.0e-3"]
    node = start_node(*given)
    peer.wait_for_node()
    assert set_parameters(peer, {"contact.damping": 4000.0}) == (True, "")
    peer.send_series()
    said = node.stop()
    assert said.count(f"{unused} has no effect under contact.law kelvin_voigt") == 1, said


def test_a_split_that_cannot_be_used_is_told(peer, start_node):
    """By the frontal moment: 43.75 N m between compartments 70 mm apart move 625 N from one to the other."""
    node = start_node("load.compartment:=moment_balance", "diagnostics.load_deviation:=0.1")
    peer.wait_for_node()
    for i, moment in enumerate((0.0, 43.75, -43.75)):
        peer.send_angle(i * 5 * MS, 0.2)
        peer.force.publish(
            encode_wrench_stamped(
                Wrench(i * 5 * MS, "tibia_r", (0.0, -900.0, 0.0), (moment, 0.0, 0.0))
            )
        )
    peer.wait_until(lambda: len(peer.contacts) == 3)
    loads = [contact.load for contact in peer.contacts]
    assert loads == pytest.approx([450.0, 450.0 - 625.0, 450.0 + 625.0], rel=1e-12)
    assert [contact.status for contact in peer.contacts] == [
        0,
        Status.DOUBTFUL_LOAD,
        Status.DOUBTFUL_LOAD,
    ]
    peer.wait_until(lambda: "-0.19 to 1.19" in peer.problems.get("knee_contact: load", ""))
    last = peer.contacts[-1]
    force = 73.7068 * last.contact_force / last.load  # a tenth of 737.07 N
    depth = force / (1.5 * 7.905694e7 * last.penetration_depth**0.5)
    off = {
        "knee_contact: force +- [N]": f"{force:.1f}",
        "knee_contact: depth +- [mm]": f"{1e3 * depth:.4f}",
    }
    entries = [values for name, values in peer.reported if name == "knee_contact: load"]
    shares = {"share of the axial load": "-0.19 to 1.19", "above 1": "1", "below 0": "1"}
    assert peer.diagnostics["knee_contact: load"].items() >= shares.items()
    # A report has the loads since the one before, and may come amid the three.
    assert min(float(each["from [N]"]) for each in entries if "from [N]" in each) == -175.0
    assert max(float(each["to [N]"]) for each in entries if "to [N]" in each) == 1075.0
    assert any(each.items() >= off.items() for each in entries)
    assert "above 1 in 33.3 % and below 0 in 33.3 %" in node.stop()


def test_a_dump_of_parameters_is_loaded_and_publishers_that_disagree_are_told(peer, start_node):
    node = start_node("contact.law:=two_layer_viscoelastic")
    peer.wait_for_node()
    names = list(
        call(
            peer, ListParameters, "/knee_contact/list_parameters", ListParameters.Request()
        ).result.names
    )
    own = [name for name in names if name in known_parameters()]

    values = call(
        peer, GetParameters, "/knee_contact/get_parameters", GetParameters.Request(names=own)
    ).values
    before = [
        ParameterMessage(name=name, value=value) for name, value in zip(own, values, strict=True)
    ]
    assert len(own) > 100
    request = SetParameters.Request(
        parameters=before
    )  # as `ros2 param load` of `ros2 param dump` does
    results = call(peer, SetParameters, "/knee_contact/set_parameters", request).results
    assert {(result.successful, result.reason) for result in results} == {(True, "")}

    other = peer.node.create_publisher(JointState, "joint_states", 100)
    peer.wait_until(other.get_subscription_count)

    def alternate(start):
        for stamp in range(start, start + 100 * 5 * MS, 5 * MS):
            peer.send(stamp, 0.8, 900.0)
            message = JointState(
                header=header(RosMessages, stamp + MS, ""), name=["knee"], position=[0.0]
            )
            other.publish(message)
            peer.spin(0.002)  # else all of one come before all of the other
        return start + 100 * 5 * MS

    now = [10**18]

    def told(entry, words):
        def look():
            now[0] = alternate(now[0])
            return words in peer.problems.get(f"knee_contact: {entry}", "")

        return look

    peer.wait_until(told("joint_states", "publishers send it and disagree"))
    output = node.stop()
    assert (
        "the joint 'knee' of joint_states goes back and forth by about 0.80 rad between samples"
        in output
    )


def test_each_stride_is_told_once_with_the_numbers_of_python(peer, start_node, tmp_path):
    strides: list[JointState] = []
    peer.node.create_subscription(JointState, "knee_contact/stride", strides.append, 10)
    weight = [
        f"body_weight:={BODY_WEIGHT}",
        "load.compartment:=total",
        "pairing.wait:=5.0",
    ]
    node = start_node(f"record.path:={tmp_path / 'live.mcap'}", *weight)
    peer.wait_for_node()
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact/stride"))
    peer.spin(0.5)  # the node sees the subscription
    stamps, angle, load = walking(100.0, 8.0)
    for stamp, flexion, axial in zip(stamps.tolist(), angle.tolist(), load.tolist(), strict=True):
        peer.send(stamp, flexion, axial)
        peer.spin(0.002)
    peer.wait_until(lambda: len(peer.contacts) == len(stamps))
    peer.wait_until(lambda: len(strides) >= 5)
    node.stop()
    known = strides_of(read_answers(tmp_path / "live.mcap"), BODY_WEIGHT)
    assert len(strides) in (
        len(known) - 1,
        len(known),
    )  # the end of a run may make a last one certain
    for message, stride in zip(strides, known, strict=False):
        numbers = dict(zip(message.name, message.position, strict=True))
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stride.span.end
        names = ("peak_force", "peak_depth", "impulse", "stance_impulse", "loading_rate", "usable")
        assert [numbers[name] for name in names] == [
            float(getattr(stride, name)) for name in names
        ]
        assert numbers["ringing"] == 0.0  # the law of healthy.yaml is damped
        assert numbers["stride_time"] == stride.span.duration
        assert numbers["stance_time"] == pytest.approx(
            0.01 * stride.span.stance * stride.span.duration, rel=1e-12
        )
        assert 0.2 < numbers["phase"] * numbers["stride_time"] < 0.7  # [s] after the heel strike


def test_a_law_that_is_hardly_damped_tells_by_how_many_newtons_it_rings(
    peer, start_node, tmp_path
):
    """As `solve` of the recording does, which begins at rest; live a first twentieth of a second is not looked at."""
    printed = [
        "contact.law:=two_layer_viscoelastic",
        "contact.damp_first_layer:=false",
        "load.compartment:=total",
    ]
    node = start_node(f"record.path:={tmp_path / 'live.mcap'}", *printed, "pairing.wait:=5.0")
    peer.wait_for_node()
    for stamp, flexion, axial in zip(*map(list, walking(100.0, 4.0)), strict=True):
        peer.send(int(stamp), float(flexion), float(axial))
        peer.spin(0.002)
    peer.wait_until(lambda: "rings by up to" in peer.problems.get("knee_contact: ringing", ""))
    log = node.stop()
    largest = float(
        re.findall(r"the contact force rings by up to ([\d.]+) N: loading rate", log)[-1]
    )
    model = load_model(
        [{"contact.law": "two_layer_viscoelastic", "contact.damp_first_layer": False}]
    )
    known = np.abs(model.ringing(read_answers(tmp_path / "live.mcap")))
    assert 0.9 * known[20:].max() < largest < 1.1 * known.max()


@pytest.mark.parametrize(
    ("now", "phase"), [(2.5, 0.5), (2.0, 0.0), (1.9, math.nan), (3600.0, math.nan)]
)
def test_the_phase_is_not_told_where_stamps_have_jumped(now, phase):
    stride = Stride(
        Span(10**9, 16 * 10**8, 2 * 10**9),
        1.0,
        1.0,
        1.0,
        1.0,
        1.0,
        usable=True,
        sliding_distance=0.0,
    )
    message = deserialize_message(encode_stride(stride, "", round(now * 1e9)), JointState)
    assert message.position[message.name.index("phase")] == pytest.approx(phase, nan_ok=True)


APART = 50_000_000
"""Between two samples [ns]: longer than between two pictures"""
NAMES = ["tibia", "femur", "contact_point", "contact_force_on_femur"]


def stamp_of(message):
    return int(1_000_000_000 * message.header.stamp.sec + message.header.stamp.nanosec)


def test_what_is_shown_is_the_answer(peer, start_node):
    """In its frame, at its place; how markers look is tested with the view."""
    start_node()
    peer.wait_for_node()
    pictures: list[Any] = []
    peer.wait_until(lambda: peer.node.count_publishers(KNEE_CONTACT_MARKERS))
    peer.node.create_subscription(MarkerArray, KNEE_CONTACT_MARKERS, pictures.append, 10)
    number = 0
    while (
        len({marker.action for picture in pictures for marker in picture.markers[-1:]}) < 2
        and number < 200
    ):
        load = 450.0 * (
            number // 4 % 2
        )  # when it ends, the contact needs longer than a tick to lose its force
        peer.send(number * APART, 0.02 * (number % 50), load)
        number += 1
        peer.wait_until(lambda: len(peer.contacts) == number)  # noqa: B023
        peer.spin(0.06)
    shown = {stamp_of(picture.markers[0]): picture.markers for picture in pictures}
    answers = {stamp_of(contact): contact for contact in peer.contacts}
    for stamp, markers in shown.items():
        contact = answers[stamp]
        assert [marker.ns for marker in markers] == [f"knee/{name}" for name in NAMES]
        assert {stamp_of(marker) for marker in markers} == {stamp}
        assert (
            {marker.header.frame_id for marker in markers}
            == {contact.header.frame_id}
            == {"tibia_r"}
        )
        _, _, point, force = markers
        assert place_of(point).tolist() == [
            contact.contact_point.x,
            contact.contact_point.y,
            contact.contact_point.z,
        ]
        assert force.action == (Marker.ADD if contact.contact_force else Marker.DELETE)
    assert {bool(answers[stamp].contact_force) for stamp in shown} == {True, False}


PACE = re.compile("deadline|behind|wait for the other topic|silent for|no answer")
"""What a busy machine may add, or a walk that is over"""


def walk(peer, time, angle, load):
    """Send a walk to a node that begins anew, when each side has heard that the other one is there again."""
    assert change_state(peer, "deactivate")
    peer.wait_until(
        lambda: not peer.angle.get_subscription_count() and not peer.force.get_subscription_count()
    )
    for transition in (
        "cleanup",
        "configure",
        "activate",
    ):
        assert change_state(peer, transition)
    peer.wait_for_node()
    peer.told.clear()
    peer.contacts.clear()
    for stamp, flexion, axial in zip(
        np.rint(1e9 * time).astype(np.int64).tolist(), angle, load, strict=True
    ):
        peer.send(stamp, float(flexion), float(axial))
        peer.executor.spin_once(timeout_sec=0.0)


def test_each_mistake_is_told_live(peer, start_node):
    start_node("pairing.wait:=5.0")
    peer.wait_for_node()
    right: Columns = gait()
    walk(peer, *right)
    peer.wait_until(
        lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("ticks") == str(len(right[0]))
    )
    assert {
        words for each in peer.told for words in each.split("; ") if not PACE.search(words)
    } == {"ok"}
    for change, words in list(WAYS[by_bag].values())[::4]:  # a few of each kind
        walk(peer, *change(*right))
        peer.wait_until(lambda words=words: re.search(words, "; ".join(peer.told)))


def test_answers_to_messages_that_were_long_under_way_are_flagged(peer, start_node, tmp_path):
    """As behind a huge message; the recording computes to the same flags."""
    node, sent = start_node(f"record.path:={tmp_path / 'r.mcap'}", "pairing.max_gap:=1.0"), []
    peer.wait_for_node()

    def send(age):
        sent.append(time.time_ns() - round(1e9 * age))
        peer.send(sent[-1], 0.3, 800.0)
        peer.spin(0.02)
        peer.wait_until(lambda: len(peer.contacts) == len(sent))

    def known():
        send(0.0)
        return "message age max [ms]" in peer.diagnostics.get("knee_contact: joint_states", {})

    wait_until(known)
    in_time = len(sent)
    peer.spin(3.0)  # so that stamps can be that old
    for number in range(50):
        send(2.5 - 0.01 * number)
    assert all(contact.status & Status.STALE_INPUT for contact in peer.contacts[in_time:])
    peer.wait_until(lambda: "STALE_INPUT" in peer.problems["knee_contact: joint_states"])
    wait_until(lambda: peer.contacts[-1].status == 0, lambda: send(0.0))
    node.stop()
    with Bag(tmp_path / "r.mcap") as bag:
        basis = read_provenance(bag)
        assert basis is not None
        solve(bag, basis, tmp_path / "again.mcap")
    live, again = (raw(tmp_path / name, [KNEE_CONTACT]) for name in ("r.mcap", "again.mcap"))
    assert live == again
    assert len(live) == len(sent)
