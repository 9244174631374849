"""Declaration of all parameters of the contact node: type, default, unit, meaning and limits.

The node, parameter files, `--help`, the reference page and changes at run time use this declaration. `files.py` reads
values for these parameters, and `build.py` builds models from them. The load node's are in `load_schema.py`.
"""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

from pydantic import BeforeValidator, Field, create_model, model_validator

from ..joint_reaction.compartments import BOTH, RULES, SPLITS
from ..joint_reaction.leg import GRAVITY
from ..model.knee import BUDGET
from ..model.laws import CONTACT_LAWS
from ..model.mechanisms import MECHANISMS
from ..model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES
from ..model.ticks import LEVELS
from .sections import (
    ANGLE_SOURCE_MEANING,
    AngleSource,
    DiagnosticsSection,
    ForceSource,
    FrameName,
    NodeSection,
    OrientationSource,
    PairingSection,
    RecordSection,
    Rotation,
    Section,
    off_or_at_least,
    one_of,
)
from .sources import TopicSource, orientation_source

LATERAL_PREFIX = "lateral."
"""Beginning of the names of the lateral compartment's parameters"""
FEMORAL_SHARE = 9.3014 / 75.16
"""Ratio of the masses of the femur's segment and the body in OpenSim's model gait2354, which scales both alike"""
_FIRST_ORDER = "first_order"
"""Level of earlier versions"""
_log = logging.getLogger(__name__)


class ContactDiagnosticsSection(DiagnosticsSection):
    """Diagnostics of the contact node, which also reports the uncertainty of force and depth due to the load."""

    load_deviation: float = Field(0.0, ge=0.0, le=10.0)
    """standard deviation of a compartment's load, as a fraction of body weight; 0: not known"""


def _restore_off(value: object) -> object:
    """Restore `off`, which ROS 2 parameter files read as the truth value false (YAML 1.1)."""
    return "off" if value is False else value


def _replace_first_order(level: object) -> object:
    """Replace a level of earlier versions that no longer exists."""
    return _warn_first_order_removed() if level == _FIRST_ORDER else level


@functools.cache
def _warn_first_order_removed() -> str:
    """Return the level that replaces `_FIRST_ORDER`, and say so once."""
    _log.warning(
        "fidelity.level: %s no longer exists; dynamic is used instead, which is faster and more accurate",
        _FIRST_ORDER,
    )
    return "dynamic"


class KneeSection(Section):
    """Knee joint in the joint states; the flexion angle is flexion_sign x position + flexion_offset."""

    joint_name: str = Field("knee", min_length=1)
    """joint in joint_states"""
    flexion_sign: Annotated[float, one_of(1.0, -1.0)] = 1.0
    """1 if the position grows in flexion, or -1"""
    flexion_offset: float = Field(0.0, ge=-10.0, le=10.0)
    """[rad] added to the signed position"""
    height_joint_name: str = Field("knee_height", min_length=1)
    """joint whose position is the femoral height [m], for drive displacement"""
    source: AngleSource = Field("joint_states", description=ANGLE_SOURCE_MEANING)


class OrientationsSection(Section):
    """Orientations of two inertial sensors, which give the knee angle in place of knee.source."""

    thigh: OrientationSource = ""
    """topic of the thigh's sensor, of type sensor_msgs/Imu; for another type, the field of the quaternion"""
    shank: OrientationSource = ""
    """the same for the shank"""
    standing: Rotation = ""
    """turn from the axes of the shank's sensor to those of the thigh's in standing, which is 0 rad; ~/zero sets it"""


class LoadSection(Section):
    """Part of the axial joint reaction that loads the compartment."""

    source: ForceSource = "joint_reaction_force"
    """topic of the joint reaction, of type WrenchStamped; for another type, one field for the compression, three for
    the force on the tibia (x, y, z), or six for the wrench"""
    compartment: Annotated[str, one_of(*RULES, BOTH)] = "fixed_share"
    """rule for the load of the compartment; both: model the medial and the lateral one"""
    split: Annotated[str, one_of(*SPLITS)] = "fixed_share"
    """rule for the medial load if load.compartment is both"""
    rotation: Rotation = ""
    """turn forces from the sensor's axes to the tibia's, as tf2 and URDF turn a child frame to its parent; empty: do
    not turn them"""
    offset: float = Field(0.0, ge=-1e4, le=1e4)
    """[N] added to the axial compression: minus what the sensor shows while the leg hangs free; ~/tare sets it"""
    share: float = Field(0.5, gt=0.0, le=1.0)
    """medial share of the axial joint reaction, for fixed_share"""
    share_file: str = "share_medial.csv"
    """CSV file with flexion_angle [rad], axial_load [BW] and medial_share, for measured_share"""
    compartment_spacing: float = Field(0.07, ge=0.005, le=0.2)
    """[m] distance from the medial to the lateral compartment, for moment_balance and both"""

    @property
    def rule(self) -> str:
        """Name of the rule in `RULES` for the load of the medial (or only) compartment."""
        return self.split if self.compartment == BOTH else self.compartment


class FrameSection(Section):
    """Frame of the messages."""

    tibia: FrameName = ""
    """turn forces into this tibia frame (x anterior, y superior, z right); empty: do not turn them"""


class FemurSection(Section):
    """Mass and contact surface of the femur."""

    mass: float = Field(9.3014, ge=1e-4, le=1e3)
    """[kg] mass that moves up and down with the femur"""
    geometry: Annotated[str, one_of(*GEOMETRIES)] = "circle"
    """surface of the femur"""
    radius: float = Field(0.034, gt=0.0, le=1.0)
    """[m] radius of the femoral circle"""
    profile: str = ""
    """CSV file with x, y [m] in the femur frame, in order along the curve"""
    scale: float = Field(1.0, ge=0.1, le=10.0)
    """factor for the size of the profile"""


class TibiaSection(Section):
    """Contact surface of the tibia, the plateau."""

    geometry: Annotated[str, one_of(*TIBIAL_GEOMETRIES)] = "plane"
    """surface of the tibial plateau"""
    slope: float = Field(0.0, ge=-0.7, le=0.7)
    """[rad] slope of the plane, positive if its anterior edge is higher"""
    radius: float = Field(0.095, gt=0.0, le=10.0)
    """[m] radius of the concave tibial circle"""
    profile: str = ""
    """CSV file with x, y [m] in the tibia frame, from posterior to anterior"""
    scale: float = Field(1.0, ge=0.1, le=10.0)
    """factor for the size of the profile"""


class TranslationSection(Section):
    """Anterior-posterior translation of the femur."""

    mechanism: Annotated[str, one_of(*MECHANISMS)] = "hinge"
    """how the femur moves along the plateau"""
    table: str = ""
    """CSV file with flexion_angle [rad] and x [m] of the femoral reference point"""


class CommonContactSection(Section):
    """Contact law, and the constants that several laws use or that other parameters depend on.

    Further arguments of a law's factory are parameters, too; see `with_constants_of_laws`.
    """

    law: Annotated[str, one_of(*CONTACT_LAWS)] = "kelvin_voigt"
    """contact law"""
    stiffness: float = Field(7.905694e7, ge=1.0, le=1e15)
    """[N/m^exponent] stiffness of the first layer"""
    exponent: float = Field(1.5, ge=1.0, le=3.0)
    """exponent of the depth; 1.5 for two curved solids"""
    damping: float = Field(5000.0, ge=0.0, le=1e9)
    """[N s/m] damping: force per penetration rate"""
    allow_tension: bool = False
    """let the law pull instead of clamping it at 0"""
    layer_depth: float = Field(5.0e-4, gt=0.0, le=0.1)
    """[m] depth at which the second layer (bone) begins"""
    stiffness_2: float = Field(3.112e9, ge=1.0, le=1e15)
    """[N/m^exponent] stiffness of the second layer"""
    damp_first_layer: bool = False
    """two_layer_viscoelastic: put the dashpot into both layers"""
    restitution: float = Field(0.5, ge=0.01, le=1.0)
    """coefficient of restitution, for laws with impact damping"""
    least_impact_speed: float = Field(0.1, ge=1e-6, le=100.0)
    """[m/s] lowest impact speed for impact damping; slower impacts and the static start use this value"""
    stiffness_from: Annotated[str, one_of("value", "material")] = "value"
    """value: contact.stiffness; material: Hertz from modulus, Poisson's ratio and radii (exponent 1.5)"""
    youngs_modulus: float = Field(24e6, ge=1.0, le=1e13)
    """[Pa] Young's modulus of cartilage (first layer)"""
    poissons_ratio: float = Field(0.38, ge=0.0, lt=0.5)
    """Poisson's ratio of cartilage (first layer)"""
    youngs_modulus_2: float = Field(17.2e9, ge=1.0, le=1e13)
    """[Pa] Young's modulus of bone (second layer)"""
    poissons_ratio_2: float = Field(0.39, ge=0.0, lt=0.5)
    """Poisson's ratio of bone (second layer)"""
    femoral_radius: float = Field(0.034, gt=0.0, le=10.0)
    """[m] convex radius of the femur for stiffness_from material, elastic_foundation and the patch"""
    tibial_radius: float = Field(0.095, gt=0.0, le=10.0)
    """[m] concave radius of the tibia, used as contact.femoral_radius is"""
    foundation_thickness: float = Field(4.4e-3, gt=0.0, le=0.1)
    """[m] thickness of both cartilages together, for elastic_foundation and the strain"""


def constants_of(law: str) -> list[str]:
    """Names of the parameters `contact.*` that a law uses."""
    return list(_arguments(CONTACT_LAWS[law]))


def without_effect(contact: CommonContactSection, names: Iterable[str]) -> str:
    """Sentence on those of some parameters `contact.*`, by name, that do nothing under the law; empty if all do."""
    used = {"law", "allow_tension", "stiffness_from", "femoral_radius", "tibial_radius"}
    constants = set(constants_of(contact.law))
    if contact.stiffness_from == "material":
        of_first = {"stiffness": {"youngs_modulus", "poissons_ratio"}}
        of_second = {"stiffness_2": {"youngs_modulus_2", "poissons_ratio_2"}}
        for stiffness, material in (of_first | of_second).items():
            if stiffness in constants:
                constants = constants - {stiffness} | material
    if "layer_depth" not in constants:
        constants.add("foundation_thickness")  # of the strain
    idle = [f"contact.{name}" for name in names if name not in used | constants]
    verb = "has" if len(idle) == 1 else "have"
    how = " with contact.stiffness_from material" if contact.stiffness_from == "material" else ""
    return (
        f"{', '.join(idle)} {verb} no effect under contact.law {contact.law}{how}" if idle else ""
    )


@functools.cache
def _arguments(factory: Callable[..., Any]) -> tuple[str, ...]:
    """Names of a factory's arguments; kept, as inspecting a signature takes as long as making ten laws."""
    return tuple(inspect.signature(factory).parameters)


def with_constants_of_laws(
    laws: Mapping[str, Callable[..., Any]],
) -> type[CommonContactSection]:
    """Section with the common parameters and the further arguments of these laws' factories.

    Each of those has a default and a `Range` in the signature.
    """
    more: dict[str, Any] = {}
    for factory in laws.values():
        types = get_type_hints(factory, include_extras=True)
        for name, argument in inspect.signature(factory).parameters.items():
            if name not in CommonContactSection.model_fields:
                (limits,) = types[name].__metadata__
                field = Field(
                    argument.default, description=limits.meaning, ge=limits.least, le=limits.most
                )
                more[name] = (types[name].__origin__, field)
    # Pickling looks the class up in this module.
    return create_model(
        "ContactSection", __base__=CommonContactSection, __module__=__name__, **more
    )


if TYPE_CHECKING:
    ContactSection = CommonContactSection
else:
    ContactSection = with_constants_of_laws(CONTACT_LAWS)


class LateralSection(Section):
    """Lateral compartment, if both are modelled. Values that you do not set equal those of the medial one."""

    femur: FemurSection = FemurSection()
    tibia: TibiaSection = TibiaSection()
    contact: ContactSection = ContactSection()


class FidelitySection(Section):
    """Level, accuracy and largest cost of the solution."""

    level: Annotated[str, BeforeValidator(_replace_first_order), one_of(*LEVELS)] = "auto"
    """equations that a tick solves; auto: dynamic"""
    tolerance: float = Field(1.0e-6, ge=1e-10, le=1e-3)
    """[m] wanted error of the penetration depth; below 1e-10 m rounding can be larger than the estimates"""
    force_tolerance: Annotated[float, off_or_at_least(1e-9)] = Field(0.0, ge=0.0, le=1e6)
    """[N] wanted error of the contact force; 0: off"""
    budget: Annotated[int, off_or_at_least(100, "a hundred thousand", "an integer")] = Field(
        BUDGET, ge=0
    )
    """largest number of evaluations of the contact in a tick, probes of its flights included; a tick that reaches it
    gets the static contact and a flag, and so do later ticks until the contact has settled; 0: 100000"""


class RerunSection(Section):
    """Viewer: the scene in Rerun."""

    output: ClassVar[str] = "knee_contact_ros.view.output"

    mode: Annotated[
        str, BeforeValidator(_restore_off), one_of("off", "file", "serve", "spawn")
    ] = "off"
    """off; file: write rerun.path; serve: to viewers on this machine; spawn: open a viewer"""
    path: str = ""
    """.rrd file to write, for mode file; {stamp} in the name becomes the time"""
    port: int = Field(9876, ge=1024, le=65535)
    """port to serve on"""
    knees: str = ""
    """names of knees that share a viewer, for example left,right; empty: this knee alone"""
    queue: int = Field(20_000, ge=100, le=10_000_000)
    """largest number of answers that wait for the process of this output"""
    queue_size: float = Field(64.0, ge=1.0, le=1e5)
    """[MB] largest memory of waiting answers"""


class Parameters(NodeSection):
    """All parameters of the contact node and of the offline commands."""

    node = "knee_contact"
    force_source, usual_forces = "load.source", "joint_reaction_force"
    companion = "knee_load"
    other_names = MappingProxyType(
        {
            "person.mass": ("body_weight", GRAVITY),
            "knee.sign": ("knee.flexion_sign", 1.0),
            "knee.offset": ("knee.flexion_offset", 1.0),
        }
    )
    encoder = ("knee.source", "knee.joint_name", "knee.flexion_sign", "knee.flexion_offset")
    about_person = MappingProxyType({"body_weight": "N"})

    knee: KneeSection = KneeSection()
    orientations: OrientationsSection = OrientationsSection()
    load: LoadSection = LoadSection()
    frame: FrameSection = FrameSection()
    pairing: PairingSection = PairingSection()
    drive: Annotated[str, one_of("force", "displacement")] = "force"
    """force: the load is prescribed (Eq. 13); displacement: the femoral height is prescribed"""
    femur: FemurSection = FemurSection()
    tibia: TibiaSection = TibiaSection()
    translation: TranslationSection = TranslationSection()
    contact: ContactSection = ContactSection()
    lateral: LateralSection = LateralSection()
    fidelity: FidelitySection = FidelitySection()
    body_weight: float = Field(737.068, gt=0.0, le=1e5)
    """[N] body weight, for forces in BW"""
    autostart: bool = True
    """true: the node configures and activates itself"""
    realtime: bool = False
    """true: while active, the node's threads go before all ordinary processes (SCHED_FIFO), and its memory is locked"""
    deadline: float = Field(0.02, gt=0.0, le=3600.0)
    """[s] longest time from a force to its answer; the node counts later answers"""
    diagnostics: ContactDiagnosticsSection = ContactDiagnosticsSection()
    record: RecordSection = RecordSection()
    rerun: RerunSection = RerunSection()

    @model_validator(mode="before")
    @classmethod
    def _lateral_follows(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Give the lateral compartment the medial one's values where it has none of its own."""
        own = dict(values.get("lateral", {}))
        both = {
            name: {**dict(values.get(name, {})), **dict(own.get(name, {}))}
            for name in LateralSection.model_fields
        }
        return {**values, "lateral": both}

    def joints(self) -> dict[str, str]:
        """Joints of the knee; see `NodeSection`."""
        wanted = {"knee.joint_name": self.knee.joint_name}
        if self.drive == "displacement":
            wanted["knee.height_joint_name"] = self.knee.height_joint_name
        return wanted

    def thigh(self) -> TopicSource | None:
        """Source of the thigh's orientation; see `NodeSection`."""
        return orientation_source(self.orientations.thigh) if self.orientations.thigh else None

    def inputs(self) -> tuple[TopicSource, TopicSource]:
        """Sources of the angles, or of the shank's orientation, and of the forces; see `NodeSection`."""
        angles, forces = super().inputs()
        shank = self.orientations.shank
        return orientation_source(shank) if shank else angles, forces

    def problem(self) -> str:
        """First combination of values that is not allowed, in either compartment; see `NodeSection`."""
        both = self.orientations.thigh, self.orientations.shank
        if any(both) and (not all(both) or both[0] == both[1] or self.drive != "force"):
            return "orientations: allowed: thigh and shank, of two sensors, with drive force"
        why = "load.rotation" if self.load.rotation else "frame.tibia"
        needed = 3 if self.load.rotation or self.frame.tibia else 1
        if self.load.rule == "moment_balance":
            needed, why = 6, "moment_balance"
        first = self.problem_of_sources(needed, why) or self._problem_of_knee()
        if first or not has_two_compartments(self):
            return first
        if self.drive != "force":
            return f"load.compartment: {BOTH!r} is not allowed; drive {self.drive} has no load that could be split"
        lateral = lateral_knee(self)._problem_of_knee()
        return lateral and LATERAL_PREFIX + lateral

    def _problem_of_knee(self) -> str:
        """Return the first combination of this knee's values that is not allowed; empty if there is none."""
        femur, tibia = self.femur, self.tibia
        contact, translation = self.contact, self.translation
        material = contact.stiffness_from == "material"
        bones = (("femur", femur), ("tibia", tibia))
        no_profiles = [
            (
                bone.geometry == "profile" and not bone.profile,
                f"{name}.profile is empty; {name}.geometry profile needs the name of a CSV file",
            )
            for name, bone in bones
        ]
        scaled = [
            (
                bone.geometry != "profile" and bone.scale != 1.0,
                f"{name}.scale: {bone.scale:g} is not allowed; only {name}.geometry profile is scaled",
            )
            for name, bone in bones
        ]
        rules = (
            *no_profiles,
            *scaled,
            (
                tibia.geometry != "plane" and tibia.slope != 0.0,
                f"tibia.slope: {tibia.slope:g} is not allowed; only tibia.geometry plane has a slope",
            ),
            (
                tibia.geometry == "circle"
                and femur.geometry == "circle"
                and tibia.radius <= femur.radius,
                f"tibia.radius: {tibia.radius:g} is not allowed; it must exceed femur.radius, {femur.radius:g}",
            ),
            (
                translation.mechanism == "table" and not translation.table,
                "translation.table is empty; translation.mechanism table needs the name of a CSV file",
            ),
            (
                self.load.rule == "measured_share" and not self.load.share_file,
                "load.share_file is empty; load.compartment measured_share needs the name of a CSV file",
            ),
            (
                material and contact.exponent != 1.5,
                f"contact.exponent: {contact.exponent:g} is not allowed; contact.stiffness_from material needs 1.5 "
                "(Hertz)",
            ),
            (
                (material or contact.law == "elastic_foundation")
                and contact.tibial_radius <= contact.femoral_radius,
                f"contact.tibial_radius: {contact.tibial_radius:g} is not allowed; it must exceed "
                f"contact.femoral_radius, {contact.femoral_radius:g}",
            ),
            (
                self.rerun.mode == "file" and not self.rerun.path,
                "rerun.path is empty; rerun.mode file needs the name of an .rrd file",
            ),
        )
        return next((reason for broken, reason in rules if broken), "")


def has_two_compartments(parameters: Parameters) -> bool:
    """Whether medial and lateral contact are computed."""
    return parameters.load.compartment == BOTH


def lateral_knee(parameters: Parameters) -> Parameters:
    """Parameters of the lateral compartment, under the names of the medial one's."""
    own = parameters.lateral
    return parameters.model_copy(
        update={"femur": own.femur, "tibia": own.tibia, "contact": own.contact}
    )
