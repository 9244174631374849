"""Kelvin-Voigt: F = K δⁿ + C δ̇ (Eqs. 8 and 10 of the paper).

The force jumps by C δ̇ at first touch, and it would pull shortly before separation; cartilage cannot pull, so the
integrator clamps the force at 0 unless tension is allowed.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw, Layer, power_law


def kelvin_voigt(*, stiffness: float, exponent: float, damping: float) -> ContactLaw:
    """Spring and dashpot in parallel. `stiffness` K [N/mⁿ], `exponent` n, `damping` C [N s/m]."""

    def force(depth: float, rate: float) -> tuple[float, float, float]:
        elastic, slope = power_law(stiffness, exponent, depth)
        return elastic + damping * rate, slope, damping

    return ContactLaw((Layer(0.0, force),))
