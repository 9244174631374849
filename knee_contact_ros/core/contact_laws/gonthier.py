"""Gonthier et al.: F = K δⁿ (1 + D δ̇/v₀) with D = (1 - e²) / e.

Source: Gonthier, McPhee, Lange & Piedbœuf 2004, doi:10.1023/B:MUBO.0000029392.21648.bc: a short formula for the D that
solves the equation of the delivered e (`impact_damping.py`).
Valid for all e > 0, and approximate: impacts deliver e within 0.033 (0.488 for e = 0.5), exactly e where e nears 0, and
lose a third too much where e nears 1: there use `flores` (e above 0.6) or `hunt_crossley` (e above 0.9).
"""

from __future__ import annotations

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_laws.impact_damping import impact_damped


def gonthier(*, stiffness: float, exponent: float, restitution: float, least_impact_speed: float) -> ContactLaw:
    """Return the law of an elastic contact that loses a part of an impact, for large losses.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n, 1.5 for two curved solids.
        restitution: e, speed after over speed before the impact, above 0 and up to 1.
        least_impact_speed: floor under the impact speed v₀ [m/s], > 0; see `impact_damping.py`.
    """
    loss = (1.0 - restitution**2) / restitution
    return impact_damped(stiffness, exponent, loss, least_impact_speed)
