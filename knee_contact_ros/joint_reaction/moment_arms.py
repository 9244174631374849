"""Moment arms of the muscles that cross the knee, as functions of flexion.

Polynomials [m] of angles [rad], fitted to the musculoskeletal model gait2354 (Delp et al. 1990, doi:10.1109/10.102791;
knee: Yamaguchi & Zajac 1989, doi:10.1016/0021-9290(89)90179-6) from -10 to 110 degrees of flexion, -30 to 25 degrees of
dorsiflexion: each group's muscles weighted by their maximum isometric forces. They are off that model's by 1.1, 0.2,
0.7 and 0.1 mm RMS; `python -m studies.moment_arms MODEL` makes them again. People differ by a tenth and more.
"""

from __future__ import annotations

LEAST_FLEXION, MOST_FLEXION = -0.1745, 1.9199
"""[rad] beyond which the arms are those of here"""
LEAST_DORSIFLEXION, MOST_DORSIFLEXION = -0.5236, 0.4363
"""[rad] likewise"""
QUADRICEPS = (0.04463, 0.01629, -0.03135, 0.00889)
"""Rectus femoris and vasti, by the patellar tendon; extends"""
HAMSTRINGS = (0.02616, 0.02728, -0.02370, 0.00214)
"""Long and short heads of the hamstrings; flexes"""
GASTROCNEMIUS = (0.02220, 0.00004, -0.00539, 0.00123)
"""Flexes the knee"""
ACHILLES = (0.04573, -0.01311, -0.02042)
"""Gastrocnemius and soleus at the ankle, by dorsiflexion; plantarflexes"""
GASTROCNEMIUS_SHARE = 0.342
"""Of the plantarflexion moment: its maximum isometric force times its arm, by those of gastrocnemius, soleus and
tibialis posterior (2500, 4000 and 3600 N at 46, 45 and 11 mm in gait2354)"""


def arm(coefficients: tuple[float, ...], angle: float) -> float:
    """A moment arm [m] of a muscle that crosses the knee, at a flexion [rad], or of `ACHILLES` at a dorsiflexion."""
    least, most = (LEAST_DORSIFLEXION, MOST_DORSIFLEXION) if coefficients is ACHILLES else (LEAST_FLEXION, MOST_FLEXION)
    within, value = min(max(angle, least), most), 0.0
    for coefficient in reversed(coefficients):
        value = value * within + coefficient
    return value
