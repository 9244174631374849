"""Messages as ROS and rosbags know them, built field by field: what our own bytes are compared with."""

from types import SimpleNamespace

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from knee_contact_ros.msg import KneeContact
from std_msgs.msg import Header

from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES, NANOSECONDS, typestore
from tests.helpers.answers import FIELDS


def message_class(name):
    """Plain class of a message, by its full name (`sensor_msgs/msg/JointState`)."""
    return typestore().types[name]


NAMES = (
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    *(f"geometry_msgs/msg/{name}" for name in ("Point", "Vector3", "Wrench", "WrenchStamped")),
    MESSAGE_TYPES[KNEE_CONTACT],
)
PlainMessages = SimpleNamespace(**{name.rpartition("/")[2]: message_class(name) for name in NAMES})
"""Those of rosbags"""
RosMessages = SimpleNamespace(
    Time=Time,
    Header=Header,
    Point=Point,
    Vector3=Vector3,
    Wrench=Wrench,
    WrenchStamped=WrenchStamped,
    KneeContact=KneeContact,
)
"""ROS's own"""


def header(types, stamp, frame_id):
    """Header with an integer stamp [ns]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return types.Header(stamp=types.Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def contact_message(types, stamp, frame_id, contact):
    """The `KneeContact` message of an answer."""
    fields = {name: contact[name].item() for name in FIELDS}
    fields["contact_point"] = types.Point(**dict(zip("xyz", fields["contact_point"], strict=True)))
    return types.KneeContact(header=header(types, stamp, frame_id), **fields)


def wrench_message(types, stamp, frame_id, contact):
    """What the femur exerts on the tibia through the contact, reduced to the origin of the tibia frame."""
    parts = (dict(zip("xyz", part, strict=True)) for part in contact["contact_wrench"].item())
    wrench = types.Wrench(
        **{
            name: types.Vector3(**part)
            for name, part in zip(("force", "torque"), parts, strict=True)
        }
    )
    return types.WrenchStamped(header=header(types, stamp, frame_id), wrench=wrench)
