"""The closure equations of a knee that is guided by two sphere-on-plane contacts and three isometric fibres.

Tibia and femur frame: x anterior, y superior, z lateral, right knee. A point f of the femur lies at p + R f in the
tibia frame, R = R_y(-internal rotation) R_x(abduction) R_z(flexion): flexion about the femur's z axis, rotation about
the tibia's y axis, abduction about the axis between (Grood & Suntay 1983, doi:10.1115/1.3138397).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
CLOSED = 1e-14
"""Largest error [m] of a closed mechanism: some hundred rounding errors of coordinates of 0.1 m."""
ITERATIONS = 25
"""Largest number of Newton's iterations"""
WORST_CONDITION = 1e6
"""Largest condition number of the equations' derivatives; the default knee stays below 6000. Beyond it, the constraints
do not guide the femur."""


class Condyle(NamedTuple):
    """A sphere of the femur that touches a plane of the tibia."""

    centre: Vector
    """Centre of the sphere in the femur frame [m]."""
    radius: float
    """Radius of the sphere [m]"""
    contact: Vector
    """Any point of the plane in the tibia frame [m]."""
    normal: Vector
    """Normal of the plane towards the sphere, in the tibia frame; of any length."""


class Fibre(NamedTuple):
    """A ligament fibre of constant length."""

    femur: Vector
    """Attachment in the femur frame [m]."""
    tibia: Vector
    """Attachment in the tibia frame [m]."""
    length: float
    """Distance of the attachments [m]"""


class ConstrainedKnee(NamedTuple):
    """A knee with five constraints on six degrees of freedom, so that one is left."""

    medial: Condyle
    lateral: Condyle
    fibres: tuple[Fibre, Fibre, Fibre]


class SpatialPose(NamedTuple):
    """Pose of the femur in the tibia frame, apart from the flexion angle."""

    x: float
    """Anterior translation [m]."""
    y: float
    """Superior translation [m]."""
    z: float
    """Lateral translation [m]."""
    abduction: float
    """Abduction of the tibia [rad]."""
    internal_rotation: float
    """Internal rotation of the tibia [rad]."""

    def rotation(self, flexion: float) -> NDArray[np.float64]:
        """Return the matrix R, shape (3, 3), that turns directions of the femur frame into the tibia frame."""
        (sf, cf), (sa, ca), (si, ci) = ((math.sin(a), math.cos(a)) for a in (flexion, *self[3:]))
        return np.array(
            [
                [ci * cf - si * sa * sf, -ci * sf - si * sa * cf, -si * ca],
                [ca * sf, ca * cf, -sa],
                [si * cf + ci * sa * sf, -si * sf + ci * sa * cf, ci * ca],
            ]
        )


class Closure:
    """The five closure equations of a knee, which can be solved at any flexion angle."""

    def __init__(self, knee: ConstrainedKnee) -> None:
        """Take the geometry.

        Raises:
            ValueError: a number is not finite, or a radius, a length or a normal is not positive.
        """
        condyles = (knee.medial, knee.lateral)
        self._femur = np.array([*(c.centre for c in condyles), *(f.femur for f in knee.fibres)], float)
        self._tibia = np.array([*(c.contact for c in condyles), *(f.tibia for f in knee.fibres)], float)
        self._distances = np.array([*(c.radius for c in condyles), *(f.length for f in knee.fibres)], float)
        normals = np.array([c.normal for c in condyles], float)
        sizes = np.linalg.norm(normals, axis=1)
        if not all(np.isfinite(a).all() for a in (self._femur, self._tibia, self._distances, sizes)):
            raise ValueError("a number in the parallel mechanism's geometry is not finite")
        if min(self._distances.min(), sizes.min()) <= 0.0:
            raise ValueError("the parallel mechanism's radii, lengths and normals must not be 0")
        self._normals = normals / sizes[:, None]

    def solve(self, flexion: float, guess: SpatialPose) -> SpatialPose:
        """Return the pose at a flexion angle [rad], by Newton's method from a guess nearby.

        Raises:
            ValueError: the five constraints cannot be met near the guess, or leave the femur loose there.
        """
        pose = np.array(guess)
        for _ in range(ITERATIONS):
            errors, jacobian = self.linearised(flexion, SpatialPose(*pose.tolist()))
            if np.abs(errors).max() < CLOSED:
                if np.linalg.cond(jacobian) > WORST_CONDITION:
                    break
                return SpatialPose(*pose.tolist())
            try:
                pose = pose - np.linalg.solve(jacobian, errors)
            except np.linalg.LinAlgError:
                break
        raise ValueError(f"the parallel mechanism cannot be assembled at {math.degrees(flexion):.1f} deg of flexion")

    def linearised(self, flexion: float, pose: SpatialPose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the errors [m], shape (5,), and their derivatives by the pose, shape (5, 5).

        Each row is a line along which a contact pushes or a fibre pulls: its direction, and its moments about the
        axes of abduction and of internal rotation.
        """
        arms = self._femur @ pose.rotation(flexion).T
        gaps = arms + pose[:3] - self._tibia
        lines = gaps / np.sqrt((gaps * gaps).sum(axis=1))[:, None]  # a fibre pulls along itself
        lines[:2] = self._normals  # a contact pushes along its normal
        moments = arms[:, [1, 2, 0]] * lines[:, [2, 0, 1]] - arms[:, [2, 0, 1]] * lines[:, [1, 2, 0]]
        abduction_axis = (math.cos(pose.internal_rotation), 0.0, math.sin(pose.internal_rotation))
        jacobian = np.column_stack([lines, moments @ abduction_axis, -moments[:, 1]])
        return (lines * gaps).sum(axis=1) - self._distances, jacobian
