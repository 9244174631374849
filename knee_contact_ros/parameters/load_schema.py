"""Declaration of all parameters of the load node, which estimates the joint reaction force."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from knee_contact_ros.joint_reaction.estimator import LEVELS, Trust
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.parameters.declared import NodeReading
from knee_contact_ros.parameters.limits import OffOrAtLeast, OneOf
from knee_contact_ros.parameters.sections import Diagnostics, Pairing, Record, Section, frame_name
from knee_contact_ros.system.errors import UsageError

AUTO = "auto"


class MeasuredJoint(Section):
    """Joint in joint_states; its angle is sign x position + offset."""

    joint_name: str = Field("", description="joint in joint_states; empty: it is not measured")
    sign: Annotated[float, OneOf(1.0, -1.0)] = Field(1.0, description="1 if the position grows with the angle, or -1")
    offset: float = Field(0.0, ge=-10.0, le=10.0, description="[rad] added to the signed position")


class ActuatedJoint(MeasuredJoint):
    """Joint in joint_states that an actuator may turn."""

    assisted: bool = Field(
        False, description="whether its effort [N m] in joint_states is an actuator's torque, in the position's sense"
    )


class FlexedKnee(ActuatedJoint):
    """Knee joint; its angle is positive in flexion."""

    joint_name: str = Field("knee", min_length=1, description="joint in joint_states")


class GroundForce(Section):
    """Meaning of `ground_reaction_force`: x forward, y up, z to the right."""

    components: Annotated[str, OneOf("vertical", "full")] = Field(
        "vertical", description="vertical: force.y alone, as of an insole; full: all of force and torque"
    )
    axes: Annotated[str, OneOf("ground", "foot")] = Field(
        "ground", description="ground: its axes stand upright; foot: they turn with the foot"
    )
    ankle_x: float = Field(0.0, ge=-1.0, le=1.0, description="[m] of the ankle joint, from where its torque is told")
    ankle_y: float = Field(0.0, ge=-1.0, le=1.0, description="[m] likewise, up")


class LoadFrames(Section):
    """Frames of the messages."""

    ground: Annotated[str, AfterValidator(frame_name)] = Field(
        "", description="frame (x forward, y up, z right) that ground forces are turned into; empty: as they come"
    )
    tibia: Annotated[str, AfterValidator(frame_name)] = Field(
        "tibia", min_length=1, description="frame_id of the joint reaction force: x anterior, y superior, z right"
    )


class PersonParameters(Section):
    """Person whose knee it is. Muscles are not measured: `knee-contact calibrate` fits their constants to a bag."""

    mass: float = Field(75.16, ge=10.0, le=400.0, description="[kg]")
    height: float = Field(1.75, ge=0.8, le=2.5, description="[m]")
    moment_arm_scale: float = Field(1.5, ge=0.3, le=3.0, description="of the muscles' moment arms to published ones")
    co_contraction: float = Field(
        0.2, ge=0.0, le=3.0, description="with how much antagonists pull at least, as part of the vertical ground force"
    )
    tone: float = Field(0.3, ge=0.0, le=2.0, description="likewise at any time, as part of the body weight")

    @property
    def constants(self) -> Person:
        """Constants of the person for the estimator."""
        return Person(self.mass, self.height, self.moment_arm_scale, self.co_contraction, self.tone)


class LoadParameters(Section):
    """All parameters of the load node, `estimate-load` and `estimate_load`."""

    level: Annotated[str, OneOf(AUTO, *LEVELS)] = Field(
        AUTO, description=f"{', '.join(LEVELS)}, or auto: the last one of these that the inputs allow"
    )
    knee: FlexedKnee = FlexedKnee()
    ankle: ActuatedJoint = ActuatedJoint()
    hip: MeasuredJoint = MeasuredJoint()
    ground: GroundForce = GroundForce()
    frame: LoadFrames = LoadFrames()
    person: PersonParameters = PersonParameters()
    calibrated: bool = Field(
        False, description="whether the person's constants were fitted to a measured knee of this person"
    )
    standard_deviation: Annotated[float, OffOrAtLeast(0.01, "as measured for the level")] = Field(
        0.0, le=10.0, description="of the axial force, as part of the body weight; 0: as measured for the level"
    )
    motion_window: Annotated[float, OffOrAtLeast(0.01, "no inertia")] = Field(
        0.05, le=1.0, description="[s] over which the joints' accelerations are seen, half of it late; 0: no inertia"
    )
    pairing: Pairing = Pairing()
    autostart: bool = Field(True, description="configure and activate without being asked")
    deadline: float = Field(
        0.02, gt=0.0, le=3600.0, description="[s] from a ground force to its estimate; later ones are counted"
    )
    diagnostics: Diagnostics = Diagnostics()
    record: Record = Record()

    @property
    def chosen_level(self) -> str:
        """Name of the level, of `LEVELS`; `auto` is resolved by the inputs."""
        return allowed_levels(self)[-1] if self.level == AUTO else self.level

    @property
    def trust(self) -> Trust:
        """Calibration and standard deviation for the estimator."""
        return Trust(self.calibrated, self.standard_deviation)


def allowed_levels(parameters: LoadParameters) -> list[str]:
    """Names of the levels that the inputs allow, in increasing order of what they use."""
    hip, ankle = bool(parameters.hip.joint_name), bool(parameters.ankle.joint_name)
    upright = parameters.ground.axes == "ground"
    allowed = ["ground_force"]
    if parameters.ground.components == "full" and (hip if upright else ankle):
        allowed += ["knee_moment", "ankle_moment"] if ankle else ["knee_moment"]
    return allowed


def _check(parameters: LoadParameters, where: str) -> None:
    """Refuse combinations of values that are not allowed."""
    allowed = allowed_levels(parameters)
    if parameters.level not in (AUTO, *allowed):
        needs = "ground.components full, and hip.joint_name with ground.axes ground or ankle.joint_name with foot"
        needs += "; ankle_moment also ankle.joint_name"
        raise UsageError(
            f"{where}parameter level: {parameters.level!r} is not allowed; it needs {needs}. "
            f"These inputs allow {', '.join(allowed)}"
        )
    names = [joint.joint_name for joint in (parameters.knee, parameters.ankle, parameters.hip) if joint.joint_name]
    if len(set(names)) < len(names):
        raise UsageError(f"{where}parameter knee.joint_name: {', '.join(names)} are not different joints")
    if parameters.ankle.assisted and not parameters.ankle.joint_name:
        raise UsageError(f"{where}parameter ankle.assisted: True is not allowed; ankle.joint_name is empty")


LOAD_READING = NodeReading("knee_load", LoadParameters, _check, folder="load")
