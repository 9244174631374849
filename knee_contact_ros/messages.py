"""Message types without ROS: definitions and hashes of the Jazzy messages and of our own."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from knee_contact_ros.resources import PACKAGE, share_folder
from knee_contact_ros.topics import MESSAGE_TYPES

NANOSECONDS = 1_000_000_000


@cache
def typestore() -> Typestore:
    """The messages of ROS 2 Jazzy and those in our `msg/` folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((share_folder() / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}"))
    return store


def stamp_to_ns(stamp: Any) -> int:
    """A message's stamp as integer nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def deserialize(data: bytes, topic: str) -> Any:
    """A plain message of one of our topics from its bytes."""
    return typestore().deserialize_cdr(data, MESSAGE_TYPES[topic])
