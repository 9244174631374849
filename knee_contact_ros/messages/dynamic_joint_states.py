"""Converts `dynamic_joint_states` of ros2_control (control_msgs/msg/DynamicJointState) to JointState."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from knee_contact_ros.messages.cdr import JointState, encode_joint_state
from knee_contact_ros.messages.ros_types import typestore
from knee_contact_ros.messages.stamps import stamp_to_ns
from knee_contact_ros.messages.topics import DYNAMIC_JOINT_STATE

POSITION = "position"
"""Name of the interface whose value is an angle [rad] or a height [m]"""
DEFINITIONS = {
    DYNAMIC_JOINT_STATE: (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    ),
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
}
"""Message definitions by type, as in control_msgs"""


@cache
def _types() -> Typestore:
    store = typestore()
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


def as_joint_state(data: bytes) -> bytes:
    """Bytes of a JointState with the joints that have a position; empty if `data` is no DynamicJointState.

    Velocities and efforts are left out, as they are not used.
    """
    try:
        message: Any = _types().deserialize_cdr(data, DYNAMIC_JOINT_STATE)
        positions: dict[str, float] = {}
        for joint, interface in zip(message.joint_names, message.interface_values, strict=True):
            known = dict(zip(interface.interface_names, interface.values, strict=False))  # a joint may lack values
            if POSITION in known:
                positions.setdefault(joint, float(known[POSITION]))
        header = message.header
        content = JointState(
            stamp_to_ns(header.stamp), header.frame_id, tuple(positions), tuple(positions.values()), (), ()
        )
        return encode_joint_state(content)
    except Exception:  # whatever broken bytes provoke
        return b""
