"""Stiffness of a contact from its materials and radii."""

from __future__ import annotations

import math


def relative_radius(femoral_radius: float, tibial_radius: float) -> float:
    """Return the relative radius R [m] of a convex femur on a concave tibia: 1/R = 1/r_F - 1/r_T.

    A sphere of radius R on a plane has the same gap near the contact.

    Both radii [m] are > 0. A tibial radius of infinity is a flat plateau.

    Raises:
        ValueError: the tibial radius does not exceed the femoral one, so that the femur does not fit into the tibia.
    """
    if not 0.0 < femoral_radius < tibial_radius:
        raise ValueError(
            f"0 < femoral radius < tibial radius (concave) is needed, got {femoral_radius:g} m and {tibial_radius:g} m"
        )
    return 1.0 / (1.0 / femoral_radius - 1.0 / tibial_radius)


def hertz_stiffness(youngs_modulus: float, poissons_ratio: float, relative_radius: float) -> float:
    """Return the stiffness K [N/m^1.5] of Hertz' law: K = 4/3 E* √R, E* = E / (2 (1 - ν²)) for bodies of one material.

    Source: Hertz 1882; Johnson 1985, Contact Mechanics, Eq. 4.23. Valid for solids that are thick against the contact
    radius √(R δ), itself small against R.

    The paper's bone (17.2 GPa, 0.39, radii 34 and 95 mm) gives its second layer: 3.112e9 N/m^1.5 = 98 408 N/mm^1.5. Its
    cartilage (24 MPa, 0.38) gives 4.30e6 N/m^1.5 = 136 N/mm^1.5, and not the 2500 of Table 1, which are calibrated:
    cartilage is a thin layer on bone, hence stiffer than the half-space of this formula.

    Args:
        youngs_modulus: E [Pa].
        poissons_ratio: ν, 0 to 0.5.
        relative_radius: R [m], see `relative_radius`.
    """
    plane_modulus = youngs_modulus / (2.0 * (1.0 - poissons_ratio**2))
    return 4.0 / 3.0 * plane_modulus * math.sqrt(relative_radius)
