"""An answer as messages: `KneeContact`, and the contact force on the tibia as an ordinary wrench.

The message classes come in as an argument: ROS's own for publishing, plain ones for recording without ROS.
"""

from __future__ import annotations

from typing import Any

from knee_contact_ros.core.types import Contact
from knee_contact_ros.messages import NANOSECONDS


def header(types: Any, stamp: int, frame_id: str) -> Any:
    """Header with an integer stamp [ns]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return types.Header(stamp=types.Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def contact_message(types: Any, stamp: int, frame_id: str, contact: Contact) -> Any:
    """The `KneeContact` message of an answer."""
    fields = contact._asdict()
    fields["contact_point"] = types.Point(**contact.contact_point._asdict())
    return types.KneeContact(header=header(types, stamp, frame_id), **fields)


def wrench_message(types: Any, stamp: int, frame_id: str, contact: Contact, normal: tuple[float, float]) -> Any:
    """What the femur exerts on the tibia through the contact, reduced to the origin of the tibia frame.

    `normal` (x, y) of the tibial surface points from the tibia to the femur; the force on the tibia goes against it.
    """
    force_x = -contact.contact_force * normal[0]
    force_y = -contact.contact_force * normal[1]
    torque_z = contact.contact_point.x * force_y - contact.contact_point.y * force_x
    wrench = types.Wrench(
        force=types.Vector3(x=force_x, y=force_y, z=0.0), torque=types.Vector3(x=0.0, y=0.0, z=torque_z)
    )
    return types.WrenchStamped(header=header(types, stamp, frame_id), wrench=wrench)
