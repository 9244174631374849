"""What the sensors of a leg would tell beside the knee's angle, over time, in our units, signs and axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.gait_files.knee_gait import Angles, with_rate
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps


class GroundForces(NamedTuple):
    """What the ground exerts on a foot, in axes that stand upright (x forward, y up, z to the right)."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    force: Floats
    """[N], shape (n, 3)"""
    torque: Floats
    """[N m] about the ankle joint's centre, shape (n, 3)"""


class Leg(NamedTuple):
    """Hip and ankle, at the stamps of the knee's angle, and the ground's force at stamps of its own."""

    hip: Angles
    """Between thigh and vertical in the sagittal plane, positive when the knee is ahead of the hip"""
    ankle: Angles
    """Positive in dorsiflexion, 0 at a right angle"""
    ground: GroundForces


def leg_at(leg: Leg, stamps: Stamps, ground_stamps: Stamps) -> Leg:
    """The joints at other stamps [ns], and the ground's force and torque likewise, interpolated linearly."""
    ground = leg.ground
    force, torque = (
        np.column_stack([interpolated(ground_stamps, ground.stamps, column) for column in values.T])
        for values in (ground.force, ground.torque)
    )
    return Leg(_at(leg.hip, stamps), _at(leg.ankle, stamps), GroundForces(ground_stamps, force, torque))


def interpolated(stamps: Stamps, known: Stamps, values: Floats) -> Floats:
    """Values, shape (n,), at other stamps [ns], linear; beyond the known ones those at the ends."""
    first = known[0]  # nanoseconds since 1970 have more digits than a float
    return np.asarray(np.interp(stamps - first, known - first, values))


def _at(angles: Angles, stamps: Stamps) -> Angles:
    return with_rate(Angles(stamps, interpolated(stamps, angles.stamps, angles.angle), None))
