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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo

from knee_contact_ros.joint_reaction.compartments import BOTH, RULES, SPLITS
from knee_contact_ros.joint_reaction.estimator import LEVELS as LOAD_LEVELS
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.model.knee import BUDGET
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.sources import (
    FORM,
    JOINT_STATE,
    WRENCH_STAMPED,
    Source,
    source_of,
)

AUTO = "auto"
LATERAL = "lateral."
"""Beginning of the names of the lateral compartment's parameters"""
FIRST_ORDER = "first_order"
"""Level of earlier versions"""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rule(AfterValidator):
    """Rule for the values of a parameter; pydantic checks it after the type."""

    words: str
    """What is allowed"""


def rule(allows: Callable[[Any], bool], words: str) -> Rule:
    """Rule that allows some values, described by `words`."""

    def check(value: Any) -> Any:
        if not allows(value):
            raise ValueError(f"allowed: {words}")
        return value

    return Rule(check, words)


def one_of(*allowed: str | float) -> Rule:
    """Rule that allows these values only."""
    return rule(allowed.__contains__, ", ".join(map(str, allowed)))


def off_or_at_least(least: float, zero: str = "off", numbers: str = "a number") -> Rule:
    """Rule that allows 0, which means `zero`, and numbers from `least` on, described by `numbers`."""
    return rule(
        lambda value: value == 0 or value >= least, f"0 ({zero}) or {numbers} >= {least:g}"
    )


class Declaration(NamedTuple):
    """Declaration of a parameter."""

    default: Any
    description: str
    least: float
    """Smallest number, itself allowed unless `words` say otherwise; -inf if there is none, or for a text"""
    most: float
    """Largest number, itself allowed unless `words` say otherwise; inf if there is none, or for a text"""
    words: str
    """Limits beyond these numbers: a list, an open end, a gap; empty if there are none"""

    @property
    def unit(self) -> str:
        """Unit with which the description begins, as `[m]`; empty if there is none."""
        return self.description[1:].partition("]")[0] if self.description.startswith("[") else ""


def declaration_of(field: FieldInfo) -> Declaration:
    """Declaration of a parameter: its limits are the rules in its annotation."""
    least, most, words = -math.inf, math.inf, []
    for rule in field.metadata:
        if isinstance(rule, Rule):
            words.append(rule.words)
        least, most = (
            getattr(rule, "ge", least),
            getattr(rule, "le", most),
        )  # the rules of annotated_types
        if hasattr(rule, "gt"):
            least = rule.gt
            words.append(f"> {least:g}")
        if hasattr(rule, "lt"):
            most = rule.lt
            words.append(f"< {most:g}")
    return Declaration(
        field.default, " ".join((field.description or "").split()), least, most, "; ".join(words)
    )


class Section(BaseModel):
    """Group of parameters; names and types are strict, numbers finite."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


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
        joints, (first, second) = self.joints(), self.inputs()
        angles, forces = len(first.fields), len(second.fields)
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
        forces, _, name = self.force_source.partition(".")
        knee: KneeSection = self.knee  # type: ignore[attr-defined]
        texts = knee.source, getattr(getattr(self, forces), name)
        return source_of(texts[0], JOINT_STATE), source_of(texts[1], WRENCH_STAMPED)

    def joints(self) -> dict[str, str]:
        """Names of the joints that the node needs, by the parameters that give them."""
        raise NotImplementedError


FRAME = "the name of a tf2 frame, without a slash before it"
FrameName = Annotated[str, rule(lambda name: not name.startswith("/") and name != "_isb", FRAME)]
"""Name of a frame, which may be empty; `_isb` is only the suffix of a tibia frame"""
# Without a type in their text, messages of a source are of the input's own type.
AngleSource = Annotated[str, Rule(lambda text: source_of(text, JOINT_STATE) and text, FORM)]
ForceSource = Annotated[str, Rule(lambda text: source_of(text, WRENCH_STAMPED) and text, FORM)]
ANGLES = "topic of the angles, of type JointState or dynamic_joint_states; for another type, one field for each joint"


class PairingSection(Section):
    """Pairing of angle and force samples by their stamps."""

    wait: float = Field(0.1, ge=0.0, le=10.0)
    """[s] how long a force waits for an angle at or after its stamp"""
    max_gap: float = Field(0.1, gt=0.0, le=3600.0)
    """[s] largest gap between stamps that is not flagged stale"""
    angle_delay: float = Field(0.0, ge=-1.0, le=1.0)
    """[s] how much later angles arrive than forces; their stamps are moved back by this"""
    queue: int = Field(20_000, ge=100, le=10**7)
    """largest number of samples of one stream that wait for the other"""


class DiagnosticsSection(Section):
    """Limits of the inputs beyond which `/diagnostics` warns or reports an error."""

    angle_warn_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] warn if the angles are slower than this; 0: off"""
    angle_error_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] report an error if the angles are slower than this; 0: off"""
    force_warn_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] warn if the forces are slower than this; 0: off"""
    force_error_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] report an error if the forces are slower than this; 0: off"""
    timeout: float = Field(1.0, gt=0.0, le=3600.0)
    """[s] an input is stale after this time without a message"""


class ContactDiagnosticsSection(DiagnosticsSection):
    """Diagnostics of the contact node, which also reports the uncertainty of force and depth due to the load."""

    load_deviation: float = Field(0.0, ge=0.0, le=10.0)
    """standard deviation of a compartment's load, as a fraction of body weight; 0: not known"""


# A section of an output names the module that describes it: see `streams/output.py`.


class RecordSection(Section):
    """Recording to MCAP."""

    output: ClassVar[str] = "knee_contact_ros.bags.recorder"

    path: str = ""
    """MCAP file to write; {stamp} in the name becomes the time; empty: do not record"""
    flush_period: float = Field(0.03, ge=0.001, le=60.0)
    """[s] period of writing to the file; a crash loses at most this much"""
    sync_period: Annotated[float, off_or_at_least(0.05)] = Field(1.0, ge=0.0, le=3600.0)
    """[s] period of syncing the disk; a power failure loses at most this much; 0: off"""
    max_size: Annotated[float, off_or_at_least(0.1)] = Field(0.0, ge=0.0, le=1e9)
    """[MB] start a new file at this size; 0: off"""
    max_duration: Annotated[float, off_or_at_least(1.0)] = Field(0.0, ge=0.0, le=1e9)
    """[s] start a new file after this span of stamps; 0: off"""
    min_free: float = Field(100.0, ge=0.0, le=1e9)
    """[MB] end the recording if the disk has less free space"""
    snapshot: float = Field(10.0, ge=0.0, le=3600.0)
    """[s] length of the snapshot that ~/save_snapshot writes, kept in memory, with at most record.queue answers and
    record.queue_size MB (30 s at 1 kHz by default); 0: off"""
    queue: int = Field(30_000, ge=100, le=10_000_000)
    """largest number of answers that wait for the process of this output"""
    queue_size: float = Field(100.0, ge=1.0, le=1e5)
    """[MB] largest memory of waiting answers"""


def _off(value: object) -> object:
    """Restore `off`, which ROS 2 parameter files read as the truth value false (YAML 1.1)."""
    return "off" if value is False else value


def _level_of_today(level: object) -> object:
    """Replace a level of earlier versions that no longer exists."""
    return _instead_of_first_order() if level == FIRST_ORDER else level


@functools.cache
def _instead_of_first_order() -> str:
    """Return the level that replaces `FIRST_ORDER`, and say so once."""
    _log.warning(
        "fidelity.level: %s no longer exists; dynamic is used instead, which is faster and more accurate",
        FIRST_ORDER,
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
    source: AngleSource = Field("joint_states", description=ANGLES)


class LoadSection(Section):
    """Part of the axial joint reaction that loads the compartment."""

    source: ForceSource = "joint_reaction_force"
    """topic of the joint reaction, of type WrenchStamped; for another type, one field for the compression, three for
    the force on the tibia (x, y, z), or six for the wrench"""
    compartment: Annotated[str, one_of(*RULES, BOTH)] = "fixed_share"
    """rule for the load of the compartment; both: model the medial and the lateral one"""
    split: Annotated[str, one_of(*SPLITS)] = "fixed_share"
    """rule for the medial load if load.compartment is both"""
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
    # The module, so that it can be pickled.
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

    level: Annotated[str, BeforeValidator(_level_of_today), one_of(*LEVELS)] = "auto"
    """equations that a tick solves; auto: dynamic"""
    tolerance: float = Field(1.0e-6, ge=1e-10, le=1e-3)
    """[m] wanted error of the penetration depth; below 1e-10 m rounding can be larger than the estimates"""
    force_tolerance: Annotated[float, off_or_at_least(1e-9)] = Field(0.0, ge=0.0, le=1e6)
    """[N] wanted error of the contact force; 0: off"""
    budget: Annotated[int, off_or_at_least(100, "a hundred thousand", "an integer")] = Field(
        BUDGET, ge=0
    )
    """largest number of contact law evaluations in a tick; a tick that reaches it gets the static contact and a
    flag, and so do later ticks until the contact has settled; 0: 100000"""


class RerunSection(Section):
    """Viewer: the scene in Rerun."""

    output: ClassVar[str] = "knee_contact_ros.view.output"

    mode: Annotated[str, BeforeValidator(_off), one_of("off", "file", "serve", "spawn")] = "off"
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

    knee: KneeSection = KneeSection()
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

    def problem(self) -> str:
        """First combination of values that is not allowed, in either compartment; see `NodeSection`."""
        by_moment = self.load.rule == "moment_balance"
        needed, why = (
            (6, "moment_balance") if by_moment else (3 if self.frame.tibia else 1, "frame.tibia")
        )
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
            *(
                (
                    bone.geometry == "profile" and not bone.profile,
                    f"{name}.profile is empty; {name}.geometry profile needs the name of a CSV file",
                )
                for name, bone in bones
            ),
            *(
                (
                    bone.geometry != "profile" and bone.scale != 1.0,
                    f"{name}.scale: {bone.scale:g} is not allowed; only {name}.geometry profile is scaled",
                )
                for name, bone in bones
            ),
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


def has_both(parameters: Parameters) -> bool:
    """Whether medial and lateral contact are computed."""
    return parameters.load.compartment == BOTH


def lateral_knee(parameters: Parameters) -> Parameters:
    """Parameters of the lateral compartment, under the names of the medial one's."""
    own = parameters.lateral
    return parameters.model_copy(
        update={"femur": own.femur, "tibia": own.tibia, "contact": own.contact}
    )


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
    source: AngleSource = Field("joint_states", description=ANGLES)


class GroundForce(Section):
    """Meaning of `ground_reaction_force`: x forward, y up, z to the right."""

    source: ForceSource = "ground_reaction_force"
    """topic of the ground force, of type WrenchStamped; for another type, one field for the upward force, three for
    the force (x, y, z), or six for the wrench"""
    components: Annotated[str, one_of("vertical", "full")] = "vertical"
    """vertical: use force.y only, as from an insole; full: use force and torque"""
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
    co_contraction: float = Field(0.39, ge=0.0, le=3.0)
    """smallest pull of antagonists, as a fraction of the vertical ground force"""
    tone: float = Field(0.27, ge=0.0, le=2.0)
    """smallest pull of antagonists, as a fraction of body weight"""
    electromechanical_delay: float = Field(0.025, ge=0.0, le=0.2)
    """[s] time constant with which muscle forces follow the demand; 0: at once"""

    @property
    def constants(self) -> Person:
        """Constants of the person for the estimator."""
        return Person(**self.model_dump())


class LoadParameters(NodeSection):
    """All parameters of the load node, `estimate-load` and `estimate_load`."""

    node = "knee_load"
    folder = "load"
    force_source, usual_forces = "ground.source", "ground_reaction_force"

    level: Annotated[str, one_of(AUTO, *LOAD_LEVELS)] = Field(
        AUTO,
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
        return allowed_levels(self)[-1] if self.level == AUTO else self.level

    def problem(self) -> str:
        """First combination of values that is not allowed; see `NodeSection`."""
        allowed = allowed_levels(self)
        joints = [
            joint.joint_name for joint in (self.knee, self.ankle, self.hip) if joint.joint_name
        ]
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
        needed, why = (
            (6, "ground.components full")
            if is_full
            else (3 if self.frame.ground else 1, "frame.ground")
        )
        return self.problem_of_sources(needed, why)


def allowed_levels(parameters: LoadParameters) -> list[str]:
    """Names of the levels that the inputs allow, in increasing order of what they use."""
    hip, ankle = bool(parameters.hip.joint_name), bool(parameters.ankle.joint_name)
    upright = parameters.ground.axes == "ground"
    allowed = ["ground_force"]
    if parameters.ground.components == "full" and (hip if upright else ankle):
        allowed += ["knee_moment", "ankle_moment"] if ankle else ["knee_moment"]
    return allowed
