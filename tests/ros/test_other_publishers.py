"""Somebody else who publishes what a node publishes: told, and flagged, as long as it lasts."""

import random
import signal
from itertools import count

from geometry_msgs.msg import WrenchStamped
from knee_contact_ros.msg import KneeContact, LoadEstimate
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.streams.topics import KNEE_CONTACT
from tests.helpers.patience import wait_until
from tests.ros.conftest import STEP, raw

TOPICS = {
    "knee_contact": KneeContact,
    "knee_contact/wrench": WrenchStamped,
    "knee_contact/stride": JointState,
    "knee_contact/markers": MarkerArray,
}
NAMES = ("rosbag2_player", "knee_contact", "controller")
NAMESPACES = ("", "/left", "/a/b")


def is_told(peer, entry="knee_contact: answers"):
    """Whether the entry of the answers names another publisher."""
    return "subscribers get its messages among ours" in peer.problems.get(entry, "")


def test_each_other_publisher_is_told_and_all_answers_are_flagged_meanwhile(
    peer, start_node, tmp_path
):
    """Drawn publishers, by topic and by the name of their node; the recording computes to the same flags."""
    draw, stamp, expected = random.Random(63), 0, []
    node = start_node(f"record.path:={tmp_path / 'r.mcap'}")
    peer.wait_for_node()
    peer.wait_until(lambda: "knee_contact: answers" in peer.problems)
    assert not is_told(peer)

    def answer(flagged):
        nonlocal stamp
        for _ in range(5):
            stamp += STEP
            peer.send(stamp, 0.3, 800.0)
            expected.append(Status.SEVERAL_PUBLISHERS if flagged else 0)
        peer.wait_until(lambda: len(peer.contacts) == len(expected))

    answer(flagged=False)
    for _ in range(4):
        topic, kind = draw.choice(list(TOPICS.items()))
        other = Node(draw.choice(NAMES), namespace=draw.choice(NAMESPACES))
        other.create_publisher(kind, f"/{topic}", 10)
        peer.wait_until(lambda: is_told(peer))
        assert f"/{topic}" in peer.problems["knee_contact: answers"]
        assert other.get_fully_qualified_name() in peer.problems["knee_contact: answers"]
        assert peer.diagnostics["knee_contact: answers"]["usable"] == "false"
        answer(flagged=True)
        other.destroy_node()
        peer.wait_until(lambda: not is_told(peer))
        answer(flagged=False)
    said = node.stop()
    assert said.count("[ERROR]") - said.count("another node is called") == 4
    assert [contact.status for contact in peer.contacts] == expected
    with Bag(tmp_path / "r.mcap") as bag:
        basis = read_provenance(bag)
        assert basis is not None
        solve(bag, basis, tmp_path / "again.mcap")
    live, again = (raw(tmp_path / name, [KNEE_CONTACT]) for name in ("r.mcap", "again.mcap"))
    assert live == again
    assert len(live) == len(expected)


def test_a_node_whose_namesake_was_killed_tells_nothing(peer, start_node):
    """The middleware knows the publishers of a killed process for another 20 s."""
    first = start_node()
    peer.wait_for_node()
    first.process.send_signal(signal.SIGKILL)
    first.process.wait(20)
    second = start_node()
    peer.diagnostics.clear()
    begun = peer.reports
    peer.wait_until(lambda: peer.reports > begun + 1)
    assert peer.node.count_publishers("knee_contact") == 2
    stamps = count(STEP, STEP)  # the first samples may come before both know each other

    def ask():
        peer.send(next(stamps), 0.3, 800.0)
        peer.spin(0.1)

    wait_until(lambda: any(contact.status == 0 for contact in peer.contacts), ask)
    assert not any(contact.status & KneeContact.SEVERAL_PUBLISHERS for contact in peer.contacts)
    assert "another node" not in second.stop()


def test_another_estimate_of_the_load_is_told(peer, start_node):
    estimates: list[LoadEstimate] = []
    peer.node.create_subscription(LoadEstimate, "load_estimate", estimates.append, 10)
    ground = peer.node.create_publisher(WrenchStamped, "ground_reaction_force", 10)
    start_node(kind="load")
    other = peer.node.create_publisher(WrenchStamped, "joint_reaction_force", 10)
    peer.wait_until(lambda: is_told(peer, "knee_load: answers"))
    peer.wait_until(ground.get_subscription_count)
    assert other is not None
    for i in range(1, 6):
        peer.send_angle(i * STEP, 0.1)
        wrench = WrenchStamped()
        wrench.header.stamp.nanosec = i * STEP
        ground.publish(wrench)
    peer.wait_until(lambda: len(estimates) == 5)
    assert all(each.status & LoadEstimate.SEVERAL_PUBLISHERS for each in estimates)
    assert LoadEstimate.UNUSABLE & LoadEstimate.SEVERAL_PUBLISHERS
