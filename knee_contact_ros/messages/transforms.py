"""Reads and writes `/tf_static` (tf2_msgs/msg/TFMessage) without ROS."""

from __future__ import annotations

from typing import Any, NamedTuple

from knee_contact_ros.messages.ros_types import typestore
from knee_contact_ros.messages.stamps import NANOSECONDS

TF_STATIC = "/tf_static"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"


class Transform(NamedTuple):
    """Pose of a child frame in its parent frame: p_parent = rotation · p_child + translation."""

    parent: str
    """Name of the parent frame"""
    child: str
    """Name of the child frame"""
    translation: tuple[float, float, float]
    """Translation x, y, z [m]"""
    rotation: tuple[float, float, float, float]
    """Rotation as a quaternion x, y, z, w"""


def decode_transforms(data: bytes) -> list[Transform]:
    """Transforms in the bytes of a TFMessage.

    Raises:
        ValueError: the bytes are no such message.
    """
    try:
        message: Any = typestore().deserialize_cdr(data, TF_MESSAGE)
        return [_transform(one.header.frame_id, one.child_frame_id, one.transform) for one in message.transforms]
    except Exception as error:  # whatever broken bytes provoke
        raise ValueError(f"{len(data)} bytes are no {TF_MESSAGE} ({' '.join(str(error).split())})") from None


def encode_transforms(transforms: list[Transform], stamp: int) -> bytes:
    """Bytes of a TFMessage with transforms that share a stamp [ns]."""
    types = typestore().types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    transform, stamped = types["geometry_msgs/msg/Transform"], types["geometry_msgs/msg/TransformStamped"]
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    message = types[TF_MESSAGE]([
        stamped(
            header(time(*divmod(stamp, NANOSECONDS)), one.parent), one.child,
            transform(vector(*one.translation), quaternion(*one.rotation)),
        )
        for one in transforms
    ])  # fmt: skip
    return bytes(typestore().serialize_cdr(message, TF_MESSAGE))


def _transform(parent: str, child: str, transform: Any) -> Transform:
    place, turn = transform.translation, transform.rotation
    return Transform(
        parent.removeprefix("/"), child.removeprefix("/"), (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w)
    )
