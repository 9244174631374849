"""Markers as bytes against ROS's own reader, and against the bytes that rosbags writes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker as RosMarker
from visualization_msgs.msg import MarkerArray

from knee_contact_ros.streams.topics import typestore
from knee_contact_ros.view.marker_message import LIFETIME, Action, Marker, MarkerMessage, Shape

numbers = st.floats(-1e3, 1e3)
pairs = st.tuples(numbers, numbers)
parts = st.integers(0, 255).map(lambda part: float(np.float32(part / 255.0)))
colours = st.tuples(parts, parts, parts)
texts = st.text(max_size=9).filter(lambda text: "\x00" not in text)
"""Which ROS's texts cannot hold"""
lines = st.lists(pairs, max_size=4)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


class Drawn(NamedTuple):
    """A marker, and what is set later, if anything."""

    name: str
    shape: Shape
    scale: tuple[float, float, float]
    colour: tuple[float, float, float]
    line: list[tuple[float, float]]
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shown: bool = True

    @property
    def marker(self) -> Marker:
        """What does not change."""
        return Marker(self.name, self.shape, self.scale, self.colour, np.array(self.line, float).reshape(-1, 2))


things = st.builds(
    Drawn,
    name=texts,
    shape=st.sampled_from(Shape),
    scale=st.tuples(numbers, numbers, numbers),
    colour=colours,
    line=lines,
    pose=st.tuples(numbers, numbers, st.floats(-7.0, 7.0)),
    shown=st.booleans(),
)


def encoded(stamp: int, frame_id: str, drawn: list[Drawn]) -> bytes:
    """The message, which looked otherwise before."""
    message = MarkerMessage(frame_id, [one.marker for one in drawn])
    for number, one in enumerate(drawn):
        message.paint(number, (0.1, 0.2, 0.3))
        message.move(number, 1.0, 2.0, 3.0)
        message.show(number, not one.shown)
        message.place(number, *[(-x, y + 1.0, 0.0) for x, y in one.line])
    message.set_stamp(7)
    before = message.tobytes()
    for number, one in enumerate(drawn):
        message.paint(number, one.colour)
        message.move(number, *one.pose)
        message.show(number, one.shown)
        message.place(number, *[(x, y, 0.0) for x, y in one.line])
    message.set_stamp(stamp)
    assert len(message.tobytes()) == len(before)
    return message.tobytes()


def plain(stamp: int, frame_id: str, drawn: list[Drawn]) -> Any:
    """The same as an object of rosbags."""
    types: Any = typestore().types
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]

    def header(seconds: int, nanoseconds: int, frame: str) -> Any:
        time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def one(marker: Drawn) -> Any:
        x, y, turn = marker.pose
        turned = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(0.5 * turn), w=math.cos(0.5 * turn))
        return types["visualization_msgs/msg/Marker"](
            header=header(*divmod(stamp, 10**9), frame_id),
            ns=marker.name,
            id=0,
            type=int(marker.shape),
            action=0 if marker.shown else 2,
            pose=types["geometry_msgs/msg/Pose"](position=point(x=x, y=y, z=0.0), orientation=turned),
            scale=vector(*marker.scale),
            color=types["std_msgs/msg/ColorRGBA"](*marker.colour, a=1.0),
            lifetime=types["builtin_interfaces/msg/Duration"](sec=LIFETIME, nanosec=0),
            frame_locked=True,
            points=[point(x, y, 0.0) for x, y in marker.line],
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

    return types["visualization_msgs/msg/MarkerArray"](markers=[one(marker) for marker in drawn])


@given(stamp=stamps, frame_id=texts, drawn=st.lists(things, max_size=4))
def test_the_bytes_are_those_of_rosbags(stamp: int, frame_id: str, drawn: list[Drawn]) -> None:
    expected = typestore().serialize_cdr(plain(stamp, frame_id, drawn), "visualization_msgs/msg/MarkerArray")
    assert encoded(stamp, frame_id, drawn) == bytes(expected)


@given(frame_id=texts, drawn=st.lists(things, max_size=4))
def test_at_first_all_is_shown_at_the_origin(frame_id: str, drawn: list[Drawn]) -> None:
    first = [one._replace(pose=(0.0, 0.0, 0.0), shown=True) for one in drawn]
    assert MarkerMessage(frame_id, [one.marker for one in drawn]).tobytes() == encoded(0, frame_id, first)


@given(stamp=stamps, frame_id=texts, drawn=st.lists(things, max_size=4))
def test_ros_reads_what_was_meant(stamp: int, frame_id: str, drawn: list[Drawn]) -> None:
    read = deserialize_message(encoded(stamp, frame_id, drawn), MarkerArray).markers
    assert [marker.ns for marker in read] == [one.name for one in drawn]
    for one, meant in zip(read, drawn, strict=True):
        assert (one.header.stamp.sec * 10**9 + one.header.stamp.nanosec, one.header.frame_id) == (stamp, frame_id)
        assert (one.id, one.type, one.action) == (0, meant.shape, RosMarker.ADD if meant.shown else RosMarker.DELETE)
        x, y, turn = meant.pose
        assert (one.pose.position.x, one.pose.position.y, one.pose.position.z) == (x, y, 0.0)
        half_turn = 2.0 * math.atan2(one.pose.orientation.z, one.pose.orientation.w)
        assert math.cos(half_turn - turn) == pytest.approx(1.0, abs=1e-15)  # a rounding
        assert (one.scale.x, one.scale.y, one.scale.z) == meant.scale
        assert (one.color.r, one.color.g, one.color.b, one.color.a) == (*meant.colour, 1.0)
        assert (one.lifetime.sec, one.lifetime.nanosec, one.frame_locked) == (LIFETIME, 0, True)
        assert [(point.x, point.y, point.z) for point in one.points] == [(*point, 0.0) for point in meant.line]
        assert (one.colors, one.text, one.mesh_resource, one.mesh_use_embedded_materials) == ([], "", "", False)


def test_shapes_and_actions_are_those_of_the_message() -> None:
    for member in (*Shape, *Action):
        assert getattr(RosMarker, member.name) == member


def test_a_stamp_that_ros_cannot_hold_is_refused() -> None:
    with pytest.raises(ValueError, match="stamp"):
        MarkerMessage("tibia", []).set_stamp(2**31 * 10**9)
