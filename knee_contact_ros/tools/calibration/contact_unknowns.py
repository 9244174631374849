"""The parameters of the contact model that can be fitted."""

from __future__ import annotations

from knee_contact_ros.parameters.load_schema import LOAD_READING
from knee_contact_ros.parameters.reading import all_values, known_parameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.tools.calibration.measured import Measured
from knee_contact_ros.tools.calibration.unknowns import Fittable

SHARE = "load.share"
SECTIONS = ("femur.", "tibia.", "contact.")
RADII = ("femoral_radius", "tibial_radius")
ELASTIC = {"stiffness": ("youngs_modulus", "poissons_ratio"), "stiffness_2": ("youngs_modulus_2", "poissons_ratio_2")}
"""Parameters from which a stiffness is computed where `contact.stiffness_from` is material"""


def fittable_of(parameters: Parameters, measured: Measured) -> Fittable:
    """Give the parameters that can be fitted to a trial: real ones on which the model of the compartment depends."""
    used, known = _used_parameters(parameters, measured), known_parameters()

    def why_not(name: str) -> str:
        if name == SHARE:
            return f"{measured.source} has no column axial_load, of which it is the share"
        if name not in known and name in LOAD_READING.known():
            return f"it is one of the load node, which is fitted to a bag; to a table {', '.join(used)} are"
        if name not in known or not name.startswith(SECTIONS):
            return ""
        if not isinstance(known[name].default, float):
            return f"it is no real number; allowed are {', '.join(used)}"
        model = f"law {parameters.contact.law}, femur {parameters.femur.geometry}, tibia {parameters.tibia.geometry}"
        if parameters.contact.stiffness_from == "material":
            model += ", stiffness from material"
        return f"nothing depends on it ({model}, drive {parameters.drive}); allowed are {', '.join(used)}"

    return Fittable(used, known, all_values(parameters), "contact.stiffness", why_not)


def _used_parameters(parameters: Parameters, measured: Measured) -> list[str]:
    contact, femur, tibia = parameters.contact, parameters.femur, parameters.tibia
    names = [name for name in constants_of(contact.law) if isinstance(getattr(contact, name), float)]
    if contact.stiffness_from == "material" and "stiffness" in names:
        elastic = [name for stiffness, made_of in ELASTIC.items() if stiffness in names for name in made_of]
        names = [name for name in names if name not in (*ELASTIC, "exponent")] + [*elastic, *RADII]
    used = [f"contact.{name}" for name in dict.fromkeys(names)]
    if measured.height is None:
        used.append("femur.mass")
    used.append("femur.radius" if femur.geometry == "circle" else "femur.scale")
    used += {"plane": ["tibia.slope"], "circle": ["tibia.radius"], "profile": ["tibia.scale"]}.get(tibia.geometry, [])
    return [*used, *([SHARE] if measured.axial else [])]
