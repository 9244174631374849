"""Names, types, stamps and definitions of the messages, and the recorded messages of a tick.

A recorder's process needs nothing else, so nothing large is imported here.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..system.files import PACKAGE, share_folder

JOINT_STATES = "joint_states"
JOINT_REACTION_FORCE = "joint_reaction_force"
GROUND_REACTION_FORCE = "ground_reaction_force"
"""Force of the ground on the foot, from which, with the angles, the load node estimates the joint reaction force"""
NET_LOAD = "net_load"
"""Wrench of the thigh on the shank at the knee without muscles, which the load node takes in place of the ground's"""
LOAD_ESTIMATE = "load_estimate"
"""Estimate of the joint reaction force with its level and uncertainty"""
KNEE_CONTACT = "knee_contact"
KNEE_CONTACT_LATERAL = "knee_contact/lateral"
"""Answers of the lateral compartment, where both are modelled; `knee_contact` has those of the medial one then"""
KNEE_CONTACT_WRENCH = "knee_contact/wrench"
KNEE_CONTACT_STRIDE = "knee_contact/stride"
"""Numbers of each stride, as a sensor_msgs/JointState; not recorded, as they follow from the answers"""
KNEE_CONTACT_MARKERS = "knee_contact/markers"
"""Markers for RViz; not recorded, as they follow from the answers"""
ROBOT_DESCRIPTION, TF = "robot_description", "tf"
"""Description of the leg, and pose of the thigh; recorded but not published, as on a robot other nodes do that"""
LEG_URDF, SHANK, THIGH = "urdf/leg.urdf", "shank", "shank/thigh"
"""Description of the leg, and its links"""
MESSAGE_TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    JOINT_REACTION_FORCE: "geometry_msgs/msg/WrenchStamped",
    GROUND_REACTION_FORCE: "geometry_msgs/msg/WrenchStamped",
    NET_LOAD: "geometry_msgs/msg/WrenchStamped",
    LOAD_ESTIMATE: "knee_contact_ros/msg/LoadEstimate",
    KNEE_CONTACT: "knee_contact_ros/msg/KneeContact",
    KNEE_CONTACT_LATERAL: "knee_contact_ros/msg/KneeContact",
    KNEE_CONTACT_WRENCH: "geometry_msgs/msg/WrenchStamped",
    ROBOT_DESCRIPTION: "std_msgs/msg/String",
    TF: "tf2_msgs/msg/TFMessage",
}
MEDIAL, LATERAL = "medial", "lateral"
KNEE = "knee"
"""Name of a knee without a namespace"""
INPUTS = (JOINT_STATES, JOINT_REACTION_FORCE)
LOAD_INPUTS = (JOINT_STATES, GROUND_REACTION_FORCE)
LOAD_RECORDED = (*LOAD_INPUTS, JOINT_REACTION_FORCE, LOAD_ESTIMATE)
"""Topics of a recording of the load node"""
EACH_TICK = (*INPUTS, KNEE_CONTACT, KNEE_CONTACT_WRENCH)
"""Topics of which a tick has a message"""
RECORDED = (*EACH_TICK, ROBOT_DESCRIPTION, TF)
"""Topics of a recording of the contact node with one compartment"""


def recorded_topics(has_both: bool) -> tuple[str, ...]:
    """Topics of a recording of the contact node, with one compartment or with both."""
    return (*RECORDED, KNEE_CONTACT_LATERAL) if has_both else RECORDED


def is_lateral(topic: str) -> bool:
    """Whether a topic, given by its absolute name, has the answers of a lateral compartment."""
    return topic.endswith(KNEE_CONTACT_LATERAL)


def knee_name(topic: str) -> str:
    """Name of the knee whose answers are on a topic, given by its absolute name: its namespace, or `knee`."""
    return topic.removesuffix(KNEE_CONTACT_LATERAL).removesuffix(KNEE_CONTACT).strip("/") or KNEE


def compartment_name(knee: str, compartment: str) -> str:
    """Name of a compartment of a knee; without the knee if this has no namespace."""
    return compartment if knee == KNEE else f"{knee}_{compartment}"


NANOSECONDS = 1_000_000_000
"""Number of nanoseconds in a second"""


def stamp_to_ns(stamp: Any) -> int:
    """Convert the stamp of a message to nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


Record = tuple[str, int, bytes]
"""A message to record: topic, stamp [ns] and CDR bytes"""


class TickOutput(NamedTuple):
    """What the outputs of a node get of one tick."""

    row: bytes
    """Bytes of a `ROW` for each compartment, the medial one first; empty for the load node"""
    records: tuple[Record, ...]
    """Messages of the tick: the angles up to its stamp, the load, the answers"""
    size: int
    """Size [B] of these messages"""

    @classmethod
    def of(cls, row: bytes, records: tuple[Record, ...]) -> TickOutput:
        """Make one of its row and its messages."""
        return cls(row, records, sum([len(data) for _, _, data in records]))


class Ending(NamedTuple):
    """End of a stream of answers."""

    inputs: tuple[Record, ...]
    """Input messages that belong to no answer"""
    refused: dict[str, int]
    """Number of refused samples by reason"""


@cache
def typestore() -> Typestore:
    """Types of the messages of ROS 2 Jazzy and of this package's `msg/` folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((share_folder() / "msg").glob("*.msg")):
        store.register(
            get_types_from_msg(path.read_text(encoding="utf-8"), f"{PACKAGE}/msg/{path.stem}")
        )
    return store


NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
"""Definition of a type that a bag does not define"""


def types_in(message_definition: MessageDefinition, type_name: str) -> Any:
    """Fields of a type and of all types in it, from a bag's definition; those of ROS 2 Jazzy where the bag has none.

    Raises:
        Exception: of many kinds, if the text does not define the type.
    """
    if message_definition.format is MessageDefinitionFormat.NONE:
        return typestore().fielddefs
    if message_definition.format is MessageDefinitionFormat.IDL:
        return get_types_from_idl(message_definition.data)
    return get_types_from_msg(message_definition.data, type_name)


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


def types_of(topics: Iterable[str]) -> dict[str, str]:
    """Return the types of this package's topics, by their absolute names."""
    return {f"/{topic}": MESSAGE_TYPES[topic] for topic in topics}


def deserialize(data: bytes, topic: str) -> Any:
    """Read the bytes of a message of one of this package's topics, without ROS."""
    return typestore().deserialize_cdr(data, MESSAGE_TYPES[topic])
