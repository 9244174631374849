"""Names of the topics of the package, and their message types."""

from __future__ import annotations

JOINT_STATES = "joint_states"
JOINT_REACTION_FORCE = "joint_reaction_force"
GROUND_REACTION_FORCE = "ground_reaction_force"
"""Force of the ground on the foot; from it and the angles the load node estimates the joint reaction force"""
LOAD_ESTIMATE = "load_estimate"
"""Estimate of the joint reaction force with its level and uncertainty"""
KNEE_CONTACT = "knee_contact"
KNEE_CONTACT_LATERAL = "knee_contact/lateral"
"""Answers of the lateral compartment, where both are modelled; `knee_contact` has those of the medial one then"""
KNEE_CONTACT_WRENCH = "knee_contact/wrench"
KNEE_CONTACT_MARKERS = "knee_contact/markers"
"""Markers for RViz; not recorded, as they follow from the answers"""

MESSAGE_TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    JOINT_REACTION_FORCE: "geometry_msgs/msg/WrenchStamped",
    GROUND_REACTION_FORCE: "geometry_msgs/msg/WrenchStamped",
    LOAD_ESTIMATE: "knee_contact_ros/msg/LoadEstimate",
    KNEE_CONTACT: "knee_contact_ros/msg/KneeContact",
    KNEE_CONTACT_LATERAL: "knee_contact_ros/msg/KneeContact",
    KNEE_CONTACT_WRENCH: "geometry_msgs/msg/WrenchStamped",
}
MEDIAL, LATERAL = "medial", "lateral"
KNEE = "knee"
"""Name of a knee without a namespace"""
DYNAMIC_JOINT_STATES = "dynamic_joint_states"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""Joint states of ros2_control, from which the angles may come in place of `joint_states`"""
INPUTS = (JOINT_STATES, JOINT_REACTION_FORCE)
LOAD_INPUTS = (JOINT_STATES, GROUND_REACTION_FORCE)
LOAD_RECORDED = (*LOAD_INPUTS, JOINT_REACTION_FORCE, LOAD_ESTIMATE)
"""Topics of a recording of the load node"""
RECORDED = (*INPUTS, KNEE_CONTACT, KNEE_CONTACT_WRENCH)
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
