"""Declaration of all parameters of the load node; see `schema.py`."""

from types import MappingProxyType
from typing import Annotated

from pydantic import Field

from ..joint_reaction.estimator import LOAD_LEVELS
from ..joint_reaction.leg import GRAVITY
from ..joint_reaction.muscles import Person
from .sections import (
    ANGLE_SOURCE_MEANING,
    AngleSource,
    DiagnosticsSection,
    ForceSource,
    FrameName,
    NodeSection,
    PairingSection,
    RecordSection,
    Section,
    off_or_at_least,
    one_of,
)

_AUTO = "auto"
"""Level that the inputs choose"""


class MeasuredJoint(Section):
    """Joint in joint_states; its angle is sign x position + offset."""

    joint_name: str = ""
    """joint in joint_states; empty: not measured"""
    sign: Annotated[float, one_of(1.0, -1.0)] = 1.0
    """1 if the position grows with the angle, or -1"""
    offset: float = Field(0.0, ge=-10.0, le=10.0)
    """[rad] added to the signed position"""


class ActuatedJoint(MeasuredJoint):
    """Joint in joint_states that an actuator may turn."""

    assisted: bool = False
    """true: the effort [N m] in joint_states is an actuator's torque, with the sign of the position"""


class FlexedKnee(ActuatedJoint):
    """Knee joint; its angle is positive in flexion."""

    joint_name: str = Field("knee", min_length=1)
    """joint in joint_states"""
    source: AngleSource = Field("joint_states", description=ANGLE_SOURCE_MEANING)


class GroundForce(Section):
    """Meaning of `ground_reaction_force`: x forward, y up, z to the right."""

    source: ForceSource = "ground_reaction_force"
    """topic of the ground force, of type WrenchStamped; for another type, one field for the upward force, three for
    the force (x, y, z), or six for the wrench; of a net load, two: the net compression and the net moment"""
    components: Annotated[str, one_of("vertical", "full", "net")] = "vertical"
    """vertical: use force.y only, as from an insole; full: use force and torque; net: not the ground's wrench, but that
    of the thigh on the shank at the knee without muscles, force.y < 0 in compression, torque.z > 0 in extension"""
    axes: Annotated[str, one_of("ground", "foot")] = "ground"
    """ground: the axes of the wrench stay upright; foot: they turn with the foot"""
    ankle_x: float = Field(0.0, ge=-1.0, le=1.0)
    """[m] forward position of the ankle joint in the frame of the wrench"""
    ankle_y: float = Field(0.0, ge=-1.0, le=1.0)
    """[m] upward position of the ankle joint in that frame"""


class LoadFrames(Section):
    """Frames of the messages."""

    ground: FrameName = ""
    """turn ground forces into this frame (x forward, y up, z right); empty: do not turn them"""
    tibia: FrameName = Field("tibia", min_length=1)
    """frame_id of the joint reaction force: x anterior, y superior, z right"""


class PersonSection(Section):
    """The person. Muscles are not measured; `knee-contact calibrate` fits their constants to a bag."""

    mass: float = Field(75.16, ge=10.0, le=400.0)
    """[kg] body mass"""
    height: float = Field(1.75, ge=0.8, le=2.5)
    """[m] body height"""
    moment_arm_scale: float = Field(1.75, ge=0.3, le=3.0)
    """factor for the published moment arms of the muscles"""
    co_contraction: float = Field(0.48, ge=0.0, le=3.0)
    """smallest pull of antagonists, as a fraction of the vertical ground force"""
    tone: float = Field(0.3, ge=0.0, le=2.0)
    """smallest pull of antagonists, as a fraction of body weight"""
    electromechanical_delay: float = Field(0.025, ge=0.0, le=0.2)
    """[s] time constant with which muscle forces follow the demand; 0: at once"""
    expected_load: float = Field(0.5, ge=0.0, le=1.0)
    """weight of the load that other people's knees bear at that moment of a level stride; 0: the sensors alone"""

    @property
    def constants(self) -> Person:
        """Constants of the person for the estimator."""
        return Person(**self.model_dump())


class LoadParameters(NodeSection):
    """All parameters of the load node, `estimate-load` and `estimate_load`."""

    node = "knee_load"
    folder = "load"
    force_source, usual_forces = "ground.source", "ground_reaction_force"
    companion = "knee_contact"
    other_names = MappingProxyType(
        {
            "body_weight": ("person.mass", 1.0 / GRAVITY),
            "knee.flexion_sign": ("knee.sign", 1.0),
            "knee.flexion_offset": ("knee.offset", 1.0),
        }
    )
    encoder = ("knee.source", "knee.joint_name", "knee.sign", "knee.offset")
    about_person = MappingProxyType({"person.mass": "kg", "person.height": "m"})

    level: Annotated[str, one_of(_AUTO, *LOAD_LEVELS)] = Field(
        _AUTO,
        description=f"{', '.join(LOAD_LEVELS)}, or auto: the last of these that the inputs allow",
    )
    knee: FlexedKnee = FlexedKnee()
    ankle: ActuatedJoint = ActuatedJoint()
    hip: MeasuredJoint = MeasuredJoint()
    ground: GroundForce = GroundForce()
    frame: LoadFrames = LoadFrames()
    person: PersonSection = PersonSection()
    calibrated: bool = False
    """true: the constants were fitted to a measured knee of this person"""
    standard_deviation: Annotated[float, off_or_at_least(0.01, "as measured for the level")] = (
        Field(0.0, ge=0.0, le=10.0)
    )
    """standard deviation of the axial force, as a fraction of body weight; 0: as measured for the level"""
    motion_window: Annotated[float, off_or_at_least(0.01, "no inertia")] = Field(
        0.05, ge=0.0, le=1.0
    )
    """[s] window for the accelerations of the joints, which delays them by half of it; 0: no inertia"""
    pairing: PairingSection = PairingSection()
    autostart: bool = True
    """true: the node configures and activates itself"""
    realtime: bool = False
    """true: while active, the node's threads go before all ordinary processes (SCHED_FIFO), and its memory is locked"""
    deadline: float = Field(0.02, gt=0.0, le=3600.0)
    """[s] longest time from a ground force to its estimate; the node counts later estimates"""
    diagnostics: DiagnosticsSection = DiagnosticsSection()
    record: RecordSection = RecordSection()

    def joints(self) -> dict[str, str]:
        """Joints of the leg that are measured; see `NodeSection`."""
        joints = {"knee": self.knee, "hip": self.hip, "ankle": self.ankle}
        return {
            f"{name}.joint_name": joint.joint_name
            for name, joint in joints.items()
            if joint.joint_name
        }

    @property
    def chosen_level(self) -> str:
        """Name of the level, of `LOAD_LEVELS`; `auto` is resolved by the inputs."""
        return allowed_levels(self)[-1] if self.level == _AUTO else self.level

    def problem(self) -> str:
        """First combination of values that is not allowed; see `NodeSection`."""
        allowed = allowed_levels(self)
        joints = [
            joint.joint_name for joint in (self.knee, self.ankle, self.hip) if joint.joint_name
        ]
        if self.level not in (_AUTO, *allowed):
            return (
                f"level: {self.level!r} is not allowed; it needs ground.components full, and hip.joint_name with "
                "ground.axes ground or ankle.joint_name with foot; ankle_moment also ankle.joint_name; net_load "
                "ground.components net. "
                f"These inputs allow {', '.join(allowed)}"
            )
        if len(set(joints)) < len(joints):
            return f"knee.joint_name: {', '.join(joints)} are not different joints"
        if self.ankle.assisted and not self.ankle.joint_name:
            return "ankle.assisted: True is not allowed; ankle.joint_name is empty"
        assisted = self.knee.assisted or self.ankle.assisted
        if assisted and self.inputs()[0].fields:
            return "knee.source: fields are not allowed; they give no effort of an assisted joint"
        needed, why = (3 if self.frame.ground else 1), "frame.ground"
        if self.ground.components == "net":
            return self.problem_of_sources(2, "ground.components net", (0, 2, 6))
        if self.ground.components == "full":
            needed, why = 6, "ground.components full"
        return self.problem_of_sources(needed, why)


def allowed_levels(parameters: LoadParameters) -> list[str]:
    """Names of the levels that the inputs allow, in increasing order of what they use."""
    if parameters.ground.components == "net":
        return ["net_load"]
    hip, ankle = bool(parameters.hip.joint_name), bool(parameters.ankle.joint_name)
    upright = parameters.ground.axes == "ground"
    allowed = ["ground_force"]
    if parameters.ground.components == "full" and (hip if upright else ankle):
        allowed += ["knee_moment", "ankle_moment"] if ankle else ["knee_moment"]
    return allowed
