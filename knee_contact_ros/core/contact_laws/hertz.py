"""Hertz: F = K δⁿ (Eq. 8 of the paper with C = 0).

Source: Hertz 1882, doi:10.1515/crll.1882.92.156. Valid for small, frictionless contacts of elastic solids.
Nothing damps the knee under this law: it rings about its equilibrium for good.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law


class HertzFormula(NamedTuple):
    """Formula of an elastic layer: F = K δⁿ."""

    stiffness: float
    """Stiffness K [N/mⁿ]"""
    exponent: float
    """Exponent n [-]"""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Return force [N] and slopes [N/m], [N s/m]; see `LayerFormula.force_at`."""
        elastic, slope = power_law(self.stiffness, self.exponent, depth)
        return elastic, slope, 0.0

    def remembers_impact(self) -> bool:
        """Return False: the force does not depend on the impact speed."""
        return False


def hertz(*, stiffness: float, exponent: float) -> ContactLaw:
    """Return the law of an elastic contact: `stiffness` K [N/mⁿ], `exponent` n (1.5 for two curved solids)."""
    return ContactLaw((Layer(0.0, HertzFormula(stiffness, exponent)),))
