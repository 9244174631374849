"""Hip, ankle and ground force of a leg over time, in SI units and the package's signs and axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.gait_files.knee_gait import Angles, with_rate
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps


class GroundForces(NamedTuple):
    """Forces and torques that the ground exerts on a foot, in upright axes (x forward, y up, z to the right)."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    force: Floats
    """[N], shape (n, 3)"""
    torque: Floats
    """[N m] about the ankle joint's centre, shape (n, 3)"""


class Leg(NamedTuple):
    """Hip and ankle at the stamps of the knee's angle, and the ground forces at stamps of their own."""

    hip: Angles
    """Angle between thigh and vertical in the sagittal plane, positive when the knee is ahead of the hip"""
    ankle: Angles
    """Angle of the ankle, positive in dorsiflexion, 0 at a right angle"""
    ground: GroundForces


def leg_at(leg: Leg, stamps: Stamps, ground_stamps: Stamps) -> Leg:
    """Resample the joints at `stamps` [ns] and the ground forces at `ground_stamps` [ns], by linear interpolation."""
    ground = leg.ground
    force, torque = (
        np.column_stack([interpolated(ground_stamps, ground.stamps, column) for column in values.T])
        for values in (ground.force, ground.torque)
    )
    return Leg(_at(leg.hip, stamps), _at(leg.ankle, stamps), GroundForces(ground_stamps, force, torque))


def interpolated(stamps: Stamps, known: Stamps, values: Floats) -> Floats:
    """Interpolate values, shape (n,), linearly at other stamps [ns]; beyond the known stamps the end values hold."""
    first = known[0]  # nanoseconds since 1970 have more digits than a float
    return np.asarray(np.interp(stamps - first, known - first, values))


def _at(angles: Angles, stamps: Stamps) -> Angles:
    """Resample angles at other stamps [ns], and derive their rate."""
    return with_rate(Angles(stamps, interpolated(stamps, angles.stamps, angles.angle), None))
