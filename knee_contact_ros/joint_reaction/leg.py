"""Lengths, masses and inertias of a leg from the mass and the height of a person.

Proportions: Winter (2009), Biomechanics and Motor Control of Human Movement, 4th ed., figure 4.1 and table 4.1
(doi:10.1002/9780470549148): lengths relative to the height, masses to the body's mass, the rest to the segment's
length. For a single person they may be wrong by a tenth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

GRAVITY = 9.80665
"""Acceleration of gravity [m/s^2]"""
THIGH_LENGTH, SHANK_LENGTH, FOOT_LENGTH, ANKLE_HEIGHT = 0.245, 0.246, 0.152, 0.039
"""Lengths relative to the person's height"""
SHANK_MASS, FOOT_MASS = 0.0465, 0.0145
"""Masses relative to the body's mass"""
SHANK_CENTRE, SHANK_GYRATION, FOOT_GYRATION = 0.433, 0.302, 0.475
"""Distance of the shank's centre of mass from the knee, and radii of gyration about the centres of mass, relative to
the segment's length; that of the foot is from the ankle to the head of the second metatarsal"""
KNEE_OFFSET = 0.008
"""Distance by which the knee lies lateral of the ankle in stance, relative to the height: 13.7 and 15.3 mm on average
in both legs of the gait2354 model as its trial walks (1.80 m). With it the frontal moment there is wrong by 3 to 4 N m,
without it by 8 to 9 N m"""
FOOT_CENTRE = 0.5
"""Position of the foot's centre of mass between the ankle (0) and the head of the second metatarsal (1), which lies on
the ground half a foot's length ahead"""


class Leg(NamedTuple):
    """Lengths, masses and inertias of thigh, shank and foot."""

    thigh_length: float
    """Distance from hip to knee [m]"""
    shank_length: float
    """Distance from knee to ankle [m]"""
    knee_offset: float
    """Distance by which the knee lies lateral of the ankle [m]"""
    shank_mass: float
    """Mass of the shank [kg]"""
    shank_centre: float
    """Distance of the shank's centre of mass from the knee [m]"""
    shank_inertia: float
    """Moment of inertia of the shank about its centre of mass [kg m^2]"""
    foot_mass: float
    """Mass of the foot [kg]"""
    foot_forward: float
    """Distance of the foot's centre of mass from the ankle, along the sole [m]"""
    foot_below: float
    """Distance of the foot's centre of mass from the ankle, towards the sole [m]"""
    foot_inertia: float
    """Moment of inertia of the foot about its centre of mass [kg m^2]"""


def leg_of(mass: float, height: float) -> Leg:
    """Estimate the leg of a person from mass [kg] and height [m]."""
    shank, shank_mass, foot_mass = SHANK_LENGTH * height, SHANK_MASS * mass, FOOT_MASS * mass
    forward, below = 0.5 * FOOT_LENGTH * height, ANKLE_HEIGHT * height
    return Leg(
        THIGH_LENGTH * height, shank, KNEE_OFFSET * height,
        shank_mass, SHANK_CENTRE * shank, shank_mass * (SHANK_GYRATION * shank) ** 2,
        foot_mass, FOOT_CENTRE * forward, FOOT_CENTRE * below,
        foot_mass * (FOOT_GYRATION * math.hypot(forward, below)) ** 2,
    )  # fmt: skip
