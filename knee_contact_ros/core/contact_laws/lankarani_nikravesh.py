"""Lankarani-Nikravesh: F = K δⁿ (1 + D δ̇/v₀) with D = 0.75 (1 - e²).

Source: Lankarani & Nikravesh 1990, doi:10.1115/1.2912617, from the energy that an impact loses.
Valid for e near 1, where the depth during the impact is nearly that without damping. Impacts deliver e within 0.01 for
e >= 0.92, but 0.725 for e = 0.5, and never less than 0.663 (e = 0): for larger losses see `flores` and `gonthier`.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.impact_damping import impact_damped


def lankarani_nikravesh(
    *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
) -> ContactLaw:
    """Return the law of an elastic contact that loses a part of an impact, for small losses.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n, 1.5 for two curved solids.
        restitution: e, speed after over speed before the impact, 0 to 1.
        least_impact_speed: floor under the impact speed v₀ [m/s], > 0; see `impact_damping.py`.
    """
    loss = 0.75 * (1.0 - restitution**2)
    return impact_damped(stiffness, exponent, loss, least_impact_speed)
