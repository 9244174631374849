"""ROS's own message classes for `publish.py`."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from std_msgs.msg import Header

from knee_contact_ros.msg import KneeContact


class RosMessages:
    """The counterpart of `messages.PlainMessages`."""

    Time = Time
    Header = Header
    Point = Point
    Vector3 = Vector3
    Wrench = Wrench
    WrenchStamped = WrenchStamped
    KneeContact = KneeContact
