"""Measurements of a leg's sensors, the leg's motion, and the net moments that hold it.

Proportions: Winter (2009), Biomechanics and Motor Control of Human Movement, 4th ed., figure 4.1 and table 4.1
(doi:10.1002/9780470549148): lengths relative to the height, masses to the body's mass, the rest to the segment's
length. For one person they may be off by a tenth. Inverse dynamics: Newton-Euler equations of foot and shank
in the sagittal plane, from the ground up (chapter 5 there). The hip is assumed to move at a constant velocity: its
own acceleration, at most a few m/s^2 in walking, is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
"""A vector with x forward, y up and z to the right"""


class Joints(NamedTuple):
    """Angles of the leg's joints, and torques of actuators there; an angle that is not measured is NaN."""

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

    @property
    def unassisted(self) -> Joints:
        """The same angles without actuators."""
        return self._replace(knee_assistance=0.0, ankle_assistance=0.0)


class Ground(NamedTuple):
    """Force and torque that the ground exerts on the foot, in upright axes."""

    force: Vector
    """Force [N]"""
    torque: Vector
    """Torque about the ankle joint [N m]; NaN where it is not measured"""


NOT_MEASURED = float("nan")
"""A value that is not measured"""
GRAVITY = 9.80665
"""Acceleration of gravity [m/s^2]"""
# Proportions of a leg by Winter (2009), unless another source is named
_THIGH_LENGTH = 0.245
"""Distance from hip to knee, relative to the person's height"""
_SHANK_LENGTH = 0.246
"""Distance from knee to ankle, relative to the height"""
_FOOT_LENGTH = 0.152
"""Length of the foot, relative to the height"""
_ANKLE_HEIGHT = 0.039
"""Height of the ankle above the sole, relative to the person's height"""
_SHANK_MASS = 0.0465
"""Mass of the shank, relative to the body's"""
_FOOT_MASS = 0.0145
"""Mass of the foot, relative to the body's"""
_SHANK_CENTRE = 0.433
"""Distance of the shank's centre of mass from the knee, relative to the shank's length"""
_SHANK_GYRATION = 0.302
"""Radius of gyration of the shank about its centre of mass, relative to its length"""
_FOOT_GYRATION = 0.475
"""The same of the foot, relative to the distance from the ankle to the head of the second metatarsal"""
_KNEE_OFFSET = 0.008
"""Lateral distance from ankle to knee in stance, relative to the height: 13.7 and 15.3 mm on average in the two legs of
the gait2354 model in its trial (1.80 m). With it the frontal moment there is off by 3 to 4 N m, without it by 8 to
9 N m"""
_FOOT_CENTRE = 0.5
"""Position of the foot's centre of mass between the ankle (0) and the head of the second metatarsal (1), which lies on
the ground half a foot's length ahead"""


class Leg(NamedTuple):
    """Lengths, masses and inertias of thigh, shank and foot, and the body weight."""

    body_weight: float
    """Weight of the person [N]"""
    thigh_length: float
    """Distance from hip to knee [m]"""
    shank_length: float
    """Distance from knee to ankle [m]"""
    knee_offset: float
    """Lateral distance from the ankle to the knee [m]"""
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

    @property
    def weight_below(self) -> float:
        """Weight of shank and foot [N]."""
        return (self.shank_mass + self.foot_mass) * GRAVITY

    @property
    def inertia_below(self) -> float:
        """Moment of inertia of shank and foot about the knee [kg m^2]."""
        own = self.shank_inertia + self.foot_inertia
        return own + self.shank_mass * self.shank_centre**2 + self.foot_mass * self.shank_length**2


def leg_of(mass: float, height: float) -> Leg:
    """Estimate the leg of a person from mass [kg] and height [m]."""
    shank = _SHANK_LENGTH * height
    shank_mass = _SHANK_MASS * mass
    foot_mass = _FOOT_MASS * mass
    # From the ankle to the head of the second metatarsal
    forward = 0.5 * _FOOT_LENGTH * height
    below = _ANKLE_HEIGHT * height
    return Leg(
        body_weight=mass * GRAVITY,
        thigh_length=_THIGH_LENGTH * height,
        shank_length=shank,
        knee_offset=_KNEE_OFFSET * height,
        shank_mass=shank_mass,
        shank_centre=_SHANK_CENTRE * shank,
        shank_inertia=shank_mass * (_SHANK_GYRATION * shank) ** 2,
        foot_mass=foot_mass,
        foot_forward=_FOOT_CENTRE * forward,
        foot_below=_FOOT_CENTRE * below,
        foot_inertia=foot_mass * (_FOOT_GYRATION * math.hypot(forward, below)) ** 2,
    )


SECONDS_PER_NANOSECOND = 1e-9
"""Duration [s] of a nanosecond"""
MIN_MOTION_SAMPLES = 4
"""Smallest number of samples in the window for computing a motion"""
_MAX_MOTION_SAMPLES = 1000
"""Largest number of samples in the window, which is divided into as many cells; only the last sample of a cell counts.

A parabola through as many takes 7 us.
"""


class Turning(NamedTuple):
    """Angular velocity and acceleration of a joint, positive where its angle grows."""

    rate: float
    """Angular velocity [rad/s]"""
    acceleration: float
    """Angular acceleration [rad/s^2]"""


class LegMotion(NamedTuple):
    """Angular velocities and accelerations of the leg's joints."""

    flexion: Turning
    hip: Turning
    ankle: Turning


NOT_TURNING = Turning(0.0, 0.0)
"""Motion of a joint that is at rest, or of which too little is known"""
MOTIONLESS = LegMotion(NOT_TURNING, NOT_TURNING, NOT_TURNING)


class MotionFilter:
    """Fits a parabola to the last angles by least squares, and gives its slope at their middle and its curvature.

    So both are late by half a window. A window of twice the length reduces noise in the curvature to a sixth. The bits
    depend only on the stamps and angles in the window, which is divided into cells of the clock.
    """

    def __init__(self, window: float) -> None:
        """Set the duration [s] of the window that the parabola is fitted to; 0: the joints count as still."""
        self._window = round(window / SECONDS_PER_NANOSECOND)
        self._cell = -(-self._window // (_MAX_MOTION_SAMPLES - 1))
        # Twice as many as needed, so that the samples of the window move to the front only now and then
        self._stamps = np.empty(2 * _MAX_MOTION_SAMPLES, np.int64)
        self._angles = np.empty((2 * _MAX_MOTION_SAMPLES, 3))
        self.forget_angles()

    def forget_angles(self) -> None:
        """Forget all angles."""
        self._begin = 0
        self._end = 0
        self._last = -1
        self._motion = MOTIONLESS

    def motion_at(self, stamp: int) -> LegMotion:
        """Return the motion at a stamp [ns] not before the last angles; still if these are too old by then."""
        return self._motion if stamp - self._last <= self._window else MOTIONLESS

    def add_angles(self, stamp: int, joints: Joints) -> LegMotion:
        """Add the angles measured at a stamp [ns], and return the motion; still until there are enough samples.

        A stamp that is not later than the last one makes the filter forget all earlier angles.
        """
        if self._window == 0:
            return MOTIONLESS
        if stamp <= self._last:
            self.forget_angles()
        elif self._begin < self._end and stamp // self._cell == self._last // self._cell:
            self._end -= 1
        elif self._end == len(self._stamps):
            # The memory is full: the samples of the window move to its front.
            kept = slice(self._begin, self._end)
            number = self._end - self._begin
            self._stamps[:number] = self._stamps[kept]
            self._angles[:number] = self._angles[kept]
            self._begin = 0
            self._end = number
        self._stamps[self._end] = stamp
        self._angles[self._end] = joints[:3]
        self._last = stamp
        self._end += 1
        while stamp - self._stamps[self._begin] > self._window:
            self._begin += 1
        since = self._stamps[self._begin : self._end] - self._stamps[self._begin]
        known = len(since) >= MIN_MOTION_SAMPLES and 2 * since[-1] >= self._window
        self._motion = self._parabola(since / self._window) if known else MOTIONLESS
        return self._motion

    def _parabola(self, time: NDArray[np.float64]) -> LegMotion:
        """Fit by polynomials that are orthogonal on the times, in windows: 1, t, and t^2 - tilt t - level."""
        time = time - time.sum() / len(time)
        spread = time @ time
        tilt = (time * time) @ time / spread
        square = time * time - tilt * time - spread / len(time)
        angles = self._angles[self._begin : self._end]
        curvatures = square @ angles / (square @ square)
        slopes = time @ angles / spread - tilt * curvatures
        window = self._window * SECONDS_PER_NANOSECOND
        motion = []
        for slope, curvature in zip(slopes.tolist(), curvatures.tolist(), strict=True):
            turning = Turning(slope / window, 2.0 * curvature / (window * window))
            motion.append(turning if math.isfinite(slope) else NOT_TURNING)
        return LegMotion(*motion)


class NetMoments(NamedTuple):
    """Net moments of muscles and actuators, and the force and moment that the knee transmits without muscles."""

    extension: float
    """Net moment at the knee [N m], positive when it extends"""
    plantarflexion: float
    """Net moment at the ankle [N m], positive when it plantarflexes"""
    compression: float
    """Force along the tibia at the knee without muscles [N], positive in compression"""
    frontal: float
    """Moment of the femur on the tibia about the tibia's x axis at the knee, without muscles [N m]

    z to the right is lateral: the sensors of a left leg are mirrored to this, as its joint reaction is.
    """


def planar_moment(arm: complex, force: complex) -> float:
    """Return the z component of a cross product: the moment [N m] of a force [N] on an arm [m].

    A vector in the sagittal plane is a complex number here: x forward, y up.
    """
    return (arm.conjugate() * force).imag


def arm_acceleration(arm: complex, turning: Turning) -> complex:
    """Return the acceleration [m/s^2] of an arm's end relative to its beginning, about which it turns."""
    return arm * complex(-turning.rate * turning.rate, turning.acceleration)


_SUPPORT = complex(0.0, GRAVITY)
"""Acceleration [m/s^2] by which the ground supports a body at rest"""


def inclination(joints: Joints) -> float:
    """Return the angle [rad] of the shank to the vertical, positive when the ankle is ahead of the knee.

    It follows from the hip angle or, if that is not measured, from the ankle angle with the foot flat on the ground.
    """
    return joints.hip - joints.flexion if math.isfinite(joints.hip) else -joints.ankle


def net_moments(leg: Leg, joints: Joints, motion: LegMotion, ground: Ground) -> NetMoments:
    """Solve the equations of motion of foot and shank for the moments and forces that hold them.

    Args:
        leg: Lengths, masses and inertias of the person's leg.
        joints: Angles; hip or ankle must be measured. Without the ankle the foot is at a right angle to the shank, and
            turns with it.
        motion: How the joints turn; used only if the hip is measured.
        ground: Force and torque of the ground on the foot; the torque must be measured.
    """
    shank = inclination(joints)
    hip_angle = joints.hip
    if not math.isfinite(hip_angle):
        hip_angle = 0.0
        motion = MOTIONLESS
    bent, hip, turned = motion
    foot = shank + joints.ankle
    if not math.isfinite(joints.ankle):
        foot = shank
        turned = NOT_TURNING
    of_shank = Turning(hip.rate - bent.rate, hip.acceleration - bent.acceleration)
    of_foot = Turning(of_shank.rate + turned.rate, of_shank.acceleration + turned.acceleration)

    down = complex(math.sin(shank), -math.cos(shank))
    to_knee = complex(math.sin(hip_angle), -math.cos(hip_angle)) * leg.thigh_length
    to_ankle = down * leg.shank_length
    to_shank_centre = down * leg.shank_centre
    along_foot = complex(math.cos(foot), math.sin(foot))
    to_foot_centre = along_foot * complex(leg.foot_forward, -leg.foot_below)
    knee = arm_acceleration(to_knee, hip) + _SUPPORT
    ankle = knee + arm_acceleration(to_ankle, of_shank)
    holds_shank = (knee + arm_acceleration(to_shank_centre, of_shank)) * leg.shank_mass
    holds_foot = (ankle + arm_acceleration(to_foot_centre, of_foot)) * leg.foot_mass

    force_x, force_y, force_z = ground.force
    about_x, about_y, about_z = ground.torque
    on_foot = holds_foot - complex(force_x, force_y)
    dorsiflexion = (
        leg.foot_inertia * of_foot.acceleration
        + planar_moment(to_foot_centre, holds_foot)
        - about_z
    )
    extension = dorsiflexion + leg.shank_inertia * of_shank.acceleration
    extension += planar_moment(to_shank_centre, holds_shank) + planar_moment(to_ankle, on_foot)
    on_shank = on_foot + holds_shank
    compression = on_shank.real * down.real + on_shank.imag * down.imag
    about_x = -about_x - to_ankle.imag * force_z - leg.knee_offset * force_y
    about_y = -about_y + to_ankle.real * force_z + leg.knee_offset * force_x
    return NetMoments(
        extension, -dorsiflexion, compression, about_x * -down.imag + about_y * down.real
    )
