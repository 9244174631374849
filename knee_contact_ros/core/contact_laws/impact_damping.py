"""Damping that remembers the impact: F = K δⁿ (1 + (χ/K) δ̇) with χ/K = D/v₀, v₀ being the speed of first touch.

The laws that use it differ only in the loss number D(e), e being the wanted coefficient of restitution. The
force starts at 0 at first touch. What a free impact delivers depends on D alone, and not on n, K, the mass or v₀: it is
the root e' of (1 + e') D = ln((1 + D) / (1 - e' D)).

`least_impact_speed` is a floor under v₀, and the v₀ of contacts that did not begin with an impact (the static start).
Without it D/v₀ grows without bound for soft touches: such a knee would be all but rigid, for where the force ends its
surfaces part at v₀/D, and no faster. Below the floor an impact loses less than e asks for.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law


class ImpactDamped(NamedTuple):
    """Formula of a layer whose damping depends on the impact speed: F = K δⁿ (1 + D δ̇/v₀)."""

    stiffness: float
    """Stiffness K [N/mⁿ]"""
    exponent: float
    """Exponent n [-]"""
    loss: float
    """Loss number D [-]"""
    least_impact_speed: float
    """Floor under v₀ [m/s]"""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Return force [N] and slopes [N/m], [N s/m]; see `LayerFormula.force_at`."""
        loss_over_speed = self.loss / max(impact_speed, self.least_impact_speed)
        elastic, slope = power_law(self.stiffness, self.exponent, depth)
        factor = 1.0 + loss_over_speed * rate
        return elastic * factor, slope * factor, elastic * loss_over_speed

    def remembers_impact(self) -> bool:
        """Return True: the force depends on the impact speed."""
        return True


def impact_damped(stiffness: float, exponent: float, loss: float, least_impact_speed: float) -> ContactLaw:
    """Return the law F = K δⁿ (1 + D δ̇/v₀), positive in compression.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n >= 1.
        loss: D >= 0.
        least_impact_speed: the smallest v₀ [m/s], > 0.
    """
    return ContactLaw((Layer(0.0, ImpactDamped(stiffness, exponent, loss, least_impact_speed)),))
