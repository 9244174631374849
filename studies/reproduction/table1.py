"""Table 1 of the paper, and its consequences."""

from __future__ import annotations

from benchmarks.report import Section
from knee_contact_ros.model.laws import hertz_stiffness, relative_radius
from studies.gait import BODY_WEIGHT
from studies.reproduction.page import thousands
from studies.reproduction.scenes import ARTHRITIC, HEALTHY, MM, N_MM, parameters, static_depth

MATERIAL = (("contact.stiffness_from", "material"),)


def section() -> Section:
    """Section with every property of the table, and those that it lacks."""
    contact = parameters(ARTHRITIC).contact
    femur = parameters(HEALTHY).femur
    rows = [
        _line("K, cartilage", "2500 N/mm^1.5", "stiffness", f"{contact.stiffness:.6e} N/m^1.5", "calibrated"),
        _line("C", "5 N s/mm", "damping", f"{contact.damping:g} N s/m", ""),
        _line("n", "1.5", "exponent", f"{contact.exponent:g}", ""),
        _line("ν, cartilage", "0.38", "poissons_ratio", f"{contact.poissons_ratio:g}", "unused unless asked for"),
        _line("E, cartilage", "24 MPa", "youngs_modulus", f"{contact.youngs_modulus:.3g} Pa", "the same"),
        _line("ν, bone", "0.39", "poissons_ratio_2", f"{contact.poissons_ratio_2:g}", "the same; gives K₂"),
        _line("E, bone", "17 200 MPa", "youngs_modulus_2", f"{contact.youngs_modulus_2:.3g} Pa", "the same; gives K₂"),
        _line("K₂, bone", "not printed", "stiffness_2", f"{contact.stiffness_2:.4g} N/m^1.5",
              f"Hertz with bone's E, ν and the two radii: {thousands(bone_stiffness() * N_MM)} N/mm^1.5"),
        _line("h_s1", "0.5 mm (abstract)", "layer_depth", f"{contact.layer_depth:g} m", "not in the table"),
        _line("radii", "34 mm, 95 mm (text)", "femoral_radius, contact.tibial_radius",
              f"{contact.femoral_radius:g} m, {contact.tibial_radius:g} m", "for the stiffness; not in the table"),
        ["femur's mass M", "not printed", "`femur.mass`", f"{femur.mass:g} kg", "femur of the 75.16 kg gait2354"],
    ]  # fmt: skip
    soft = cartilage_stiffness() * N_MM
    text = (
        "The paper says that the contact parameters were derived from the materials. For bone this can be followed. "
        f"For cartilage the same formula, K = 4/3 E* √R with 1/R = 1/34 mm - 1/95 mm, gives {soft:.0f} N/mm^1.5 and "
        f"not 2500, {2500 / soft:.0f} times less: the printed value is a calibrated one. With {soft:.0f} N/mm^1.5 "
        f"the depth at 2.19 BW would be {MM * material_depth():.1f} mm, more than femur and tibia have cartilage "
        "together (4.4 mm on average in our meshes). Cartilage is a thin layer on bone, stiffer than the half-space "
        "of that formula."
    )
    return Section("2. Properties (Table 1)", text, ("property", "paper", "our parameter", "default", "note"), rows)


def bone_stiffness() -> float:
    """Stiffness of bone, K₂ [N/m^1.5]."""
    contact = parameters(ARTHRITIC).contact
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return hertz_stiffness(contact.youngs_modulus_2, contact.poissons_ratio_2, radius)


def cartilage_stiffness() -> float:
    """K [N/m^1.5] that Table 1's cartilage would have as a half-space."""
    contact = parameters(ARTHRITIC).contact
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return hertz_stiffness(contact.youngs_modulus, contact.poissons_ratio, radius)


def material_depth() -> float:
    """Static depth [m] at 2.19 BW with the stiffness of Table 1's cartilage."""
    return static_depth(2.19 * BODY_WEIGHT, HEALTHY, changes=MATERIAL)


def _line(what: str, paper: str, name: str, default: str, note: str) -> list[str]:
    return [what, paper, f"`contact.{name}`".replace(", contact.", "`, `contact."), default, note]
