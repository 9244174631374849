"""Find the slice through the contact centre of a compartment from the surface alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.profiles.surface import Surface

FLEXION = np.radians(np.linspace(0.0, 60.0, 25))
"""Flexion angles [rad] of gait"""
NEAR = 0.2e-3
"""Height [m] above the lowest point within which points count as lowest, as noise moves single points"""
STEPWISE = 1e-4
"""Step [m] to which the place is rounded"""


def contact_centre(surface: Surface, femur: bool, medial: bool) -> float:
    """Find the place z [m] of the slice; medial is z < 0.

    Femur: where its lowest points lie on average while it flexes from 0° to 60°. Tibia: the middle of the plateau, each
    triangle counting with its area seen from above.

    Raises:
        UsageError: the surface has nothing on that side, or is a cloud of points.
    """
    if not len(surface.triangles):
        raise UsageError(f"--slice auto needs a mesh; {surface.path} is a cloud of points: give the slice in mm")
    side = surface.points[:, 2] < 0.0 if medial else surface.points[:, 2] > 0.0
    if np.count_nonzero(side) < 10:
        name, where = ("medial", "z < 0") if medial else ("lateral", "z > 0")
        raise UsageError(
            f"--slice auto: {surface.path} has nothing on the {name} side, {where}; it reaches from "
            f"{surface.lateral_range} (see --compartment and --axes)"
        )
    z = of_femur(surface.points[side]) if femur else of_tibia(surface, side)
    return float(np.round(z / STEPWISE) * STEPWISE)


def of_femur(points: Floats) -> float:
    """Mean z [m] of a femur's lowest points over the flexion angles of gait."""
    places = []
    for angle in FLEXION:
        height = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
        places.append(points[height <= height.min() + NEAR, 2].mean())
    return float(np.mean(places))


def of_tibia(surface: Surface, side: Any) -> float:
    """Mean z [m] of a tibia's area seen from above; `side` marks the points of the compartment."""
    triangles = surface.triangles[side[surface.triangles].all(axis=1)]
    corners = surface.points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.average(corners[:, :, 2].mean(axis=1), weights=np.abs(normal[:, 1]) + 1e-30))
