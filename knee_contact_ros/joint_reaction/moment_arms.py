"""Moment arms of the muscles that cross the knee, as functions of flexion.

Polynomials [m] of angles [rad], fitted to the musculoskeletal model gait2354 (Delp et al. 1990, doi:10.1109/10.102791;
knee: Yamaguchi & Zajac 1989, doi:10.1016/0021-9290(89)90179-6) from -10 to 110 degrees of flexion and -30 to 25 degrees
of dorsiflexion; the muscles of a group are weighted by their maximum isometric forces. RMS errors of the fit: 1.1, 0.2,
0.7 and 0.1 mm; `python -m studies.moment_arms MODEL` repeats it. People differ by a tenth and more.
"""

from __future__ import annotations

LEAST_FLEXION, MOST_FLEXION = -0.1745, 1.9199
"""Range of flexion [rad] beyond which the moment arms stay constant"""
LEAST_DORSIFLEXION, MOST_DORSIFLEXION = -0.5236, 0.4363
"""Range of dorsiflexion [rad] beyond which the moment arm of the Achilles tendon stays constant"""
QUADRICEPS = (0.04463, 0.01629, -0.03135, 0.00889)
"""Rectus femoris and vasti, through the patellar tendon; they extend the knee"""
HAMSTRINGS = (0.02616, 0.02728, -0.02370, 0.00214)
"""Long and short heads of the hamstrings; they flex the knee"""
GASTROCNEMIUS = (0.02220, 0.00004, -0.00539, 0.00123)
"""Gastrocnemius at the knee, which it flexes"""
ACHILLES = (0.04573, -0.01311, -0.02042)
"""Gastrocnemius and soleus at the ankle, as a function of dorsiflexion; they plantarflex it"""
GASTROCNEMIUS_SHARE = 0.342
"""Share of the gastrocnemius in the plantarflexion moment: maximum isometric force times moment arm, relative to the
sum over gastrocnemius, soleus and tibialis posterior (2500, 4000 and 3600 N at 46, 45 and 11 mm in gait2354)"""


def arm(coefficients: tuple[float, ...], angle: float) -> float:
    """Give a muscle's moment arm [m] at the knee at a flexion [rad]; that of `ACHILLES` at a dorsiflexion [rad]."""
    least, most = (LEAST_DORSIFLEXION, MOST_DORSIFLEXION) if coefficients is ACHILLES else (LEAST_FLEXION, MOST_FLEXION)
    within, value = min(max(angle, least), most), 0.0
    for coefficient in reversed(coefficients):
        value = value * within + coefficient
    return value
