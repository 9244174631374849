"""The bytes of a `LoadEstimate` against the bytes that rosbags writes, and against ROS's own reader."""

from __future__ import annotations

from typing import Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st
from knee_contact_ros.msg import LoadEstimate
from rclpy.serialization import deserialize_message

from knee_contact_ros.joint_reaction.estimator import LEVELS, Estimate
from knee_contact_ros.model.types import UNUSABLE, Status
from knee_contact_ros.streams.load_stream import encode_estimate
from knee_contact_ros.streams.topics import LOAD_ESTIMATE, MESSAGE_TYPES, deserialize, typestore
from tests.helpers.messages import PlainMessages, header

TYPE = MESSAGE_TYPES[LOAD_ESTIMATE]
KINDS = {"float": st.floats(), "int": st.integers(0, 255), "bool": st.booleans()}
estimates = st.builds(
    Estimate, **{name: KINDS[kind.__name__] for name, kind in get_type_hints(Estimate).items()}
)  # fmt: skip
frames = st.text(max_size=17).filter(lambda text: "\x00" not in text)
"""Of any length; a text of ROS's ends with a zero"""
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def told(message: Any) -> list[str]:
    """What a message says behind its header; what is not a number is like itself."""
    return [repr(getattr(message, name)) for name in Estimate._fields]


@given(stamps, frames, estimates)
def test_the_bytes_are_those_of_rosbags(stamp: int, frame: str, estimate: Estimate) -> None:
    plain = typestore().types[TYPE](header=header(PlainMessages(), stamp, frame), **estimate._asdict())
    expected = bytes(typestore().serialize_cdr(plain, TYPE))
    assert encode_estimate(stamp, frame, estimate) == expected
    read = deserialize(expected, LOAD_ESTIMATE)
    assert told(read) == told(estimate)
    assert (read.header.frame_id, read.header.stamp.sec * 10**9 + read.header.stamp.nanosec) == (frame, stamp)


@given(st.integers(0, 2**31 * 10**9 - 1), frames, estimates)
def test_ros_reads_what_was_meant(stamp: int, frame: str, estimate: Estimate) -> None:
    read = deserialize_message(encode_estimate(stamp, frame, estimate), LoadEstimate)
    assert told(read) == told(estimate)
    assert (read.header.frame_id, read.header.stamp.sec * 10**9 + read.header.stamp.nanosec) == (frame, stamp)


@pytest.mark.parametrize("stamp", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_stamp_beyond_what_ros_can_hold_is_refused(stamp: int) -> None:
    with pytest.raises(ValueError, match="stamp"):
        encode_estimate(stamp, "", Estimate(*[0.0] * 11, 0, False, 0))


def test_constants_are_those_of_the_package() -> None:
    for name, way in LEVELS.items():
        assert getattr(LoadEstimate, name.upper()) == way.level
    known = [bit for bit in Status if hasattr(LoadEstimate, bit.name or "")]
    assert [getattr(LoadEstimate, bit.name or "") for bit in known] == known
    assert sum(known) & UNUSABLE == LoadEstimate.UNUSABLE
    fields = [name for name in LoadEstimate.get_fields_and_field_types() if name != "header"]
    assert fields == list(Estimate._fields)
