"""Messages as ROS and rosbags know them, built field by field: what our own bytes are compared with."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from knee_contact_ros.msg import KneeContact
from rosbags.interfaces import Nodetype
from std_msgs.msg import Header

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.model.types import Contact
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES, NANOSECONDS, typestore
from tests.helpers.answers import FIELDS


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


class PlainMessages:
    """Those of rosbags."""

    def __init__(self) -> None:
        self.Time = message_class("builtin_interfaces/msg/Time")
        self.Header = message_class("std_msgs/msg/Header")
        self.Point = message_class("geometry_msgs/msg/Point")
        self.Vector3 = message_class("geometry_msgs/msg/Vector3")
        self.Wrench = message_class("geometry_msgs/msg/Wrench")
        self.WrenchStamped = message_class("geometry_msgs/msg/WrenchStamped")
        self.KneeContact = message_class_with_zeros(MESSAGE_TYPES[KNEE_CONTACT])


class RosMessages:
    """ROS's own."""

    Time = Time
    Header = Header
    Point = Point
    Vector3 = Vector3
    Wrench = Wrench
    WrenchStamped = WrenchStamped
    KneeContact = KneeContact


def header(types: Any, stamp: int, frame_id: str) -> Any:
    """Header with an integer stamp [ns]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return types.Header(stamp=types.Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def contact_message(types: Any, stamp: int, frame_id: str, contact: Contact) -> Any:
    """The `KneeContact` message of an answer."""
    fields = {name: contact[name].item() for name in FIELDS}
    fields["contact_point"] = types.Point(**dict(zip("xyz", fields["contact_point"], strict=True)))
    return types.KneeContact(header=header(types, stamp, frame_id), **fields)


def wrench_message(types: Any, stamp: int, frame_id: str, contact: Contact) -> Any:
    """What the femur exerts on the tibia through the contact, reduced to the origin of the tibia frame."""
    parts = (dict(zip("xyz", part, strict=True)) for part in contact["contact_wrench"].item())
    wrench = types.Wrench(
        **{name: types.Vector3(**part) for name, part in zip(("force", "torque"), parts, strict=True)}
    )
    return types.WrenchStamped(header=header(types, stamp, frame_id), wrench=wrench)


def raw_inputs(path: Path) -> list[RawMessage]:
    """A bag's inputs as their bytes."""
    with BagReader(path) as bag:
        return list(bag.raw_messages())
