"""Declaration of all parameters of both nodes: type, default, unit, meaning and limits.

The node, parameter files, `--help`, the reference page and changes at run time use this declaration. `files.py` reads
values for these parameters, and `build.py` builds models from them.
"""

from __future__ import annotations

import functools
import inspect
import logging
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, get_type_hints

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, create_model
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from knee_contact_ros.joint_reaction.compartments import BOTH, RULES, SPLITS
from knee_contact_ros.joint_reaction.estimator import LEVELS as LOAD_LEVELS
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.model.knee import BUDGET
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.sources import FORM, JOINT_STATE, WRENCH_STAMPED, Source, source_of

AUTO = "auto"
LATERAL = "lateral."
"""Beginning of the names of the lateral compartment's parameters"""
FIRST_ORDER = "first_order"
"""Level of earlier versions"""
_log = logging.getLogger(__name__)


class Rule:
    """Rule for the values of a parameter, which pydantic checks after their type."""

    def __init__(self, allows: Callable[[Any], bool], words: str, least: float, most: float = math.inf) -> None:
        """Allow some values, described by `words`; numbers among them lie between `least` and `most`."""
        self._allows, self.words, self.least, self.most = allows, words, least, most

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema of the type, with the check behind it."""
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, value: Any) -> Any:
        if not self._allows(value):
            raise ValueError(f"allowed: {self.words}")
        return value


def one_of(*allowed: str | float) -> Rule:
    """Rule that allows these values only."""
    numbers = [value for value in allowed if not isinstance(value, str)] or [-math.inf, math.inf]
    return Rule(allowed.__contains__, ", ".join(map(str, allowed)), min(numbers), max(numbers))


def off_or_at_least(least: float, zero: str = "off", numbers: str = "a number") -> Rule:
    """Rule that allows 0, which means `zero`, and numbers from `least` on, described by `numbers`."""
    return Rule(lambda value: value == 0 or value >= least, f"0 ({zero}) or {numbers} >= {least:g}", 0.0)


class Limits(NamedTuple):
    """Limits of a parameter."""

    least: float
    """Smallest number, itself allowed unless `words` say otherwise; -inf if there is none, or for a text"""
    most: float
    """Largest number, itself allowed unless `words` say otherwise; inf if there is none, or for a text"""
    words: str
    """Limits that the numbers do not show: a list, an open end, a gap; empty if there are none"""


def limits_of(field: FieldInfo) -> Limits:
    """Limits of a declared parameter, from the rules in its annotation."""
    least, most, words = -math.inf, math.inf, []
    for rule in field.metadata:
        if isinstance(rule, Rule):
            least, most = max(least, rule.least), min(most, rule.most)
            words.append(rule.words)
        least, most = getattr(rule, "ge", least), getattr(rule, "le", most)  # the rules of annotated_types
        if hasattr(rule, "gt"):
            least = rule.gt
            words.append(f"> {least:g}")
        if hasattr(rule, "lt"):
            most = rule.lt
            words.append(f"< {most:g}")
    return Limits(least, most, "; ".join(words))


class Declaration(NamedTuple):
    """Declaration of a parameter."""

    default: Any
    description: str
    limits: Limits


class Section(BaseModel):
    """Group of parameters; names and types are strict, numbers finite."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class NodeSection(Section):
    """All parameters of a node."""

    node: ClassVar[str]
    """Name of the node"""
    folder: ClassVar[str] = ""
    """Folder of the package's own parameter files for the node, within `config`"""
    force_source: ClassVar[str]
    """Name of the parameter for the source of the forces"""
    usual_forces: ClassVar[str]
    """Its default: the name of the usual topic"""

    def problem(self) -> str:
        """Return the first combination of values that is not allowed, as name and reason; empty if there is none."""
        raise NotImplementedError

    def problem_of_sources(self, needed: int, why: str) -> str:
        """Report a wrong number of fields. Forces need `needed` fields because of `why`."""
        angles, forces = (len(source.fields) for source in self.inputs())
        joints, (first, second) = self.joints(), self.inputs()
        if angles not in (0, len(joints)):
            return f"knee.source: {angles} fields are not allowed; {', '.join(joints)} need {len(joints)}"
        if forces not in (0, 1, 3, 6):
            return f"{self.force_source}: {forces} fields are not allowed; a number, a force's three, or a wrench's six"
        if 0 < forces < needed:
            return f"{self.force_source}: {forces} fields are not allowed; {why} needs {needed}"
        if first.topic == second.topic and first.type != second.type:
            return f"knee.source: {first.topic} is also the topic of {self.force_source}, and a topic cannot have two "
            "types"
        return ""

    def inputs(self) -> tuple[Source, Source]:
        """Sources of the angles and of the forces."""
        raise NotImplementedError

    def joints(self) -> dict[str, str]:
        """Names of the joints that the node needs, by the parameters that give them."""
        raise NotImplementedError


def parameter(default: Any, meaning: str, **limits: Any) -> Any:
    """Declare a parameter in a section; `limits` are pydantic's (`ge`, `gt`, `le`, `lt`, `min_length`)."""
    return Field(default, description=meaning, **limits)


def frame_name(name: str) -> str:
    """Check the name of a tf2 frame, which may be empty.

    Raises:
        ValueError: it begins with a slash, or it is only the suffix of a tibia frame.
    """
    if name.startswith("/") or name == "_isb":
        raise ValueError("allowed: the name of a tf2 frame, without a slash before it")
    return name


class SourceRule(Rule):
    """Rule for the text of a source, whose messages are of the input's own type unless the text names another one."""

    def __init__(self, own_type: str) -> None:
        super().__init__(lambda _: True, FORM, -math.inf)
        self._own_type = own_type

    def _checked(self, value: Any) -> Any:
        source_of(value, self._own_type)
        return value


AngleSource = Annotated[str, SourceRule(JOINT_STATE)]
ForceSource = Annotated[str, SourceRule(WRENCH_STAMPED)]
ANGLES = "topic of the angles, of type JointState or dynamic_joint_states; for another type, one field for each joint"


class Pairing(Section):
    """Pairing of angle and force samples by their stamps."""

    wait: float = parameter(0.1, "[s] how long a force waits for an angle at or after its stamp", ge=0.0, le=10.0)
    max_gap: float = parameter(0.1, "[s] largest gap between stamps that is not flagged stale", gt=0.0, le=3600.0)
    angle_delay: float = parameter(
        0.0, "[s] how much later angles arrive than forces; their stamps are moved back by this", ge=-1.0, le=1.0
    )
    queue: int = parameter(20_000, "largest number of samples of one stream that wait for the other", ge=100, le=10**7)


class Diagnostics(Section):
    """Limits of the inputs beyond which `/diagnostics` warns or reports an error."""

    angle_warn_rate: float = parameter(0.0, "[Hz] warn if the angles are slower than this; 0: off", ge=0.0, le=1e5)
    angle_error_rate: float = parameter(
        0.0, "[Hz] report an error if the angles are slower than this; 0: off", ge=0.0, le=1e5
    )
    force_warn_rate: float = parameter(0.0, "[Hz] warn if the forces are slower than this; 0: off", ge=0.0, le=1e5)
    force_error_rate: float = parameter(
        0.0, "[Hz] report an error if the forces are slower than this; 0: off", ge=0.0, le=1e5
    )
    timeout: float = parameter(1.0, "[s] an input is stale after this time without a message", gt=0.0, le=3600.0)


class ContactDiagnostics(Diagnostics):
    """The same for the contact node, which also reports the uncertainty of force and depth due to the load."""

    load_deviation: float = parameter(
        0.0, "standard deviation of a compartment's load, as a fraction of body weight; 0: not known", ge=0.0, le=10.0
    )


def queue(answers: int) -> Any:
    """Field for the number of answers that may wait for an output's process; `answers` is the default."""
    return parameter(
        answers, "largest number of answers that wait for the process of this output", ge=100, le=10_000_000
    )


def queue_size(size: float) -> Any:
    """Field for the memory that answers may take while they wait; `size` [MB] is the default."""
    return parameter(size, "[MB] largest memory of waiting answers", ge=1.0, le=1e5)


# A section of an output names the module that describes it: see `streams/output.py`.


class Record(Section):
    """Recording to MCAP."""

    output: ClassVar[str] = "knee_contact_ros.bags.recorder"

    path: str = parameter("", "MCAP file to write; {stamp} in the name becomes the time; empty: do not record")
    flush_period: float = parameter(
        0.03, "[s] period of writing to the file; a crash loses at most this much", ge=0.001, le=60.0
    )
    sync_period: Annotated[float, off_or_at_least(0.05)] = parameter(
        1.0, "[s] period of syncing the disk; a power failure loses at most this much; 0: off", le=3600.0
    )
    max_size: Annotated[float, off_or_at_least(0.1)] = parameter(
        0.0, "[MB] start a new file at this size; 0: off", le=1e9
    )
    max_duration: Annotated[float, off_or_at_least(1.0)] = parameter(
        0.0, "[s] start a new file after this span of stamps; 0: off", le=1e9
    )
    min_free: float = parameter(100.0, "[MB] end the recording if the disk has less free space", ge=0.0, le=1e9)
    snapshot: float = parameter(
        10.0, "[s] length of the snapshot that ~/save_snapshot writes, kept in memory; 0: off", ge=0.0, le=3600.0
    )
    queue: int = queue(30_000)
    queue_size: float = queue_size(100.0)


def _off(value: object) -> object:
    """Restore `off`, which ROS 2 parameter files read as the truth value false (YAML 1.1)."""
    return "off" if value is False else value


def _level_of_today(level: object) -> object:
    """Replace a level of earlier versions that no longer exists, and say so once."""
    if level != FIRST_ORDER:
        return level
    _tell_of_first_order()
    return "dynamic"


@functools.cache
def _tell_of_first_order() -> None:
    _log.warning(
        "fidelity.level: %s no longer exists; dynamic is used instead, which is faster and more accurate", FIRST_ORDER
    )


class Knee(Section):
    """Knee joint in the joint states; the flexion angle is flexion_sign x position + flexion_offset."""

    joint_name: str = parameter("knee", "joint in joint_states", min_length=1)
    flexion_sign: Annotated[float, one_of(1.0, -1.0)] = parameter(1.0, "1 if the position grows in flexion, or -1")
    flexion_offset: float = parameter(0.0, "[rad] added to the signed position", ge=-10.0, le=10.0)
    height_joint_name: str = parameter(
        "knee_height", "joint whose position is the femoral height [m], for drive displacement", min_length=1
    )
    source: AngleSource = parameter("joint_states", ANGLES)


class Load(Section):
    """Part of the axial joint reaction that loads the compartment."""

    source: ForceSource = parameter(
        "joint_reaction_force",
        "topic of the joint reaction, of type WrenchStamped; for another type, one field for the compression, three "
        "for the force on the tibia (x, y, z), or six for the wrench",
    )
    compartment: Annotated[str, one_of(*RULES, BOTH)] = parameter(
        "fixed_share", "rule for the load of the compartment; both: model the medial and the lateral one"
    )
    split: Annotated[str, one_of(*SPLITS)] = parameter(
        "fixed_share", "rule for the medial load if load.compartment is both"
    )
    share: float = parameter(0.5, "medial share of the axial joint reaction, for fixed_share", gt=0.0, le=1.0)
    share_file: str = parameter(
        "share_medial.csv", "CSV file with flexion_angle [rad], axial_load [BW] and medial_share, for measured_share"
    )
    compartment_spacing: float = parameter(
        0.07, "[m] distance from the medial to the lateral compartment, for moment_balance and both", ge=0.005, le=0.2
    )

    @property
    def rule(self) -> str:
        """Name of the rule in `RULES` for the load of the medial (or only) compartment."""
        return self.split if self.compartment == BOTH else self.compartment


class Frame(Section):
    """Frame of the messages."""

    tibia: Annotated[str, AfterValidator(frame_name)] = parameter(
        "", "turn forces into this tibia frame (x anterior, y superior, z right); empty: do not turn them"
    )


class Femur(Section):
    """Mass and contact surface of the femur."""

    mass: float = parameter(9.3014, "[kg] mass that moves up and down with the femur", ge=1e-4, le=1e3)
    geometry: Annotated[str, one_of(*GEOMETRIES)] = parameter("circle", "surface of the femur")
    radius: float = parameter(0.034, "[m] radius of the femoral circle", gt=0.0, le=1.0)
    profile: str = parameter("", "CSV file with x, y [m] in the femur frame, in order along the curve")
    scale: float = parameter(1.0, "factor for the size of the profile", ge=0.1, le=10.0)


class Tibia(Section):
    """Contact surface of the tibia, the plateau."""

    geometry: Annotated[str, one_of(*TIBIAL_GEOMETRIES)] = parameter("plane", "surface of the tibial plateau")
    slope: float = parameter(0.0, "[rad] slope of the plane, positive if its anterior edge is higher", ge=-0.7, le=0.7)
    radius: float = parameter(0.095, "[m] radius of the concave tibial circle", gt=0.0, le=10.0)
    profile: str = parameter("", "CSV file with x, y [m] in the tibia frame, from posterior to anterior")
    scale: float = parameter(1.0, "factor for the size of the profile", ge=0.1, le=10.0)


class Translation(Section):
    """Anterior-posterior translation of the femur."""

    mechanism: Annotated[str, one_of(*MECHANISMS)] = parameter("hinge", "how the femur moves along the plateau")
    table: str = parameter("", "CSV file with flexion_angle [rad] and x [m] of the femoral reference point")


class CommonContactParameters(Section):
    """Contact law, and the constants that several laws use or that other parameters depend on.

    Further arguments of a law's factory are parameters, too; see `with_constants_of_laws`.
    """

    law: Annotated[str, one_of(*CONTACT_LAWS)] = parameter("kelvin_voigt", "contact law")
    stiffness: float = parameter(7.905694e7, "[N/m^exponent] stiffness of the first layer", ge=1.0, le=1e15)
    exponent: float = parameter(1.5, "exponent of the depth; 1.5 for two curved solids", ge=1.0, le=3.0)
    damping: float = parameter(5000.0, "[N s/m] damping: force per penetration rate", ge=0.0, le=1e9)
    allow_tension: bool = parameter(False, "let the law pull instead of clamping it at 0")
    layer_depth: float = parameter(5.0e-4, "[m] depth at which the second layer (bone) begins", gt=0.0, le=0.1)
    stiffness_2: float = parameter(3.112e9, "[N/m^exponent] stiffness of the second layer", ge=1.0, le=1e15)
    damp_first_layer: bool = parameter(False, "two_layer_viscoelastic: put the dashpot into both layers")
    restitution: float = parameter(0.5, "coefficient of restitution, for laws with impact damping", ge=0.01, le=1.0)
    least_impact_speed: float = parameter(
        0.1,
        "[m/s] lowest impact speed for impact damping; slower impacts and the static start use this value",
        ge=1e-6,
        le=100.0,
    )
    stiffness_from: Annotated[str, one_of("value", "material")] = parameter(
        "value", "value: contact.stiffness; material: Hertz from modulus, Poisson's ratio and radii (exponent 1.5)"
    )
    youngs_modulus: float = parameter(24e6, "[Pa] Young's modulus of cartilage (first layer)", ge=1.0, le=1e13)
    poissons_ratio: float = parameter(0.38, "Poisson's ratio of cartilage (first layer)", ge=0.0, lt=0.5)
    youngs_modulus_2: float = parameter(17.2e9, "[Pa] Young's modulus of bone (second layer)", ge=1.0, le=1e13)
    poissons_ratio_2: float = parameter(0.39, "Poisson's ratio of bone (second layer)", ge=0.0, lt=0.5)
    femoral_radius: float = parameter(
        0.034,
        "[m] convex radius of the femur for stiffness_from material, elastic_foundation and the patch",
        gt=0.0,
        le=10.0,
    )
    tibial_radius: float = parameter(0.095, "[m] concave radius of the tibia, for the same three", gt=0.0, le=10.0)
    foundation_thickness: float = parameter(
        4.4e-3, "[m] thickness of both cartilages together, for elastic_foundation and the strain", gt=0.0, le=0.1
    )


def constants_of(law: str) -> list[str]:
    """Names of the parameters `contact.*` that a law uses."""
    return list(_arguments(CONTACT_LAWS[law]))


@functools.cache
def _arguments(factory: Callable[..., Any]) -> tuple[str, ...]:
    """Names of a factory's arguments; kept, as inspecting a signature takes as long as making ten laws."""
    return tuple(inspect.signature(factory).parameters)


def with_constants_of_laws(laws: Mapping[str, Callable[..., Any]]) -> type[CommonContactParameters]:
    """Section with the common parameters and the further arguments of these laws' factories.

    Each of those has a default and a `Range` in the signature.
    """
    more: dict[str, Any] = {}
    for factory in laws.values():
        types = get_type_hints(factory, include_extras=True)
        for name, argument in inspect.signature(factory).parameters.items():
            if name not in CommonContactParameters.model_fields:
                (limits,) = types[name].__metadata__
                field = parameter(argument.default, limits.meaning, ge=limits.least, le=limits.most)
                more[name] = (types[name].__origin__, field)
    # The module, so that it can be pickled.
    return create_model("ContactParameters", __base__=CommonContactParameters, __module__=__name__, **more)


if TYPE_CHECKING:
    ContactParameters = CommonContactParameters
else:
    ContactParameters = with_constants_of_laws(CONTACT_LAWS)


class Lateral(Section):
    """Lateral compartment, if both are modelled. Values that you do not set equal those of the medial one."""

    femur: Femur = Femur()
    tibia: Tibia = Tibia()
    contact: ContactParameters = ContactParameters()


class FidelityParameters(Section):
    """Level, accuracy and largest cost of the solution."""

    level: Annotated[str, BeforeValidator(_level_of_today), one_of(*LEVELS)] = parameter(
        "auto", "equations that a tick solves; auto: dynamic"
    )
    tolerance: float = parameter(1.0e-6, "[m] wanted error of the penetration depth", ge=1e-12, le=1e-3)
    force_tolerance: Annotated[float, off_or_at_least(1e-9)] = parameter(
        0.0, "[N] wanted error of the contact force; 0: off", le=1e6
    )
    budget: Annotated[int, off_or_at_least(100, "a hundred thousand", "an integer")] = parameter(
        BUDGET,
        "largest number of contact law evaluations in a tick; a tick that reaches it gets the static contact and a "
        "flag, and so do later ticks until the contact has settled; 0: 100000",
    )


class Rerun(Section):
    """Viewer: the scene in Rerun."""

    output: ClassVar[str] = "knee_contact_ros.view.output"

    mode: Annotated[str, BeforeValidator(_off), one_of("off", "file", "serve", "spawn")] = parameter(
        "off", "off; file: write rerun.path; serve: to viewers on this machine; spawn: open a viewer"
    )
    path: str = parameter("", ".rrd file to write, for mode file; {stamp} in the name becomes the time")
    port: int = parameter(9876, "port to serve on", ge=1024, le=65535)
    knees: str = parameter("", "names of knees that share a viewer, for example left,right; empty: this knee alone")
    queue: int = queue(20_000)
    queue_size: float = queue_size(64.0)


class Parameters(NodeSection):
    """All parameters of the contact node and of the offline commands."""

    node = "knee_contact"
    force_source, usual_forces = "load.source", "joint_reaction_force"

    knee: Knee = Knee()
    load: Load = Load()
    frame: Frame = Frame()
    pairing: Pairing = Pairing()
    drive: Annotated[str, one_of("force", "displacement")] = parameter(
        "force", "force: the load is prescribed (Eq. 13); displacement: the femoral height is prescribed"
    )
    femur: Femur = Femur()
    tibia: Tibia = Tibia()
    translation: Translation = Translation()
    contact: ContactParameters = ContactParameters()
    lateral: Lateral = Lateral()
    fidelity: FidelityParameters = FidelityParameters()
    body_weight: float = parameter(737.068, "[N] body weight, for forces in BW", gt=0.0, le=1e5)
    autostart: bool = parameter(True, "true: the node configures and activates itself")
    deadline: float = parameter(
        0.02, "[s] longest time from a force to its answer; the node counts later answers", gt=0.0, le=3600.0
    )
    diagnostics: ContactDiagnostics = ContactDiagnostics()
    record: Record = Record()
    rerun: Rerun = Rerun()

    def inputs(self) -> tuple[Source, Source]:
        """Sources of the angles and of the joint reaction."""
        return source_of(self.knee.source, JOINT_STATE), source_of(self.load.source, WRENCH_STAMPED)

    def joints(self) -> dict[str, str]:
        """Joints of the knee; see `NodeSection`."""
        wanted = {"knee.joint_name": self.knee.joint_name}
        if self.drive == "displacement":
            wanted["knee.height_joint_name"] = self.knee.height_joint_name
        return wanted

    def problem(self) -> str:
        """First combination of values that is not allowed, in either compartment; see `NodeSection`."""
        by_moment = self.load.rule == "moment_balance"
        needed, why = (6, "moment_balance") if by_moment else (3 if self.frame.tibia else 1, "frame.tibia")
        first = self.problem_of_sources(needed, why) or self._problem_of_knee()
        if first or not has_both(self):
            return first
        if self.drive != "force":
            return f"load.compartment: {BOTH!r} is not allowed; drive {self.drive} has no load that could be split"
        lateral = lateral_knee(self)._problem_of_knee()
        return lateral and LATERAL + lateral

    def _problem_of_knee(self) -> str:
        femur, tibia, contact, translation = self.femur, self.tibia, self.contact, self.translation
        material = contact.stiffness_from == "material"
        bones = (("femur", femur), ("tibia", tibia))
        rules = (
            *((bone.geometry == "profile" and not bone.profile,
               f"{name}.profile is empty; {name}.geometry profile needs the name of a CSV file")
              for name, bone in bones),
            *((bone.geometry != "profile" and bone.scale != 1.0,
               f"{name}.scale: {bone.scale:g} is not allowed; only {name}.geometry profile is scaled")
              for name, bone in bones),
            (tibia.geometry != "plane" and tibia.slope != 0.0,
             f"tibia.slope: {tibia.slope:g} is not allowed; only tibia.geometry plane has a slope"),
            (tibia.geometry == "circle" and femur.geometry == "circle" and tibia.radius <= femur.radius,
             f"tibia.radius: {tibia.radius:g} is not allowed; it must exceed femur.radius, {femur.radius:g}"),
            (translation.mechanism == "table" and not translation.table,
             "translation.table is empty; translation.mechanism table needs the name of a CSV file"),
            (self.load.rule == "measured_share" and not self.load.share_file,
             "load.share_file is empty; load.compartment measured_share needs the name of a CSV file"),
            (material and contact.exponent != 1.5,
             f"contact.exponent: {contact.exponent:g} is not allowed; contact.stiffness_from material needs 1.5 "
             "(Hertz)"),
            ((material or contact.law == "elastic_foundation") and contact.tibial_radius <= contact.femoral_radius,
             f"contact.tibial_radius: {contact.tibial_radius:g} is not allowed; it must exceed contact.femoral_radius, "
             f"{contact.femoral_radius:g}"),
            (self.rerun.mode == "file" and not self.rerun.path,
             "rerun.path is empty; rerun.mode file needs the name of an .rrd file"),
        )  # fmt: skip
        return next((reason for broken, reason in rules if broken), "")


def has_both(parameters: Parameters) -> bool:
    """Whether medial and lateral contact are computed."""
    return parameters.load.compartment == BOTH


def lateral_knee(parameters: Parameters) -> Parameters:
    """Parameters of the lateral compartment, under the names of the medial one's."""
    own = parameters.lateral
    return parameters.model_copy(update={"femur": own.femur, "tibia": own.tibia, "contact": own.contact})


class MeasuredJoint(Section):
    """Joint in joint_states; its angle is sign x position + offset."""

    joint_name: str = parameter("", "joint in joint_states; empty: not measured")
    sign: Annotated[float, one_of(1.0, -1.0)] = parameter(1.0, "1 if the position grows with the angle, or -1")
    offset: float = parameter(0.0, "[rad] added to the signed position", ge=-10.0, le=10.0)


class ActuatedJoint(MeasuredJoint):
    """Joint in joint_states that an actuator may turn."""

    assisted: bool = parameter(
        False, "true: the effort [N m] in joint_states is an actuator's torque, with the sign of the position"
    )


class FlexedKnee(ActuatedJoint):
    """Knee joint; its angle is positive in flexion."""

    joint_name: str = parameter("knee", "joint in joint_states", min_length=1)
    source: AngleSource = parameter("joint_states", ANGLES)


class GroundForce(Section):
    """Meaning of `ground_reaction_force`: x forward, y up, z to the right."""

    source: ForceSource = parameter(
        "ground_reaction_force",
        "topic of the ground force, of type WrenchStamped; for another type, one field for the upward force, three "
        "for the force (x, y, z), or six for the wrench",
    )
    components: Annotated[str, one_of("vertical", "full")] = parameter(
        "vertical", "vertical: use force.y only, as from an insole; full: use force and torque"
    )
    axes: Annotated[str, one_of("ground", "foot")] = parameter(
        "ground", "ground: the axes of the wrench stay upright; foot: they turn with the foot"
    )
    ankle_x: float = parameter(
        0.0, "[m] forward position of the ankle joint in the frame of the wrench", ge=-1.0, le=1.0
    )
    ankle_y: float = parameter(0.0, "[m] upward position of the ankle joint in that frame", ge=-1.0, le=1.0)


class LoadFrames(Section):
    """Frames of the messages."""

    ground: Annotated[str, AfterValidator(frame_name)] = parameter(
        "", "turn ground forces into this frame (x forward, y up, z right); empty: do not turn them"
    )
    tibia: Annotated[str, AfterValidator(frame_name)] = parameter(
        "tibia", "frame_id of the joint reaction force: x anterior, y superior, z right", min_length=1
    )


class PersonParameters(Section):
    """The person. Muscles are not measured; `knee-contact calibrate` fits their constants to a bag."""

    mass: float = parameter(75.16, "[kg] body mass", ge=10.0, le=400.0)
    height: float = parameter(1.75, "[m] body height", ge=0.8, le=2.5)
    moment_arm_scale: float = parameter(1.75, "factor for the published moment arms of the muscles", ge=0.3, le=3.0)
    co_contraction: float = parameter(
        0.39, "smallest pull of antagonists, as a fraction of the vertical ground force", ge=0.0, le=3.0
    )
    tone: float = parameter(0.27, "smallest pull of antagonists, as a fraction of body weight", ge=0.0, le=2.0)
    electromechanical_delay: float = parameter(
        0.025, "[s] time constant with which muscle forces follow the demand; 0: at once", ge=0.0, le=0.2
    )

    @property
    def constants(self) -> Person:
        """Constants of the person for the estimator."""
        return Person(
            self.mass, self.height, self.moment_arm_scale, self.co_contraction, self.tone, self.electromechanical_delay
        )


class LoadParameters(NodeSection):
    """All parameters of the load node, `estimate-load` and `estimate_load`."""

    node = "knee_load"
    folder = "load"
    force_source, usual_forces = "ground.source", "ground_reaction_force"

    level: Annotated[str, one_of(AUTO, *LOAD_LEVELS)] = parameter(
        AUTO, f"{', '.join(LOAD_LEVELS)}, or auto: the last of these that the inputs allow"
    )
    knee: FlexedKnee = FlexedKnee()
    ankle: ActuatedJoint = ActuatedJoint()
    hip: MeasuredJoint = MeasuredJoint()
    ground: GroundForce = GroundForce()
    frame: LoadFrames = LoadFrames()
    person: PersonParameters = PersonParameters()
    calibrated: bool = parameter(False, "true: the constants were fitted to a measured knee of this person")
    standard_deviation: Annotated[float, off_or_at_least(0.01, "as measured for the level")] = parameter(
        0.0,
        "standard deviation of the axial force, as a fraction of body weight; 0: as measured for the level",
        le=10.0,
    )
    motion_window: Annotated[float, off_or_at_least(0.01, "no inertia")] = parameter(
        0.05, "[s] window for the accelerations of the joints, which delays them by half of it; 0: no inertia", le=1.0
    )
    pairing: Pairing = Pairing()
    autostart: bool = parameter(True, "true: the node configures and activates itself")
    deadline: float = parameter(
        0.02, "[s] longest time from a ground force to its estimate; the node counts later estimates", gt=0.0, le=3600.0
    )
    diagnostics: Diagnostics = Diagnostics()
    record: Record = Record()

    def inputs(self) -> tuple[Source, Source]:
        """Sources of the angles and of the ground force."""
        return source_of(self.knee.source, JOINT_STATE), source_of(self.ground.source, WRENCH_STAMPED)

    def joints(self) -> dict[str, str]:
        """Joints of the leg that are measured; see `NodeSection`."""
        joints = {"knee": self.knee, "hip": self.hip, "ankle": self.ankle}
        return {f"{name}.joint_name": joint.joint_name for name, joint in joints.items() if joint.joint_name}

    @property
    def chosen_level(self) -> str:
        """Name of the level, of `LOAD_LEVELS`; `auto` is resolved by the inputs."""
        return allowed_levels(self)[-1] if self.level == AUTO else self.level

    def problem(self) -> str:
        """First combination of values that is not allowed; see `NodeSection`."""
        allowed = allowed_levels(self)
        joints = [joint.joint_name for joint in (self.knee, self.ankle, self.hip) if joint.joint_name]
        if self.level not in (AUTO, *allowed):
            return (
                f"level: {self.level!r} is not allowed; it needs ground.components full, and hip.joint_name with "
                "ground.axes ground or ankle.joint_name with foot; ankle_moment also ankle.joint_name. "
                f"These inputs allow {', '.join(allowed)}"
            )
        if len(set(joints)) < len(joints):
            return f"knee.joint_name: {', '.join(joints)} are not different joints"
        if self.ankle.assisted and not self.ankle.joint_name:
            return "ankle.assisted: True is not allowed; ankle.joint_name is empty"
        assisted = self.knee.assisted or self.ankle.assisted
        if assisted and self.inputs()[0].fields:
            return "knee.source: fields are not allowed; they give no effort of an assisted joint"
        is_full = self.ground.components == "full"
        needed, why = (6, "ground.components full") if is_full else (3 if self.frame.ground else 1, "frame.ground")
        return self.problem_of_sources(needed, why)


def allowed_levels(parameters: LoadParameters) -> list[str]:
    """Names of the levels that the inputs allow, in increasing order of what they use."""
    hip, ankle = bool(parameters.hip.joint_name), bool(parameters.ankle.joint_name)
    upright = parameters.ground.axes == "ground"
    allowed = ["ground_force"]
    if parameters.ground.components == "full" and (hip if upright else ankle):
        allowed += ["knee_moment", "ankle_moment"] if ankle else ["knee_moment"]
    return allowed
