"""The bytes of the input messages to their content: by our own decoder, or the ordinary way where it gives up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from knee_contact_ros.messages.cdr_in import JointState, WrenchStamped, decode_joint_state, decode_wrench_stamped
from knee_contact_ros.messages.ros_types import stamp_to_ns
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, JOINT_STATES
from knee_contact_ros.pipeline.samples import RefusedSampleError

Deserialize = Callable[[bytes, str], Any]
"""The ordinary way: a message from its bytes and its topic; raises anything if they are not one"""


class Decoder:
    """Decodes the input messages."""

    def __init__(self, deserialize: Deserialize) -> None:
        self.ordinary = 0
        """Messages that went the ordinary way"""
        self._deserialize = deserialize

    def joint_state(self, data: bytes) -> JointState:
        """The content of a JointState.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return decode_joint_state(data) or joint_state_of(self._in_the_ordinary_way(data, JOINT_STATES))

    def joint_reaction_force(self, data: bytes) -> WrenchStamped:
        """The content of a WrenchStamped.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return decode_wrench_stamped(data) or wrench_of(self._in_the_ordinary_way(data, JOINT_REACTION_FORCE))

    def _in_the_ordinary_way(self, data: bytes, topic: str) -> Any:
        self.ordinary += 1
        try:
            return self._deserialize(data, topic)
        except Exception as error:  # whatever broken bytes provoke in a deserializer
            text = f"{topic}: {len(data)} bytes are no message of its type ({' '.join(str(error).split())})"
            raise RefusedSampleError("undecodable", text) from None


def joint_state_of(message: Any) -> JointState:
    """The content of a JointState, ROS's own or a plain one."""
    return JointState(
        stamp_to_ns(message.header.stamp), message.header.frame_id, tuple(message.name),
        *(tuple(map(float, numbers)) for numbers in (message.position, message.velocity, message.effort)),
    )  # fmt: skip


def wrench_of(message: Any) -> WrenchStamped:
    """The content of a WrenchStamped, likewise."""
    force, torque = message.wrench.force, message.wrench.torque
    return WrenchStamped(
        stamp_to_ns(message.header.stamp), message.header.frame_id,
        (force.x, force.y, force.z), (torque.x, torque.y, torque.z),
    )  # fmt: skip
