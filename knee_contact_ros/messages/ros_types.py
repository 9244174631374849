"""Message types without ROS: definitions of the messages of Jazzy and of this package."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from knee_contact_ros.messages.topics import MESSAGE_TYPES
from knee_contact_ros.system.resources import PACKAGE, share_folder


@cache
def typestore() -> Typestore:
    """Types of the messages of ROS 2 Jazzy and of this package's `msg/` folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((share_folder() / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}"))
    return store


@cache  # the next file of a recording must be open at once
def definition(type_name: str) -> bytes:
    """Definition of a message and of the messages in it; this package's own with comments and in their order.

    The comments have the units, and Foxglove names a field's values by the constants right before it.
    """
    text = typestore().generate_msgdef(type_name, ros_version=2)[0]
    if type_name.startswith(f"{PACKAGE}/"):
        source = share_folder() / "msg" / f"{type_name.rpartition('/')[2]}.msg"
        _, rule, parts = text.partition("=" * 80 + "\n")
        text = source.read_text(encoding="utf-8") + rule + parts
    return text.encode()


def deserialize(data: bytes, topic: str) -> Any:
    """Read the bytes of a message of one of this package's topics, without ROS."""
    return typestore().deserialize_cdr(data, MESSAGE_TYPES[topic])
