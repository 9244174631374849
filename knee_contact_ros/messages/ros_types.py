"""Message types without ROS: definitions and hashes of the Jazzy messages and of our own."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from knee_contact_ros.messages.topics import MESSAGE_TYPES
from knee_contact_ros.system.resources import PACKAGE, share_folder

NANOSECONDS = 1_000_000_000


@cache
def typestore() -> Typestore:
    """The messages of ROS 2 Jazzy and those in our `msg/` folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((share_folder() / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}"))
    return store


@cache  # the next file of a recording must be open at once
def definition(type_name: str) -> bytes:
    """A message's definition with those that it consists of; our own with its comments and in its order.

    The comments have the units, and Foxglove names a field's values by the constants right before it.
    """
    text = typestore().generate_msgdef(type_name, ros_version=2)[0]
    if type_name.startswith(f"{PACKAGE}/"):
        source = share_folder() / "msg" / f"{type_name.rpartition('/')[2]}.msg"
        _, rule, parts = text.partition("=" * 80 + "\n")
        text = source.read_text(encoding="utf-8") + rule + parts
    return text.encode()


def stamp_to_ns(stamp: Any) -> int:
    """A message's stamp as integer nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def deserialize(data: bytes, topic: str) -> Any:
    """A plain message of one of our topics from its bytes."""
    return typestore().deserialize_cdr(data, MESSAGE_TYPES[topic])
