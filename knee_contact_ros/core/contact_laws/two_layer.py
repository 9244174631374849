"""Cartilage on bone (Eqs. 11 and 12 of the paper): K₁ δⁿ up to the layer depth h, then K₁ hⁿ + K₂ (δ - h)ⁿ.

The stiffness jumps at h. Eq. 12 as printed damps the second layer only, so the force also jumps by C δ̇ at h, and
nothing damps the knee above it: it rings there. `damp_first_layer` puts the same dashpot into both layers.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law


class SpringAndDashpot(NamedTuple):
    """Formula of a layer below others: F = F₀ + K (δ - h)ⁿ + C δ̇."""

    begin: float
    """Depth h [m] at which the layer begins"""
    base_force: float
    """Force F₀ [N] of the layers above at h"""
    stiffness: float
    """Stiffness K of this layer [N/mⁿ]"""
    exponent: float
    """Exponent n [-]"""
    damping: float
    """Damping C [N s/m]"""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Return force [N] and slopes [N/m], [N s/m]; see `LayerFormula.force_at`."""
        elastic, slope = power_law(self.stiffness, self.exponent, depth - self.begin)
        return self.base_force + elastic + self.damping * rate, slope, self.damping

    def remembers_impact(self) -> bool:
        """Return False: the force does not depend on the impact speed."""
        return False


def two_layer_elastic(*, stiffness: float, exponent: float, layer_depth: float, stiffness_2: float) -> ContactLaw:
    """The law of two elastic layers (Eq. 11): `stiffness` K₁ and `stiffness_2` K₂ [N/mⁿ], `layer_depth` h [m]."""
    return two_layer_viscoelastic(
        stiffness=stiffness,
        exponent=exponent,
        damping=0.0,
        layer_depth=layer_depth,
        stiffness_2=stiffness_2,
        damp_first_layer=False,
    )


def two_layer_viscoelastic(
    *,
    stiffness: float,
    exponent: float,
    damping: float,
    layer_depth: float,
    stiffness_2: float,
    damp_first_layer: bool,
) -> ContactLaw:
    """Return the law of two layers with a dashpot of `damping` C [N s/m] in the second one (Eq. 12).

    With `damp_first_layer` it is in both. The other arguments are those of `two_layer_elastic`.
    """
    force_at_layer, _ = power_law(stiffness, exponent, layer_depth)
    first_damping = damping if damp_first_layer else 0.0
    cartilage = SpringAndDashpot(
        begin=0.0, base_force=0.0, stiffness=stiffness, exponent=exponent, damping=first_damping,
    )  # fmt: skip
    bone = SpringAndDashpot(
        begin=layer_depth, base_force=force_at_layer, stiffness=stiffness_2, exponent=exponent, damping=damping,
    )  # fmt: skip
    return ContactLaw((Layer(0.0, cartilage), Layer(layer_depth, bone)))
