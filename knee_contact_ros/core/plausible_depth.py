"""The largest depth of a contact that is plausible for a knee."""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.geometries.base import FemoralGeometry

SHARE = 0.2
"""Part of the femoral radius beyond which a depth is implausible: 6.8 mm of 34 mm, which is 4 mm of cartilage pressed
flat and nearly as much of bone. Contact laws are valid for depths that are small against the radius."""


def plausible_depth(law: ContactLaw, femoral_radius: float) -> float:
    """Return the largest plausible depth [m]: `SHARE` of the femoral radius [m], but at most the law's thickness."""
    return min(SHARE * femoral_radius, law.thickness)


def radius_of(femur: FemoralGeometry) -> float:
    """Return the radius [m] of the circle that fits a femoral surface best, wherever its reference point is.

    Least squares of x² + y² = 2 a x + 2 b y + c (Kåsa's fit); a circle's own radius; infinite for points on a line.
    """
    points: Floats = femur.outline()
    centred = points - points.mean(axis=0)
    squares = (centred**2).sum(axis=1)
    matrix = np.column_stack([2.0 * centred, np.ones(len(centred))])
    (a, b, c), _, rank, _ = np.linalg.lstsq(matrix, squares, rcond=None)
    return math.sqrt(c + a * a + b * b) if rank == 3 else math.inf
