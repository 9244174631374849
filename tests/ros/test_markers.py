"""The markers for RViz, over a real topic: while somebody looks, and where the answers say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from visualization_msgs.msg import Marker, MarkerArray

from knee_contact_ros.streams.topics import KNEE_CONTACT_MARKERS
from tests.helpers.markers import place_of
from tests.ros.conftest import NodeProcess, Peer

Start = Callable[..., NodeProcess]
STEP = 50_000_000
"""Between two samples [ns]: longer than between two pictures, so that every answer is shown"""
NAMES = ["tibia", "femur", "contact_point", "contact_force_on_femur"]


class Screen:
    """What a viewer gets."""

    def __init__(self, peer: Peer, topic: str = KNEE_CONTACT_MARKERS) -> None:
        self._peer = peer
        self.pictures: list[Any] = []
        peer.wait_until(lambda: peer.node.count_publishers(topic))
        self._subscription = peer.node.create_subscription(MarkerArray, topic, self.pictures.append, 10)
        peer.spin(0.5)  # the node has to know of it, and nothing says when

    def shown(self, stamp: int) -> dict[str, Any]:
        """The markers of the answer at a stamp [ns], by name, when they have come."""
        self._peer.wait_until(lambda: self.pictures and stamp_of(self.pictures[-1]) >= stamp)
        assert stamp_of(self.pictures[-1]) == stamp
        return {marker.ns: marker for marker in self.pictures[-1].markers}

    def close(self) -> None:
        """Look no more."""
        self._peer.node.destroy_subscription(self._subscription)


def stamp_of(picture: Any) -> int:
    (stamp,) = {1_000_000_000 * m.header.stamp.sec + m.header.stamp.nanosec for m in picture.markers}
    return int(stamp)


def test_what_is_shown_is_the_answer(peer: Peer, start_node: Start) -> None:
    """In its frame, at its place; how markers look is tested with the view."""
    start_node()
    peer.wait_for_node()
    screen = Screen(peer)
    for number in range(5):
        peer.send(number * STEP, 0.02 * number, 450.0 * number)
        peer.wait_until(lambda number=number: len(peer.contacts) == number + 1)
        contact, markers = peer.contacts[-1], screen.shown(number * STEP)
        assert list(markers) == [f"knee/{name}" for name in NAMES]
        assert {marker.header.frame_id for marker in markers.values()} == {contact.header.frame_id} == {"tibia_r"}
        _, _, point, force = markers.values()
        assert place_of(point).tolist() == [contact.contact_point.x, contact.contact_point.y, contact.contact_point.z]
        assert force.action == (Marker.ADD if contact.contact_force else Marker.DELETE)
