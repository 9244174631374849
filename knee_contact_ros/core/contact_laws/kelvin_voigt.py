"""Kelvin-Voigt: F = K δⁿ + C δ̇ (Eqs. 8 and 10 of the paper).

The force jumps by C δ̇ at first touch, and it would pull shortly before separation; cartilage cannot pull, so the
integrator clamps the force at 0 unless tension is allowed.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law


class KelvinVoigtFormula(NamedTuple):
    """Formula of a spring and a dashpot in parallel: F = K δⁿ + C δ̇."""

    stiffness: float
    """Stiffness K [N/mⁿ]"""
    exponent: float
    """Exponent n [-]"""
    damping: float
    """Damping C [N s/m]"""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Return force [N] and slopes [N/m], [N s/m]; see `LayerFormula.force_at`."""
        elastic, slope = power_law(self.stiffness, self.exponent, depth)
        return elastic + self.damping * rate, slope, self.damping

    def remembers_impact(self) -> bool:
        """Return False: the force does not depend on the impact speed."""
        return False


def kelvin_voigt(*, stiffness: float, exponent: float, damping: float) -> ContactLaw:
    """Return the law of a spring and a dashpot in parallel: `stiffness` K [N/mⁿ], `exponent` n, `damping` C [N s/m]."""
    return ContactLaw((Layer(0.0, KelvinVoigtFormula(stiffness, exponent, damping)),))
