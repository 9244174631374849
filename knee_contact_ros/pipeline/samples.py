"""Messages to samples: the only place where joint names and signs are applied."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from knee_contact_ros.messages.cdr import JOINT_STATE, WRENCH, Coder, Content, JointState, WrenchStamped
from knee_contact_ros.messages.stamps import NANOSECONDS, stamp_to_ns
from knee_contact_ros.messages.topics import JOINT_STATES
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.parameters.compartments import Rule
from knee_contact_ros.parameters.schema import Knee
from knee_contact_ros.system.printable import listed, printable

LAST_STAMP = 2**31 * NANOSECONDS - 1
"""Latest stamp [ns] that a ROS message can hold"""


class RefusedSampleError(Exception):
    """A sample cannot be used; `reason` is the name of its counter, the text says what is wrong."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(printable(text))
        self.reason = reason


class AngleSample(NamedTuple):
    """Flexion angle at a stamp, and femoral height with the displacement drive."""

    stamp: int
    """Stamp [ns] at which the angle holds: that of the message minus `delay`, which may be negative"""
    angle: float
    """Flexion angle [rad], positive in flexion"""
    data: bytes = b""
    """Bytes of the message as it is recorded; those that came may hold old memory of the sender between fields"""
    height: float | None = None
    """Height of the femoral reference point [m]; None with the force drive"""
    delay: int = 0
    """Delay of the angles `pairing.angle_delay` [ns]"""
    others: tuple[float, ...] = ()
    """Further numbers of the leg's joints [rad] or [N m], in the order of `leg_sample`"""

    @property
    def came_at(self) -> int:
        """Stamp [ns] of the message, under which it is recorded."""
        return self.stamp + self.delay


class LoadSample(NamedTuple):
    """Joint reaction at a stamp, which is split between the compartments when the flexion angle is known."""

    stamp: int
    """Stamp [ns]"""
    axial: float
    """Axial force -force.y [N], positive when it presses the femur onto the tibia"""
    moment: float
    """Frontal moment about x [N m]; NaN if it is not needed and was not given"""
    frame_id: str
    """Name of the tibia frame"""
    data: bytes = b""
    """Bytes of the message as it is recorded"""
    arrived: float = 0.0
    """Time of arrival by the caller's clock [s]"""
    wrench: WrenchStamped | None = None
    """The whole wrench, where more is used than the axial force"""


Deserialize = Callable[[bytes, str], Any]
"""General deserializer: returns a message from its bytes and its topic; raises anything if they are no such message"""


class Decoder:
    """Reader of the input messages: our own coder, or the general deserializer for messages that it cannot read."""

    def __init__(self, deserialize: Deserialize) -> None:
        self.ordinary = 0
        """Number of messages for the general deserializer"""
        self._deserialize = deserialize

    def joint_state(self, data: bytes) -> tuple[JointState, bytes]:
        """Content of a JointState, and the bytes in which it is recorded.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return JOINT_STATE.decode(data) or self._deserialized(data, JOINT_STATES, JOINT_STATE, joint_state_of)

    def force(self, data: bytes, topic: str) -> tuple[WrenchStamped, bytes]:
        """Content of a WrenchStamped of a topic, and the bytes in which it is recorded.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return WRENCH.decode(data) or self._deserialized(data, topic, WRENCH, wrench_of)

    def _deserialized(
        self, data: bytes, topic: str, coder: Coder[Content], content_of: Callable[[Any], Content]
    ) -> tuple[Content, bytes]:
        self.ordinary += 1
        try:
            content = content_of(self._deserialize(data, topic))
        except Exception as error:  # whatever broken bytes provoke in a deserializer
            text = f"{topic}: {len(data)} bytes are no message of its type ({' '.join(str(error).split())})"
            raise RefusedSampleError("undecodable", text) from None
        checked_stamp(content.stamp, topic)
        return content, coder.encode(content)


def joint_state_of(message: Any) -> JointState:
    """Content of a JointState, of ROS's own class or that of rosbags."""
    return JointState(
        stamp_to_ns(message.header.stamp), message.header.frame_id, tuple(message.name),
        *(tuple(map(float, numbers)) for numbers in (message.position, message.velocity, message.effort)),
    )  # fmt: skip


def wrench_of(message: Any) -> WrenchStamped:
    """Content of a WrenchStamped, of ROS's own class or that of rosbags."""
    force, torque = message.wrench.force, message.wrench.torque
    return WrenchStamped(
        stamp_to_ns(message.header.stamp), message.header.frame_id,
        (force.x, force.y, force.z), (torque.x, torque.y, torque.z),
    )  # fmt: skip


def angle_sample(
    message: JointState, knee: Knee, height_prescribed: bool = False, data: bytes = b"", delay: int = 0
) -> AngleSample:
    """Sample with the flexion angle of a JointState, sign x position + offset.

    Args:
        message: The JointState.
        knee: Names, signs and offset of the joints.
        height_prescribed: Whether the femoral height is taken as well.
        data: Bytes in which the message is recorded.
        delay: Time [ns] by which the angle holds earlier than stamped.

    Raises:
        RefusedSampleError: a joint is missing, has no position, or its value is not finite or too large; or the stamp
            is not valid.
    """
    angle = knee.flexion_sign * number_of(message, knee.joint_name, "position") + knee.flexion_offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: flexion angle of joint {knee.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        raise RefusedSampleError("out_of_range", text)
    height = number_of(message, knee.height_joint_name, "position") if height_prescribed else None
    if height is not None and abs(height) > LARGEST_HEIGHT:
        text = f"joint_states: height of joint {knee.height_joint_name!r} is {height:g} m, beyond {LARGEST_HEIGHT:g}"
        raise RefusedSampleError("out_of_range", text)
    return AngleSample(checked_stamp(message.stamp, "joint_states") - delay, angle, data, height, delay)


def number_of(message: JointState, joint: str, quantity: str) -> float:
    """Position [rad or m] or effort [N m] of a joint in a JointState.

    Raises:
        RefusedSampleError: the joint is missing, or has no finite value.
    """
    if joint not in message.name:
        known = listed(message.name)
        raise RefusedSampleError("joint_missing", f"joint_states has no joint {joint!r}; it has {known}")
    index, numbers = message.name.index(joint), message.position if quantity == "position" else message.effort
    if index >= len(numbers):
        raise RefusedSampleError("joint_missing", f"joint_states gives no {quantity} for joint {joint!r}")
    if not math.isfinite(numbers[index]):
        raise RefusedSampleError("not_finite", f"joint_states: {quantity} of joint {joint!r} is {numbers[index]}")
    return numbers[index]


def load_sample(
    message: WrenchStamped, by_moment: Rule | None = None, arrived: float = 0.0, data: bytes = b""
) -> LoadSample:
    """Sample with the axial load L = -F_y and the frontal moment of a WrenchStamped on the tibia.

    Args:
        message: The WrenchStamped.
        by_moment: Rule for the compartment's load if that depends on the moment; its result is checked, too.
        arrived: Time of arrival by the caller's clock [s].
        data: Bytes in which the message is recorded.

    Raises:
        RefusedSampleError: the axial force, or a frontal moment that is needed, is not finite; the load is too large;
            or the stamp is not valid.
    """
    axial, moment = message.force[1], message.torque[0]
    if not math.isfinite(axial):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {axial}")
    if by_moment and not math.isfinite(moment):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: torque.x is {moment}")
    if abs(axial) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: force.y is {axial:g} N, beyond {LARGEST_LOAD:g}"
        )
    part = by_moment(-axial, moment, 0.0) if by_moment else 0.0
    if max(abs(part), abs(-axial - part)) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: torque.x of {moment:g} N m makes a load of {part:g} N"
        )
    stamp = checked_stamp(message.stamp, "joint_reaction_force")
    return LoadSample(stamp, -axial, moment, message.frame_id, data, arrived)


def checked_stamp(stamp: int, topic: str) -> int:
    """Return a stamp [ns] of a message of a topic, if a recording can hold it.

    Raises:
        RefusedSampleError: the stamp is out of range.
    """
    if not 0 <= stamp <= LAST_STAMP:
        raise RefusedSampleError("bad_stamp", f"{topic}: stamp {stamp} ns is not within 0 and {LAST_STAMP} ns")
    return stamp
