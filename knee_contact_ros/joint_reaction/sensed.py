"""What the sensors of a leg measure at one stamp."""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, float, float]
"""A vector with x forward, y up and z to the right"""


class Joints(NamedTuple):
    """Angles of the leg's joints, and torques of actuators there; an angle that is not measured is not a number."""

    flexion: float
    """Angle of the knee [rad], positive in flexion"""
    hip: float
    """Angle of the thigh to the vertical in the sagittal plane [rad], positive when the knee is ahead of the hip"""
    ankle: float
    """Angle of the ankle [rad], positive in dorsiflexion, 0 where the foot is at a right angle to the shank"""
    knee_assistance: float = 0.0
    """Torque of an actuator at the knee [N m], positive when it extends"""
    ankle_assistance: float = 0.0
    """Torque of an actuator at the ankle [N m], positive when it plantarflexes"""


class Ground(NamedTuple):
    """Force and torque that the ground exerts on the foot, in upright axes."""

    force: Vector
    """Force [N]"""
    torque: Vector
    """Torque about the ankle joint [N m]; not a number where it is not measured"""


UNKNOWN = float("nan")
"""A value that is not measured"""
