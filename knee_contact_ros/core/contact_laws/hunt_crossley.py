"""Hunt-Crossley: F = K δⁿ (1 + D δ̇/v₀) with D = 1.5 (1 - e).

Source: Hunt & Crossley 1975, doi:10.1115/1.3423596, with their e = 1 - α v₀ and D = 1.5 α v₀.
Valid for e near 1: it is the first term in 1 - e. Impacts deliver e within 0.01 for e >= 0.9, but 0.663 for e = 0.5,
and never less than 0.487 (e = 0): for losses beyond that see `flores` and `gonthier`.
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.impact_damping import impact_damped


def hunt_crossley(*, stiffness: float, exponent: float, restitution: float, least_impact_speed: float) -> ContactLaw:
    """Return the law of an elastic contact that loses a part of an impact, for small losses.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n, 1.5 for two curved solids.
        restitution: e, speed after over speed before the impact, 0 to 1.
        least_impact_speed: floor under the impact speed v₀ [m/s], > 0; see `impact_damping.py`.
    """
    loss = 1.5 * (1.0 - restitution)
    return impact_damped(stiffness, exponent, loss, least_impact_speed)
