"""Message types without ROS: definitions, hashes and plain classes of the Jazzy messages and of our own."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from knee_contact_ros.resources import PACKAGE, share_folder
from knee_contact_ros.topics import KNEE_CONTACT, MESSAGE_TYPES

NANOSECONDS = 1_000_000_000


@cache
def typestore() -> Typestore:
    """The messages of ROS 2 Jazzy and those in our `msg/` folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((share_folder() / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}"))
    return store


def message_class(name: str) -> Any:
    """Plain class of a message, by its full name (`sensor_msgs/msg/JointState`)."""
    return typestore().types[name]


def message_class_with_zeros(name: str) -> Any:
    """The same with numbers 0, texts empty and truth values false unless given, as in ROS."""
    zeros = {"string": "", "bool": False}
    defaults = {
        field: zeros.get(str(detail[0]), 0.0 if str(detail[0]).startswith("float") else 0)
        for field, (kind, detail) in typestore().fielddefs[name][1]
        if kind is Nodetype.BASE
    }
    return partial(message_class(name), **defaults)


def stamp_to_ns(stamp: Any) -> int:
    """A message's stamp as integer nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


class PlainMessages:
    """Message classes for `publish.py` that need no ROS."""

    def __init__(self) -> None:
        self.Time = message_class("builtin_interfaces/msg/Time")
        self.Header = message_class("std_msgs/msg/Header")
        self.Point = message_class("geometry_msgs/msg/Point")
        self.Vector3 = message_class("geometry_msgs/msg/Vector3")
        self.Wrench = message_class("geometry_msgs/msg/Wrench")
        self.WrenchStamped = message_class("geometry_msgs/msg/WrenchStamped")
        self.KneeContact = message_class_with_zeros(MESSAGE_TYPES[KNEE_CONTACT])
