"""The markers for RViz, over a real topic: where the answers say."""

from __future__ import annotations

from typing import Any

from visualization_msgs.msg import Marker, MarkerArray

from knee_contact_ros.streams.topics import KNEE_CONTACT_MARKERS
from tests.helpers.markers import place_of
from tests.ros.conftest import Peer, Start

STEP = 50_000_000
"""Between two samples [ns]: longer than between two pictures"""
NAMES = ["tibia", "femur", "contact_point", "contact_force_on_femur"]


def stamp_of(message: Any) -> int:
    return int(1_000_000_000 * message.header.stamp.sec + message.header.stamp.nanosec)


def test_what_is_shown_is_the_answer(peer: Peer, start_node: Start) -> None:
    """In its frame, at its place; how markers look is tested with the view."""
    start_node()
    peer.wait_for_node()
    pictures: list[Any] = []
    peer.wait_until(lambda: peer.node.count_publishers(KNEE_CONTACT_MARKERS))
    peer.node.create_subscription(MarkerArray, KNEE_CONTACT_MARKERS, pictures.append, 10)
    number = 0
    while len({marker.action for picture in pictures for marker in picture.markers[-1:]}) < 2 and number < 200:
        peer.send(number * STEP, 0.02 * (number % 50), 450.0 * (number % 3))
        number += 1
        peer.wait_until(lambda: len(peer.contacts) == number)  # noqa: B023
        peer.spin(0.06)
    shown = {stamp_of(picture.markers[0]): picture.markers for picture in pictures}
    answers = {stamp_of(contact): contact for contact in peer.contacts}
    for stamp, markers in shown.items():
        contact = answers[stamp]
        assert [marker.ns for marker in markers] == [f"knee/{name}" for name in NAMES]
        assert {stamp_of(marker) for marker in markers} == {stamp}
        assert {marker.header.frame_id for marker in markers} == {contact.header.frame_id} == {"tibia_r"}
        _, _, point, force = markers
        assert place_of(point).tolist() == [contact.contact_point.x, contact.contact_point.y, contact.contact_point.z]
        assert force.action == (Marker.ADD if contact.contact_force else Marker.DELETE)
    assert {bool(answers[stamp].contact_force) for stamp in shown} == {True, False}
