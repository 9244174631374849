"""What the sensors of a leg tell at one stamp."""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, float, float]
"""x forward, y up, z to the right"""


class Joints(NamedTuple):
    """The leg's joints; not a number where a joint is not measured."""

    flexion: float
    """[rad] of the knee, positive in flexion"""
    hip: float
    """[rad] between thigh and vertical in the sagittal plane, positive when the knee is ahead of the hip"""
    ankle: float
    """[rad] positive in dorsiflexion, 0 at a right angle"""
    knee_assistance: float = 0.0
    """[N m] torque of an actuator at the knee, positive when it extends"""
    ankle_assistance: float = 0.0
    """[N m] torque of an actuator at the ankle, positive when it plantarflexes"""


class Ground(NamedTuple):
    """What the ground exerts on the foot, in axes that stand upright."""

    force: Vector
    """[N]"""
    torque: Vector
    """[N m] about the ankle joint; not a number where it is not measured"""


UNKNOWN = float("nan")
