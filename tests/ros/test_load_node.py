"""The load node over real topics: what it publishes, refuses, records, and hands on to the contact node."""

import signal

import psutil
import pytest
from geometry_msgs.msg import WrenchStamped
from knee_contact_ros.msg import LoadEstimate
from lifecycle_msgs.msg import State
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED
from knee_contact_ros.bags.recorder import REFUSED_SAMPLES
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import KNEE_CONTACT, LOAD_RECORDED
from tests.helpers.offline import estimate_load, solve
from tests.helpers.walking import ANGLES, FORCE, WHOLE_LEG, walk, walking_bag
from tests.ros.conftest import (
    Peer,
    answers_in,
    call,
    change_state,
    raw,
    set_parameters,
    state_of,
)

NODE = "knee_load"
REACTION, ESTIMATE = (f"/{topic}" for topic in LOAD_RECORDED[2:])
NODE_CONTACT = "knee_contact"
PATIENT = {"pairing.wait": 5.0}
"""No force is given up while this machine is busy"""
WALK = walk(80)


class LegPeer(Peer):
    """Has a leg's sensors, and listens to what comes of them."""

    def __init__(self):
        super().__init__()
        self.node.destroy_publisher(self.force)  # the node publishes that
        qos = QoSProfile(depth=1000)
        self.ground = self.node.create_publisher(WrenchStamped, FORCE, qos)
        self.heard: dict[str, list[bytes]] = {REACTION: [], ESTIMATE: []}
        for topic, kind in ((REACTION, WrenchStamped), (ESTIMATE, LoadEstimate)):
            self.node.create_subscription(kind, topic, self.heard[topic].append, qos, raw=True)

    @property
    def estimates(self):
        return [deserialize_message(data, LoadEstimate) for data in self.heard[ESTIMATE]]

    def wait_for_load_node(self):
        """Wait until it listens and speaks."""
        self.wait_until(
            lambda: self.angle.get_subscription_count() and self.ground.get_subscription_count()
        )
        self.wait_until(
            lambda: all(
                self.node.count_publishers(topic)
                for topic in ("load_estimate", "/diagnostics", REACTION)
            )
        )

    def send_sensed(self, messages):
        """Publish a leg's messages, and wait until their forces are answered."""
        forces = sum(message.topic == FORCE for message in messages) + len(self.heard[ESTIMATE])
        for message in messages:
            (self.angle if message.topic == ANGLES else self.ground).publish(message.data)
        self.wait_until(lambda: len(self.heard[ESTIMATE]) == len(self.heard[REACTION]) == forces)


@pytest.fixture
def peer():
    """This process's side of the graph, which does not publish what the node publishes."""
    peer = Peer()
    peer.node.destroy_publisher(peer.force)
    yield peer
    peer.executor.shutdown()
    peer.node.destroy_node()


@pytest.fixture
def leg():
    """This process's side of the graph."""
    peer = LegPeer()
    yield peer
    peer.executor.shutdown()
    peer.node.destroy_node()


def arguments(values):
    """The same parameters on a command line."""
    return [
        f"{name}:={str(value).lower() if isinstance(value, bool) else value}"
        for name, value in values.items()
    ]


def offline(folder, messages, values):
    """What `estimate-load` makes of them."""
    bag, output = (
        walking_bag(folder / "offline" / "walk.mcap", messages),
        folder / "offline" / "load.mcap",
    )
    estimate_load(bag, load_parameters(values, LoadParameters), output)
    return output


def told(path, topic):
    """The messages of a recording, filled up with zeros as DDS delivers them."""
    messages = [message.data for message in raw(path, [topic.removeprefix("/")])]
    return [data + bytes(-len(data) % 4) for data in messages]


@pytest.mark.parametrize("values", [{}, WHOLE_LEG | {"frame.ground": "plate_isb"}])
def test_live_messages_are_those_of_estimate_load(leg, start_node, tmp_path, values):
    """Byte for byte, also in a recording that SIGINT completes, which is computed again from itself likewise."""
    recording = tmp_path / "live" / "live.mcap"
    node = start_node(*arguments(values | PATIENT | {"record.path": recording}), kind="load")
    leg.wait_for_load_node()
    leg.send_sensed(WALK)
    output = node.stop(signal.SIGINT)
    assert (
        f"estimating the joint reaction at level {load_parameters(values, LoadParameters).chosen_level}, not calib"
        in output
    )
    assert "80 ticks, 0 samples refused" in output
    expected = offline(tmp_path, WALK, values)
    for topic, heard in leg.heard.items():
        assert heard == told(expected, topic), topic
    assert sorted(path.name for path in recording.parent.iterdir()) == [
        "live.mcap",
        "metadata.yaml",
    ]
    assert raw(recording, LOAD_RECORDED) == raw(expected, LOAD_RECORDED)
    again = tmp_path / "again.mcap"
    estimate_load(recording, load_parameters(values, LoadParameters), again)
    assert raw(again, LOAD_RECORDED) == raw(recording, LOAD_RECORDED)


def test_the_life_cycle_and_what_changes_meanwhile(leg, start_node, tmp_path):
    """Unconfigured at first; numbers of the person change between two estimates, and a recording tells of it."""
    recording, at_once = (
        tmp_path / "live.mcap",
        {"person.electromechanical_delay": 0.0},
    )  # or forces would go on
    live = WHOLE_LEG | PATIENT | at_once | {"autostart": False, "record.path": recording}
    node = start_node(*arguments(live), kind="load")
    assert state_of(leg, NODE) == State.PRIMARY_STATE_UNCONFIGURED
    accepted, reason = set_parameters(leg, {"level": "ankle_momen"}, f"/{NODE}")
    assert not accepted
    assert "parameter level: 'ankle_momen' is not allowed" in reason
    assert set_parameters(leg, {"person.mass": 80.0, "level": "knee_moment"}, f"/{NODE}") == (
        True,
        "",
    )
    assert change_state(leg, "configure", NODE)
    assert change_state(leg, "activate", NODE)
    leg.wait_for_load_node()
    leg.send_sensed(WALK[:80])
    fixed = "parameter level cannot change while the node is configured, only after a cleanup"
    assert set_parameters(leg, {"person.tone": 0.3, "level": "auto"}, f"/{NODE}") == (False, fixed)
    assert set_parameters(leg, {"person.tone": 0.6}, f"/{NODE}") == (True, "")
    leg.send_sensed(WALK[80:])
    assert change_state(leg, "deactivate", NODE)
    assert change_state(leg, "cleanup", NODE)
    assert state_of(leg, NODE) == State.PRIMARY_STATE_UNCONFIGURED
    assert not psutil.Process(node.process.pid).children()
    values = WHOLE_LEG | at_once | {"person.mass": 80.0, "level": "knee_moment"}
    before, after = (
        told(offline(tmp_path / name, WALK, values | more), ESTIMATE)
        for name, more in (("before", {}), ("after", {"person.tone": 0.6}))
    )
    assert leg.heard[ESTIMATE] == before[:40] + after[40:] == told(recording, ESTIMATE)
    with Bag(recording) as bag:
        said = dict(bag.metadata)
    assert said[PARAMETERS_CHANGED] == {"tick": "40", "person.tone": "0.6"}
    assert (said[LOAD_PROVENANCE]["level"], said[REFUSED_SAMPLES]) == (
        "knee_moment",
        {"total": "0"},
    )
    assert set_parameters(leg, {"level": "auto"}, f"/{NODE}") == (True, "")
    assert change_state(leg, "shutdown", NODE)
    node.stop()


def test_both_nodes_in_one_process_are_the_same_and_each_has_its_own_life(
    leg, start_node, tmp_path
):
    """The contact node rests and is made anew while the load node goes on: it answers what is handed over then."""
    given = {f"knee_load:{name}": value for name, value in (WHOLE_LEG | PATIENT).items()}
    node = start_node(
        *arguments(given | {f"{NODE_CONTACT}:pairing.wait": 5.0}), kind="load --with-contact"
    )
    leg.wait_for_load_node()
    leg.wait_until(lambda: leg.node.count_publishers(KNEE_CONTACT))
    leg.send_sensed(WALK[:40])
    leg.wait_until(lambda: len(leg.contacts) == 20)
    assert change_state(leg, "deactivate", NODE_CONTACT)
    leg.send_sensed(WALK[40:80])
    assert change_state(leg, "activate", NODE_CONTACT)
    leg.send_sensed(WALK[80:100])
    leg.wait_until(lambda: len(leg.contacts) == 30)
    assert change_state(leg, "deactivate", NODE_CONTACT)
    assert change_state(leg, "cleanup", NODE_CONTACT)
    assert change_state(leg, "configure", NODE_CONTACT)
    assert change_state(leg, "activate", NODE_CONTACT)
    leg.send_sensed(WALK[100:])
    leg.wait_until(lambda: len(leg.contacts) == 60)
    loads = offline(tmp_path, WALK, WHOLE_LEG)
    assert leg.heard[ESTIMATE] == told(loads, ESTIMATE)
    solve(loads, load_parameters({}), tmp_path / "contact.mcap")
    answers = answers_in(tmp_path / "contact.mcap")
    assert leg.contacts[:20] == answers[:20]
    assert [contact.status for contact in leg.contacts[20:]] == [Status.TIME_RESET, *[0] * 39]
    node.stop()


def test_both_nodes_take_person_and_encoder_from_one_section_and_say_what_nobody_set(
    peer, start_node, tmp_path
):
    file = tmp_path / "robot.yaml"
    file.write_text(
        "knee_load:\n  ros__parameters:\n    person.mass: 92.0\n    knee: {joint_name: motor, sign: -1.0}\n"
        "knee_contact:\n  ros__parameters:\n    load.share: 0.6\n"
    )
    node = start_node("--params-file", file, kind="load --with-contact")
    wanted = ["body_weight", "knee.joint_name", "knee.flexion_sign"]
    peer.client(GetParameters, "/knee_contact/get_parameters")
    found = call(
        peer, GetParameters, "/knee_contact/get_parameters", GetParameters.Request(names=wanted)
    ).values
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))
    assert found[0].double_value == pytest.approx(92.0 * 9.80665)
    assert [found[1].string_value, found[2].double_value] == ["motor", -1.0]
    said = node.stop()
    assert "nobody has set person.height (1.75 m is used)" in said
    assert "body_weight" not in said

    said = start_node("--params-file", file, "body_weight:=700.0").end()[1]
    assert "body_weight: 700 is not allowed beside person.mass 92" in said
    alone = start_node("person.mass:=92.0")
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))
    assert "nobody" not in alone.stop()
    alone = start_node()
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact"))
    assert "nobody has set body_weight (737.068 N is used)" in alone.stop()
