"""The contact laws in the terms of the solver, written down from their sources once more."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple


class Law(NamedTuple):
    """K δⁿ (1 + D δ̇/v₀) + C δ̇ in one layer (D or C is 0), or K δⁿ + C δ̇ in each of two."""

    stiffness: tuple[float, float]
    """K [N/mⁿ] of each layer; the second counts only where there is one"""
    exponent: tuple[float, float]
    """n"""
    damping: tuple[float, float]
    """C [N s/m]"""
    layer_depth: float = -1.0
    """Where the second layer begins [m]; < 0: there is one layer"""
    loss: float = 0.0
    """D"""
    least_impact_speed: float = 1.0
    """Floor under v₀ [m/s]"""


def spring_and_dashpot(*, stiffness: float, exponent: float, damping: float = 0.0) -> Law:
    """Hertz 1882 without the dashpot, Kelvin-Voigt with it (Eqs. 8 and 10 of the paper)."""
    return Law((stiffness, 0.0), (exponent, 1.0), (damping, 0.0))


def two_layers(
    *,
    stiffness: float,
    exponent: float,
    layer_depth: float,
    stiffness_2: float,
    damping: float = 0.0,
    damp_first_layer: bool = False,
) -> Law:
    """Eqs. 11 and 12 of the paper: the second layer adds its force to what the first one carries where it ends."""
    first = damping if damp_first_layer else 0.0
    return Law((stiffness, stiffness_2), (exponent, exponent), (first, damping), layer_depth)


def elastic_foundation(
    *,
    youngs_modulus: float,
    poissons_ratio: float,
    foundation_thickness: float,
    femoral_radius: float,
    tibial_radius: float,
) -> Law:
    """Johnson 1985, Sec. 4.3: springs of modulus M/t under a paraboloid, integrated over the contact: π R (M/t) δ²."""
    lame = (
        youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))
    )
    shear = 0.5 * youngs_modulus / (1.0 + poissons_ratio)
    confined = lame + 2.0 * shear
    radius = femoral_radius / (1.0 - femoral_radius / tibial_radius)
    return spring_and_dashpot(
        stiffness=math.pi * radius * confined / foundation_thickness, exponent=2.0
    )


def remembering(loss: Callable[[float], float]) -> Callable[..., Law]:
    """The laws whose damping is D/v₀, from D as a function of the coefficient of restitution e."""

    def law(
        *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
    ) -> Law:
        one = spring_and_dashpot(stiffness=stiffness, exponent=exponent)
        return one._replace(loss=loss(restitution), least_impact_speed=least_impact_speed)

    return law


LAWS: dict[str, Callable[..., Law]] = {
    "hertz": spring_and_dashpot,
    "kelvin_voigt": spring_and_dashpot,
    "two_layer_elastic": two_layers,
    "two_layer_viscoelastic": two_layers,
    "hunt_crossley": remembering(lambda e: 3.0 * (1.0 - e) / 2.0),
    "lankarani_nikravesh": remembering(lambda e: 3.0 * (1.0 - e * e) / 4.0),
    "flores": remembering(lambda e: 1.6 * (1.0 / e - 1.0)),
    "gonthier": remembering(lambda e: 1.0 / e - e),
    "elastic_foundation": elastic_foundation,
}
"""Contact laws by the model's names, with the model's arguments"""
