"""Flores et al.: F = K δⁿ (1 + D δ̇/v₀) with D = 8 (1 - e) / (5 e).

Source: Flores, Machado, Silva & Martins 2011, doi:10.1007/s11044-010-9237-4, made for soft materials.
Valid for all e > 0, and approximate: impacts deliver e within 0.05 (0.470 for e = 0.5), within 0.01 for e >= 0.83; too
little everywhere, and 5/8 of e where e nears 0. `gonthier` is the better one for e below 0.6.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.impact_damping import impact_damped


def flores(*, stiffness: float, exponent: float, restitution: float, least_impact_speed: float) -> ContactLaw:
    """Return the law of an elastic contact that loses a part of an impact, for soft materials and large losses.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n, 1.5 for two curved solids.
        restitution: e, speed after over speed before the impact, above 0 and up to 1.
        least_impact_speed: floor under the impact speed v₀ [m/s], > 0; see `impact_damping.py`.
    """
    loss = 8.0 * (1.0 - restitution) / (5.0 * restitution)
    return impact_damped(stiffness, exponent, loss, least_impact_speed)
