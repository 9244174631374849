"""How deep a contact may be and still make sense."""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.geometries.base import FemoralGeometry

SHARE = 0.2
"""Part of the femoral radius beyond which a depth is none of a knee: 6.8 mm of 34 mm, cartilage of 4 mm pressed flat
and as much of bone. Contact laws are for depths that are small against the radius."""


def plausible_depth(law: ContactLaw, femoral_radius: float) -> float:
    """The largest depth [m] that makes sense: `SHARE` of the radius [m], and no more than the law's thickness."""
    return min(SHARE * femoral_radius, law.thickness)


def radius_of(femur: FemoralGeometry) -> float:
    """Radius [m] of the circle that fits a femoral surface best, wherever its reference point is; of a circle its own.

    Least squares of x² + y² = 2 a x + 2 b y + c (Kåsa's fit); infinite for points on a line.
    """
    points: Floats = femur.outline()
    centred = points - points.mean(axis=0)
    squares = (centred**2).sum(axis=1)
    matrix = np.column_stack([2.0 * centred, np.ones(len(centred))])
    (a, b, c), _, rank, _ = np.linalg.lstsq(matrix, squares, rcond=None)
    return math.sqrt(c + a * a + b * b) if rank == 3 else math.inf
