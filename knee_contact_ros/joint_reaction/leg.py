"""Lengths, masses and inertias of a leg from the mass and the height of a person.

Proportions: Winter (2009), Biomechanics and Motor Control of Human Movement, 4th ed., figure 4.1 and table 4.1
(doi:10.1002/9780470549148): lengths as parts of the height, masses as parts of the body's, the rest as parts of the
segment's length. Of one person they may be off by a tenth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

GRAVITY = 9.80665
"""[m/s^2]"""
THIGH_LENGTH, SHANK_LENGTH, FOOT_LENGTH, ANKLE_HEIGHT = 0.245, 0.246, 0.152, 0.039
"""Of the height"""
SHANK_MASS, FOOT_MASS = 0.0465, 0.0145
"""Of the body's"""
SHANK_CENTRE, SHANK_GYRATION, FOOT_GYRATION = 0.433, 0.302, 0.475
"""Centre of mass from the knee, and radii of gyration about the centre; of the segment's length. The
foot's is that from the ankle to the head of the second metatarsal."""
KNEE_OFFSET = 0.008
"""Of the height, by which the knee lies lateral of the ankle in stance: 13.7 and 15.3 mm on average in both legs of the
gait2354 model as its trial walks (1.80 m); with it the frontal moment is 3 to 4 N m off there, and 8 to 9 without"""
FOOT_CENTRE = 0.5
"""Of the way from the ankle to the head of the second metatarsal, on the ground half a foot's length ahead"""


class Leg(NamedTuple):
    """Thigh, shank and foot."""

    thigh_length: float
    """[m]"""
    shank_length: float
    """[m] from knee to ankle"""
    knee_offset: float
    """[m] from ankle to knee, laterally"""
    shank_mass: float
    """[kg]"""
    shank_centre: float
    """[m] of its mass, from the knee"""
    shank_inertia: float
    """[kg m^2] about that"""
    foot_mass: float
    """[kg]"""
    foot_forward: float
    """[m] from the ankle to the centre of its mass, along the sole"""
    foot_below: float
    """[m] likewise, towards the sole"""
    foot_inertia: float
    """[kg m^2] about that"""


def leg_of(mass: float, height: float) -> Leg:
    """The leg of a person of a mass [kg] and a height [m]."""
    shank, shank_mass, foot_mass = SHANK_LENGTH * height, SHANK_MASS * mass, FOOT_MASS * mass
    forward, below = 0.5 * FOOT_LENGTH * height, ANKLE_HEIGHT * height
    return Leg(
        THIGH_LENGTH * height, shank, KNEE_OFFSET * height,
        shank_mass, SHANK_CENTRE * shank, shank_mass * (SHANK_GYRATION * shank) ** 2,
        foot_mass, FOOT_CENTRE * forward, FOOT_CENTRE * below,
        foot_mass * (FOOT_GYRATION * math.hypot(forward, below)) ** 2,
    )  # fmt: skip
