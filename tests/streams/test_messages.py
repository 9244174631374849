"""Our own coder against ROS's and that of rosbags: the same content, or none."""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped as RosWrenchStamped
from hypothesis import example, given, settings
from hypothesis import strategies as st
from knee_contact_ros.msg import KneeContact
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState as RosJointState

from knee_contact_ros.streams import messages as coding
from knee_contact_ros.streams.columns import Column, decode_all
from knee_contact_ros.streams.messages import (
    JointState,
    RefusedSampleError,
    WrenchStamped,
    encode_answer,
    encode_answer_wrench,
)
from knee_contact_ros.streams.topics import stamp_to_ns, typestore
from tests.helpers.answers import contact, contacts_of
from tests.helpers.messages import (
    PlainMessages,
    RosMessages,
    contact_message,
    header,
    message_class,
    wrench_message,
)

PLAIN, ROS = PlainMessages, RosMessages
SECOND = 1_000_000_000
FIRST_STAMP, LAST_STAMP = -(2**31) * SECOND, 2**31 * SECOND - 1

stamps = st.integers(FIRST_STAMP, LAST_STAMP)
texts = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=20
) | st.just("é" * 200)
numbers = st.floats(width=64)
sequences = st.lists(numbers, max_size=5).map(tuple) | st.just((0.5, float("nan")) * 100)
triples = st.tuples(numbers, numbers, numbers)

JOINT_STATE = JointState(1_500_000_007, "tibia", ("knee", "hip", ""), (0.1, -2.0, 3.0), (), (4.0,))
WRENCH = WrenchStamped(-1, "tibia_r", (1.0, -800.0, 3.0), (0.4, 0.5, 0.6))
CONTACT = contact()


def plain_joint_state(message):
    return message_class("sensor_msgs/msg/JointState")(
        header(PLAIN, message.stamp, message.frame_id),
        list(message.name),
        *map(np.array, map(list, message[3:])),
    )


def plain_wrench(message):
    wrench = PLAIN.Wrench(
        force=PLAIN.Vector3(*message.force), torque=PLAIN.Vector3(*message.torque)
    )
    return PLAIN.WrenchStamped(header(PLAIN, message.stamp, message.frame_id), wrench)


def of_joint_state(message):
    given = (
        tuple(value)
        for value in (message.name, message.position, message.velocity, message.effort)
    )
    return JointState(stamp_to_ns(message.header.stamp), message.header.frame_id, *given)


def of_wrench(message):
    force, torque = (
        (vector.x, vector.y, vector.z) for vector in (message.wrench.force, message.wrench.torque)
    )
    return WrenchStamped(stamp_to_ns(message.header.stamp), message.header.frame_id, force, torque)


class Kind(NamedTuple):
    """A message type, its coder, and what there is to go to the other forms and back."""

    name: str
    coder: Any
    ros_class: Any
    plain: Callable[[Any], Any]
    read: Callable[[Any], Any]
    messages: st.SearchStrategy[Any]
    example: Any

    def decode(self, data):
        decoded = self.coder.decode_message(data)
        return decoded and decoded[0]

    def rosbags_bytes(self, message, little_endian=True):
        return bytes(
            typestore().serialize_cdr(self.plain(message), self.name, little_endian=little_endian)
        )

    def ros_decode(self, data):
        """What ROS makes of the bytes; None if it refuses them."""
        try:
            return self.read(deserialize_message(data, self.ros_class))
        except Exception:
            return None

    def ros_bytes(self, message):
        """What ROS writes, with old memory between the fields."""
        return bytes(
            serialize_message(deserialize_message(self.rosbags_bytes(message), self.ros_class))
        )


KINDS = [
    Kind(
        "sensor_msgs/msg/JointState",
        coding.JOINT_STATE,
        RosJointState,
        plain_joint_state,
        of_joint_state,
        st.builds(
            JointState,
            stamps,
            texts,
            st.lists(texts, max_size=5).map(tuple),
            sequences,
            sequences,
            sequences,
        ),
        JOINT_STATE,
    ),
    Kind(
        "geometry_msgs/msg/WrenchStamped",
        coding.WRENCH,
        RosWrenchStamped,
        plain_wrench,
        of_wrench,
        st.builds(WrenchStamped, stamps, texts, triples, triples),
        WRENCH,
    ),
]
STATES, WRENCHES = KINDS
kinds = st.sampled_from(KINDS)
kinds_and_messages = kinds.flatmap(lambda kind: st.tuples(st.just(kind), kind.messages))
each_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


def bits(message):
    """The message with the bits of its numbers, which compare for NaN and tell -0 from 0."""
    if isinstance(message, float):
        return struct.pack("d", message)
    return tuple(map(bits, message)) if isinstance(message, tuple) else message


def assert_none_or_as_ros(kind, data):
    message = kind.decode(data)
    if message is not None:
        assert bits(message) == bits(kind.ros_decode(data))
    return message


@given(kinds_and_messages)
def test_messages_of_ros_and_rosbags_are_read_and_written(
    case,
):
    kind, message = case
    written = kind.coder.encode_message(message)
    assert written == kind.rosbags_bytes(message)
    from_ros, big_endian = (
        kind.ros_bytes(message),
        kind.rosbags_bytes(message, little_endian=False),
    )
    for data in (written, from_ros, bytearray(from_ros), memoryview(from_ros), big_endian):
        read, recorded = kind.coder.decode_message(data)
        assert type(read) is type(message)
        assert bits(read) == bits(message) == bits(kind.ros_decode(bytes(data)))
        assert recorded == written


@each_kind
@pytest.mark.parametrize("little_endian", [True, False])
def test_truncated_messages_are_refused_and_surplus_bytes_ignored(kind, little_endian):
    data = kind.rosbags_bytes(kind.example, little_endian)
    assert [kind.decode(data[:length]) for length in range(len(data))] == [None] * len(data)
    assert [kind.decode(data + b"\xff" * surplus) for surplus in range(14)] == [
        kind.example
    ] * 13 + [None]
    ros_bytes = kind.ros_bytes(kind.example)
    for length in range(len(ros_bytes)):
        assert (assert_none_or_as_ros(kind, ros_bytes[:length]) is not None) == (
            length >= len(data)
        )


@each_kind
@pytest.mark.parametrize("little_endian", [True, False])
def test_every_byte_matters_to_us_as_it_does_to_ros(kind, little_endian):
    data = kind.rosbags_bytes(kind.example, little_endian)
    without_effect = 0
    for index in range(2, len(data)):
        changed = data[:index] + bytes([data[index] ^ 0xFF]) + data[index + 1 :]
        message = assert_none_or_as_ros(kind, changed)
        if kind.ros_decode(changed) == kind.example:
            without_effect += 1
            assert (
                message == kind.example
            )  # options and padding: what lies there must not cost the fast way
    assert without_effect > 2


@each_kind
@pytest.mark.parametrize("text", [b"tibia\xff_", b"ti\xed\xa0\x80_r"])
def test_text_that_is_no_utf_8_is_read_as_rclpy_does(kind, text):
    data = kind.coder.encode_message(kind.example._replace(frame_id="tibia_r"))
    for _ in range(2):
        read, recorded = kind.coder.decode_message(data[:16] + text + data[23:])
        assert "\ufffd" in read.frame_id
        assert read == kind.ros_decode(data[:16] + text + data[23:])
        assert recorded == kind.rosbags_bytes(read)


words = st.sampled_from([0, 1, 2, 3, 5, 2**16, 2**29, 2**31, 2**32 - 1]).map(
    lambda word: struct.pack("<I", word)
)


@settings(max_examples=300)
@given(
    kinds,
    st.sampled_from([b"", b"\x00\x00\x00\x00", b"\x00\x01\x00\x00"]),
    st.binary(max_size=120)
    | st.lists(words | st.just(b"a\x00\x00\x00"), max_size=40).map(b"".join),
)
@example(KINDS[0], b"\x00\x01\x00\x00", b"")
def test_any_bytes_are_read_as_ros_does_or_refused(kind, start, rest):
    assert_none_or_as_ros(kind, start + rest)


def test_messages_of_equal_length_are_distinguished():
    messages = [
        JOINT_STATE,
        JOINT_STATE._replace(name=("knee", "toe", "")),
        JOINT_STATE._replace(frame_id="femur", stamp=-5),
        JOINT_STATE._replace(position=(), velocity=(1.0, 2.0, 3.0)),
        JOINT_STATE._replace(position=(7.0,), velocity=(1.0, 2.0)),
    ]
    coded = [(coding.JOINT_STATE.encode_message(message), message) for message in messages]
    assert len({len(data) for data, _ in coded[:3]}) == 1
    for data, message in coded * 2:
        assert STATES.decode(data) == message


@example(FIRST_STAMP, "", contact(evaluations=2**32 - 1))
@example(LAST_STAMP, "tibia_r", CONTACT)
@given(stamps, texts, contacts_of(numbers))
def test_an_answer_is_written_as_publish_and_rosbags_do(stamp, frame_id, contact):
    data = encode_answer(stamp, frame_id, contact.tobytes())
    plain = contact_message(PLAIN, stamp, frame_id, contact)
    assert data == bytes(typestore().serialize_cdr(plain, "knee_contact_ros/msg/KneeContact"))
    expected = contact_message(ROS, stamp, frame_id, contact)
    assert repr(deserialize_message(data, KneeContact)) == repr(
        expected
    )  # NaN is not equal to itself
    data = encode_answer_wrench(stamp, frame_id, contact.tobytes())
    plain = wrench_message(PLAIN, stamp, frame_id, contact)
    assert data == bytes(typestore().serialize_cdr(plain, "geometry_msgs/msg/WrenchStamped"))
    assert bits(WRENCHES.decode(data)) == bits(of_wrench(plain)) == bits(WRENCHES.ros_decode(data))


@pytest.mark.parametrize("stamp", [FIRST_STAMP - 1, LAST_STAMP + 1])
def test_a_stamp_that_no_message_can_hold_is_refused(stamp):
    for encode in (
        lambda: coding.JOINT_STATE.encode_message(JOINT_STATE._replace(stamp=stamp)),
        lambda: coding.WRENCH.encode_message(WRENCH._replace(stamp=stamp)),
        lambda: encode_answer(stamp, "tibia_r", CONTACT.tobytes()),
        lambda: encode_answer_wrench(stamp, "tibia_r", CONTACT.tobytes()),
    ):
        with pytest.raises(ValueError, match=f"{stamp} ns is beyond"):
            encode()


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("nanoseconds", [10**9, 10**9 + 1, 2**32 - 1])
def test_a_time_with_a_second_or_more_of_nanoseconds_is_refused(order, nanoseconds):
    """Senders that truncate an epoch in nanoseconds to 32 bits make such times; nobody knows what they mean."""
    coders: tuple[tuple[Any, Any], ...] = (
        (coding.JOINT_STATE, JointState(10**18, "", ("knee",), (0.1,), (), ())),
        (coding.WRENCH, WrenchStamped(10**18, "tibia", (0.0, 1.0, 2.0), (0.0, 0.0, 0.0))),
    )
    for coder, content in coders:
        data = bytearray(coder.encode_message(content))
        if order == "big":
            data[:12] = b"\x00\x00\x00\x00" + (10**9).to_bytes(4, "big") + bytes(4)
        data[8:12] = nanoseconds.to_bytes(4, order)
        assert coder.decode_message(bytes(data)) is None
        with pytest.raises(
            RefusedSampleError, match=r"stamp\.nanosec is \d+, and must be below"
        ) as refused:
            coder.read_message(bytes(data), "topic")
        assert refused.value.reason == "bad_stamp"
        if order == "little":
            good = coder.encode_message(content)
            assert decode_all(coder, Column.of([good, bytes(data)])) is None


def test_a_message_is_refused_by_its_size_before_it_is_decoded():
    def message(numbers):
        state = JointState(10**18, "", ("knee",), (0.1,) * numbers, (), ())
        return coding.JOINT_STATE.encode_message(state)

    largest = (coding.LARGEST_MESSAGE - len(message(2))) // 8 + 2
    fits, large = message(largest), message(largest + 1)
    assert len(fits) <= coding.LARGEST_MESSAGE < len(large)
    assert len(coding.JOINT_STATE.read_message(fits, "topic")[0].position) == largest
    text = f"topic: a message of {len(large)} bytes is not read; at most 262144 are"
    for read in (
        lambda: coding.JOINT_STATE.read_message(large, "topic"),
        lambda: coding.check_size(large, "topic"),
    ):
        with pytest.raises(RefusedSampleError, match=text) as refused:
            read()
        assert refused.value.reason == "too_large"
    assert coding.JOINT_STATE.decode_message(bytes(10**8)) is None
    trailing = large[: coding.LARGEST_MESSAGE - len(fits)]
    assert decode_all(coding.JOINT_STATE, Column.of([fits, fits + trailing + bytes(4)])) is None
