"""Cartilage on bone (Eqs. 11 and 12 of the paper): K₁ δⁿ up to the layer depth h, then K₁ hⁿ + K₂ (δ - h)ⁿ.

The stiffness jumps at h. Eq. 12 as printed damps the second layer only, so the force also jumps by C δ̇ at h, and
nothing damps the knee above it: it rings there. `damp_first_layer` puts the same dashpot into both layers.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, LayerForce, power_law


def two_layer_elastic(*, stiffness: float, exponent: float, layer_depth: float, stiffness_2: float) -> ContactLaw:
    """Two springs in layers (Eq. 11). `stiffness` K₁ and `stiffness_2` K₂ [N/mⁿ], `layer_depth` h [m]."""
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
    """Two layers with a dashpot C [N s/m] in the second (Eq. 12) or, with `damp_first_layer`, in both."""
    force_at_layer, _ = power_law(stiffness, exponent, layer_depth)

    def layer(begin: float, base_force: float, layer_stiffness: float, layer_damping: float) -> LayerForce:
        def force(depth: float, rate: float) -> tuple[float, float, float]:
            elastic, slope = power_law(layer_stiffness, exponent, depth - begin)
            return base_force + elastic + layer_damping * rate, slope, layer_damping

        return force

    first_damping = damping if damp_first_layer else 0.0
    return ContactLaw(
        (
            Layer(0.0, layer(0.0, 0.0, stiffness, first_damping)),
            Layer(layer_depth, layer(layer_depth, force_at_layer, stiffness_2, damping)),
        )
    )
