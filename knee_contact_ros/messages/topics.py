"""The topics of the package and their message types."""

from __future__ import annotations

JOINT_STATES = "joint_states"
JOINT_REACTION_FORCE = "joint_reaction_force"
GROUND_REACTION_FORCE = "ground_reaction_force"
"""What the ground exerts on the foot; from it and the angles the load node estimates the joint reaction force"""
LOAD_ESTIMATE = "load_estimate"
"""Where that estimate comes from, and how sure it is"""
KNEE_CONTACT = "knee_contact"
KNEE_CONTACT_LATERAL = "knee_contact/lateral"
"""The answer of the lateral compartment, where both are modelled; `knee_contact` is the medial one's then"""
KNEE_CONTACT_WRENCH = "knee_contact/wrench"
KNEE_CONTACT_MARKERS = "knee_contact/markers"
"""For RViz, and not recorded: it is computed from answers"""

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
"""A knee without a namespace"""
DYNAMIC_JOINT_STATES = "dynamic_joint_states"
DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
"""What ros2_control tells of its joints; the angles may come from there in place of `joint_states`"""
INPUTS = (JOINT_STATES, JOINT_REACTION_FORCE)
LOAD_INPUTS = (JOINT_STATES, GROUND_REACTION_FORCE)
LOAD_RECORDED = (*LOAD_INPUTS, JOINT_REACTION_FORCE, LOAD_ESTIMATE)
"""Topics of the load node's recording"""
RECORDED = (*INPUTS, KNEE_CONTACT, KNEE_CONTACT_WRENCH)
"""Topics of a knee of one compartment"""


def recorded_topics(has_both: bool) -> tuple[str, ...]:
    """The topics of a recording, of one compartment or of both."""
    return (*RECORDED, KNEE_CONTACT_LATERAL) if has_both else RECORDED


def is_lateral(topic: str) -> bool:
    """Whether a topic (absolute name) has the answers of a lateral compartment."""
    return topic.endswith(KNEE_CONTACT_LATERAL)


def knee_name(topic: str) -> str:
    """What a knee is called whose answers are on a topic (absolute name): its namespace."""
    return topic.removesuffix(KNEE_CONTACT_LATERAL).removesuffix(KNEE_CONTACT).strip("/") or KNEE


def compartment_name(knee: str, compartment: str) -> str:
    """What a compartment of a knee is called; that of the only knee by itself."""
    return compartment if knee == KNEE else f"{knee}_{compartment}"
