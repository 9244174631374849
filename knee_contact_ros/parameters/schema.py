"""Declaration of all parameters of the contact node, with type, range, default and meaning.

`reading.py` reads and checks them, in the same way for the node, the commands and `load_model`.
"""

from __future__ import annotations

import functools
import inspect
import logging
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

from pydantic import AfterValidator, BeforeValidator, Field, create_model

from knee_contact_ros.model.knee import BUDGET
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.parameters.compartments import BOTH, COMPARTMENTS, SPLITS
from knee_contact_ros.parameters.limits import OffOrAtLeast, OneOf
from knee_contact_ros.parameters.sections import Diagnostics, Pairing, Record, Section, frame_name, queue, queue_size

FIRST_ORDER = "first_order"
"""Level of earlier versions"""
_log = logging.getLogger(__name__)


def _off(value: object) -> object:
    """Restore `off`, which ROS 2 parameter files read as the truth value false (YAML 1.1)."""
    return "off" if value is False else value


def _level_of_today(level: object) -> object:
    """Replace the level of earlier versions that is gone, and say so once."""
    if level != FIRST_ORDER:
        return level
    _tell_of_first_order()
    return "dynamic"


@functools.cache
def _tell_of_first_order() -> None:
    _log.warning("fidelity.level: %s is gone; dynamic is used, which takes less time for less error", FIRST_ORDER)


class Knee(Section):
    """Knee joint in the joint states; the flexion angle is flexion_sign x position + flexion_offset."""

    joint_name: str = Field("knee", min_length=1, description="joint in joint_states")
    flexion_sign: Annotated[float, OneOf(1.0, -1.0)] = Field(
        1.0, description="1 if the position grows in flexion, or -1"
    )
    flexion_offset: float = Field(0.0, ge=-10.0, le=10.0, description="[rad] added to the signed position")
    height_joint_name: str = Field(
        "knee_height", min_length=1, description="drive displacement: joint whose position is the femoral height [m]"
    )
    source: Annotated[str, OneOf("joint_states", "dynamic_joint_states")] = Field(
        "joint_states", description="topic of the angles: sensor_msgs/JointState or control_msgs/DynamicJointState"
    )


class Load(Section):
    """Part of the axial joint reaction that loads the compartment."""

    compartment: Annotated[str, OneOf(*COMPARTMENTS, BOTH)] = Field(
        "fixed_share", description=", ".join((*COMPARTMENTS, BOTH))
    )
    split: Annotated[str, OneOf(*SPLITS)] = Field(
        "fixed_share", description=f"compartment both: what the medial one gets, {' or '.join(SPLITS)}"
    )
    share: float = Field(0.5, gt=0.0, le=1.0, description="medial share of the axial joint reaction; fixed_share")
    share_file: str = Field(
        "share_medial.csv", description="CSV of flexion_angle [rad], axial_load [BW], medial_share; measured_share"
    )
    compartment_spacing: float = Field(
        0.04, ge=0.005, le=0.2, description="[m] from the medial to the lateral compartment; moment_balance, both"
    )

    @property
    def rule(self) -> str:
        """Name of the rule in `COMPARTMENTS` for the load of the medial (or only) compartment."""
        return self.split if self.compartment == BOTH else self.compartment


class Frame(Section):
    """Frame of the messages."""

    tibia: Annotated[str, AfterValidator(frame_name)] = Field(
        "",
        description="tibia frame (x anterior, y superior, z right) that forces are turned into; empty: as they come",
    )


class Femur(Section):
    """Mass and contact surface of the femur."""

    mass: float = Field(9.3014, ge=1e-4, le=1e3, description="[kg] that follows the reference point")
    geometry: Annotated[str, OneOf(*GEOMETRIES)] = Field("circle", description=" or ".join(GEOMETRIES))
    radius: float = Field(0.034, gt=0.0, le=1.0, description="[m] of the circle")
    profile: str = Field("", description="CSV of x, y [m] in the femur frame, ordered along the curve")
    scale: float = Field(1.0, ge=0.1, le=10.0, description="of the profile's points")


class Tibia(Section):
    """Contact surface of the tibia, the plateau."""

    geometry: Annotated[str, OneOf(*TIBIAL_GEOMETRIES)] = Field("plane", description=" or ".join(TIBIAL_GEOMETRIES))
    slope: float = Field(
        0.0, ge=-0.7, le=0.7, description="[rad] of the plane, > 0 when the anterior edge is the higher one"
    )
    radius: float = Field(0.095, gt=0.0, le=10.0, description="[m] of the concave circle")
    profile: str = Field("", description="CSV of x, y [m] in the tibia frame, from posterior to anterior")
    scale: float = Field(1.0, ge=0.1, le=10.0, description="of the profile's points")


class Translation(Section):
    """Anterior-posterior translation of the femur."""

    mechanism: Annotated[str, OneOf(*MECHANISMS)] = Field("hinge", description=", ".join(MECHANISMS))
    table: str = Field("", description="CSV of flexion_angle [rad], x [m] of the femoral reference point")


class CommonContactParameters(Section):
    """Contact law, and the constants that several laws have or that other parameters depend on.

    Further arguments of a law's factory are parameters, too; see `with_constants_of_laws`.
    """

    law: Annotated[str, OneOf(*CONTACT_LAWS)] = Field("kelvin_voigt", description=", ".join(CONTACT_LAWS))
    stiffness: float = Field(7.905694e7, ge=1.0, le=1e15, description="[N/m^exponent] of the first layer")
    exponent: float = Field(1.5, ge=1.0, le=3.0, description="of the depth; 1.5 for two curved solids")
    damping: float = Field(5000.0, ge=0.0, le=1e9, description="[N s/m]")
    allow_tension: bool = Field(False, description="let the law pull instead of clamping it at 0")
    layer_depth: float = Field(5.0e-4, gt=0.0, le=0.1, description="[m] at which the second layer begins")
    stiffness_2: float = Field(3.112e9, ge=1.0, le=1e15, description="[N/m^exponent] of the second layer")
    damp_first_layer: bool = Field(False, description="two_layer_viscoelastic: put the dashpot into both layers")
    restitution: float = Field(0.5, ge=0.01, le=1.0, description="asked for; laws with impact damping")
    least_impact_speed: float = Field(
        0.1, ge=1e-6, le=100.0, description="[m/s] that slower touches, and the static start, count as"
    )
    stiffness_from: Annotated[str, OneOf("value", "material")] = Field(
        "value", description="value, or material: Hertz from modulus, Poisson's ratio and radii (exponent 1.5)"
    )
    youngs_modulus: float = Field(24e6, ge=1.0, le=1e13, description="[Pa] of cartilage (first layer)")
    poissons_ratio: float = Field(0.38, ge=0.0, lt=0.5, description="of cartilage (first layer)")
    youngs_modulus_2: float = Field(17.2e9, ge=1.0, le=1e13, description="[Pa] of bone (second layer)")
    poissons_ratio_2: float = Field(0.39, ge=0.0, lt=0.5, description="of bone (second layer)")
    femoral_radius: float = Field(0.034, gt=0.0, le=10.0, description="[m] convex, for stiffness and patch")
    tibial_radius: float = Field(0.095, gt=0.0, le=10.0, description="[m] concave, for stiffness and patch")
    foundation_thickness: float = Field(
        4.4e-3, gt=0.0, le=0.1, description="[m] of both cartilages; elastic_foundation, strain"
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
        for name, parameter in inspect.signature(factory).parameters.items():
            if name not in CommonContactParameters.model_fields:
                (limits,) = types[name].__metadata__
                field = Field(parameter.default, ge=limits.least, le=limits.most, description=limits.meaning)
                more[name] = (types[name].__origin__, field)
    # The module, so that it can be pickled.
    return create_model("ContactParameters", __base__=CommonContactParameters, __module__=__name__, **more)


if TYPE_CHECKING:
    ContactParameters = CommonContactParameters
else:
    ContactParameters = with_constants_of_laws(CONTACT_LAWS)


class Lateral(Section):
    """Lateral compartment, where both are modelled; values that are not given equal those of the medial one."""

    femur: Femur = Femur()
    tibia: Tibia = Tibia()
    contact: ContactParameters = ContactParameters()


class FidelityParameters(Section):
    """Level and accuracy of the solution, and its largest cost."""

    level: Annotated[str, BeforeValidator(_level_of_today), OneOf(*LEVELS)] = Field(
        "auto", description=", ".join(LEVELS) + " (which is dynamic)"
    )
    tolerance: float = Field(1.0e-6, ge=1e-12, le=1e-3, description="[m] wanted error of the penetration depth")
    force_tolerance: Annotated[float, OffOrAtLeast(1e-9)] = Field(
        0.0, le=1e6, description="[N] wanted error of the contact force; 0: off"
    )
    budget: Annotated[int, OffOrAtLeast(100, "a hundred thousand", "an integer")] = Field(
        BUDGET,
        description="largest number of contact law evaluations in a tick; a tick that reaches it is answered with the "
        "static contact and flagged, and so are later ones until the contact has forgotten; 0: a hundred thousand",
    )


class Rerun(Section):
    """Viewer: the scene in Rerun."""

    output: ClassVar[str] = "knee_contact_ros.view.output"

    mode: Annotated[str, BeforeValidator(_off), OneOf("off", "file", "serve", "spawn")] = Field(
        "off", description="off, file, serve (on this machine's loopback interface), spawn (a viewer beside it)"
    )
    path: str = Field("", description=".rrd file to write in mode file, likewise")
    port: int = Field(9876, ge=1024, le=65535, description="to serve on")
    knees: str = Field(
        "", description="names of the knees that share a viewer side by side, as left,right; empty: this knee alone"
    )
    queue: int = queue(20_000)
    queue_size: float = queue_size(64.0)


class Parameters(Section):
    """All parameters of the contact node and of the offline commands."""

    knee: Knee = Knee()
    load: Load = Load()
    frame: Frame = Frame()
    pairing: Pairing = Pairing()
    drive: Annotated[str, OneOf("force", "displacement")] = Field(
        "force", description="force: Eq. 13; displacement: the femoral height is prescribed, the force follows"
    )
    femur: Femur = Femur()
    tibia: Tibia = Tibia()
    translation: Translation = Translation()
    contact: ContactParameters = ContactParameters()
    lateral: Lateral = Lateral()
    fidelity: FidelityParameters = FidelityParameters()
    body_weight: float = Field(737.068, gt=0.0, le=1e5, description="[N] for reports in body weights")
    autostart: bool = Field(True, description="configure and activate without being asked")
    deadline: float = Field(
        0.02, gt=0.0, le=3600.0, description="[s] from a force to its answer; later ones are counted"
    )
    diagnostics: Diagnostics = Diagnostics()
    record: Record = Record()
    rerun: Rerun = Rerun()
