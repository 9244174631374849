"""The topics of the package and their message types."""

from __future__ import annotations

JOINT_STATES = "joint_states"
JOINT_REACTION_FORCE = "joint_reaction_force"
KNEE_CONTACT = "knee_contact"
KNEE_CONTACT_WRENCH = "knee_contact/wrench"
KNEE_CONTACT_MARKERS = "knee_contact/markers"
"""For RViz, and not recorded: it is computed from answers"""

MESSAGE_TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    JOINT_REACTION_FORCE: "geometry_msgs/msg/WrenchStamped",
    KNEE_CONTACT: "knee_contact_ros/msg/KneeContact",
    KNEE_CONTACT_WRENCH: "geometry_msgs/msg/WrenchStamped",
}
KNEE = "knee"
"""A knee without a namespace"""
DYNAMIC_JOINT_STATES = "dynamic_joint_states"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""What ros2_control tells of its joints; the angles may come from there in place of `joint_states`"""
INPUTS = (JOINT_STATES, JOINT_REACTION_FORCE)


def knee_name(topic: str) -> str:
    """What a knee is called whose answers are on a topic (absolute name): its namespace."""
    return topic.removesuffix(KNEE_CONTACT).strip("/") or KNEE
