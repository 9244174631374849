"""Markers as bytes against ROS's own reader, and against the bytes that rosbags writes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker as RosMarker
from visualization_msgs.msg import MarkerArray

from knee_contact_ros.messages.marker_out import LIFETIME, Action, Marker, Pose, Shape, encode_markers, points_of
from knee_contact_ros.messages.ros_types import typestore

numbers = st.floats(-1e3, 1e3)
parts = st.integers(0, 255).map(lambda part: float(np.float32(part / 255.0)))
texts = st.text(max_size=9).filter(lambda text: "\x00" not in text)
"""Which ROS's texts cannot hold"""
lines = st.lists(st.tuples(numbers, numbers), max_size=4).map(lambda line: np.array(line, float).reshape(-1, 2))
markers = st.builds(
    Marker,
    name=texts,
    shape=st.sampled_from(Shape),
    scale=st.tuples(numbers, numbers, numbers),
    colour=st.tuples(parts, parts, parts),
    pose=st.builds(Pose, numbers, numbers, st.floats(-7.0, 7.0)),
    points=lines.map(points_of),
    action=st.sampled_from(Action),
)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def plain(stamp: int, frame_id: str, given: list[Marker]) -> Any:
    """The same as an object of rosbags."""
    types: Any = typestore().types
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]

    def header(seconds: int, nanoseconds: int, frame: str) -> Any:
        time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def one(marker: Marker) -> Any:
        x, y, turn = marker.pose
        turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(0.5 * turn), w=math.cos(0.5 * turn))
        return types["visualization_msgs/msg/Marker"](
            header=header(*divmod(stamp, 10**9), frame_id),
            ns=marker.name,
            id=0,
            type=int(marker.shape),
            action=int(marker.action),
            pose=types["geometry_msgs/msg/Pose"](position=point(x=x, y=y, z=0.0), orientation=turned),
            scale=vector(*marker.scale),
            color=types["std_msgs/msg/ColorRGBA"](*marker.colour, a=1.0),
            lifetime=types["builtin_interfaces/msg/Duration"](sec=LIFETIME, nanosec=0),
            frame_locked=True,
            points=[point(*numbers) for numbers in np.frombuffer(marker.points).reshape(-1, 3).tolist()],
            colors=[],
            texture_resource="",
            texture=types["sensor_msgs/msg/CompressedImage"](
                header=header(0, 0, ""), format="", data=np.zeros(0, np.uint8)
            ),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=types["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )

    return types["visualization_msgs/msg/MarkerArray"](markers=[one(marker) for marker in given])


@given(stamp=stamps, frame_id=texts, given_markers=st.lists(markers, max_size=4))
def test_the_bytes_are_those_of_rosbags(stamp: int, frame_id: str, given_markers: list[Marker]) -> None:
    message = plain(stamp, frame_id, given_markers)
    expected = bytes(typestore().serialize_cdr(message, "visualization_msgs/msg/MarkerArray"))
    assert encode_markers(stamp, frame_id, given_markers) == expected


@given(stamp=stamps, frame_id=texts, given_markers=st.lists(markers, max_size=4))
def test_ros_reads_what_was_meant(stamp: int, frame_id: str, given_markers: list[Marker]) -> None:
    read = deserialize_message(encode_markers(stamp, frame_id, given_markers), MarkerArray).markers
    assert [marker.ns for marker in read] == [marker.name for marker in given_markers]
    for one, meant in zip(read, given_markers, strict=True):
        assert (one.header.stamp.sec * 10**9 + one.header.stamp.nanosec, one.header.frame_id) == (stamp, frame_id)
        assert (one.id, one.type, one.action) == (0, meant.shape, meant.action)
        assert (one.pose.position.x, one.pose.position.y, one.pose.position.z) == (meant.pose.x, meant.pose.y, 0.0)
        half_turn = 2.0 * math.atan2(one.pose.orientation.z, one.pose.orientation.w)
        assert math.cos(half_turn - meant.pose.turn) == pytest.approx(1.0, abs=1e-15)  # a rounding
        assert (one.scale.x, one.scale.y, one.scale.z) == meant.scale
        assert (one.color.r, one.color.g, one.color.b, one.color.a) == (*meant.colour, 1.0)
        assert (one.lifetime.sec, one.lifetime.nanosec, one.frame_locked) == (LIFETIME, 0, True)
        points = [(point.x, point.y, point.z) for point in one.points]
        assert points == [tuple(point) for point in np.frombuffer(meant.points).reshape(-1, 3).tolist()]
        assert (one.colors, one.text, one.mesh_resource, one.mesh_use_embedded_materials) == ([], "", "", False)


def test_shapes_and_actions_are_those_of_the_message() -> None:
    for member in (*Shape, *Action):
        assert getattr(RosMarker, member.name) == member


def test_a_stamp_that_ros_cannot_hold_is_refused() -> None:
    with pytest.raises(ValueError, match="stamp"):
        encode_markers(2**31 * 10**9, "tibia", [])
