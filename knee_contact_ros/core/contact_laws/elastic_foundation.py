"""Elastic foundation: a bed of independent springs on rigid bone (Winkler), pressed by a sphere: F = π (M/t) R δ².

The pressure at each point is p = M u/t, u being the local penetration and t the thickness of the cartilage; where a
sphere of radius R is δ deep, u = δ - r²/(2R). M = E (1 - ν) / ((1 + ν) (1 - 2ν)) is the modulus of a layer that is
bonded to bone and cannot spread sideways.

Source: Johnson 1985, Contact Mechanics, Sec. 4.3; for the knee Blankevoort et al. 1991,
doi:10.1016/0021-9290(91)90019-J. Valid for δ << t (small strain; beyond, the true force is the larger one), for a
contact radius √(2 R δ) that is large against t, and for a compressible layer: towards ν = 0.5 M grows without bound,
whereas cartilage gives way sideways and neighbouring points are no longer independent. Nothing damps the knee.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.hertz import hertz
from knee_contact_ros.core.contact_laws.material import relative_radius


def elastic_foundation(
    *,
    youngs_modulus: float,
    poissons_ratio: float,
    foundation_thickness: float,
    femoral_radius: float,
    tibial_radius: float,
) -> ContactLaw:
    """Return the law of an elastic contact of thin cartilage on bone: a power law of exponent 2.

    Args:
        youngs_modulus: E of the cartilage [Pa].
        poissons_ratio: ν of the cartilage, below 0.5.
        foundation_thickness: t [m], femoral and tibial cartilage together.
        femoral_radius: of the convex femur [m].
        tibial_radius: of the concave tibia [m], above the femoral one; infinite for a flat plateau.

    Raises:
        ValueError: see `relative_radius`.
    """
    modulus = youngs_modulus * (1.0 - poissons_ratio) / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))
    radius = relative_radius(femoral_radius, tibial_radius)
    bed = hertz(stiffness=math.pi * modulus / foundation_thickness * radius, exponent=2.0)
    return ContactLaw(bed.layers, foundation_thickness)
