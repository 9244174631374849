"""Thickness of cartilage in a slice: the distance within the slice from its surface to the bone's surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.profiles.charts import Chart
from knee_contact_ros.tools.profiles.shape import Shape
from knee_contact_ros.tools.profiles.slices import Pieces, cut
from knee_contact_ros.tools.profiles.surface import Surface

FEMORAL_ZONE = (-15.0, 70.0)
"""Directions of a femur's normal [deg] that are in contact in gait"""
TIBIAL_ZONE = (0.25, 0.75)
"""Shares of a tibia's width that are in contact in gait"""
MOST_INSIDE = 0.1
"""Largest share of places whose bone may lie outside of the cartilage, as meshes cross at the rims"""
THICKEST = 0.012
"""Largest plausible thickness [m]: human cartilage of the knee has some 2 mm, of the patella up to 7 mm"""


class Thickness(NamedTuple):
    """Thickness of the cartilage under a profile."""

    along: Floats
    """Thickness at the places of the shape, shape (n,) [m]"""
    mean: float
    """Mean thickness in the contact zone [m]"""
    bone: Floats
    """Straight pieces of the bone's cut, first and second end of each, shape (m, 2, 2) [m]"""


def thickness(shape: Shape, chart: Chart, bone: Surface, z: float, femur: bool) -> Thickness:
    """Measure the thickness at the places of a shape, from the bone cut at `z` [m].

    Raises:
        UsageError: the slice misses the bone, or the bone is not behind the cartilage.
    """
    if not len(bone.triangles):
        raise UsageError(f"--bone {bone.path}: it must be a mesh or a label map, not a cloud of points")
    pieces = cut(bone, z)
    if not len(pieces.begins):
        raise UsageError(f"--slice {1e3 * z:g} misses --bone {bone.path}, which reaches from {bone.lateral_range}")
    along = np.sqrt(squared_distances(shape.points, pieces))
    zone = in_zone(shape, femur)
    if not zone.any():
        raise UsageError(
            "--bone: the profile does not reach the zone that touches in gait, so no thickness can be told"
        )
    mean = float(along[zone].mean())
    if outside_share(shape.points[zone], chart, pieces) > MOST_INSIDE or mean > THICKEST:
        raise UsageError(
            f"--bone {bone.path} is not behind the cartilage (distance {1e3 * mean:.1f} mm on average): "
            "MESH must be the cartilage's surface, --bone the bone's, both in the same axes and --unit"
        )
    return Thickness(along, mean, np.stack([pieces.begins, pieces.ends], axis=1))


def in_zone(shape: Shape, femur: bool) -> NDArray[np.bool_]:
    """Which places of a shape are in contact in gait, shape (n,)."""
    if femur:
        degrees = np.degrees(shape.normal)
        return np.asarray((degrees >= FEMORAL_ZONE[0]) & (degrees <= FEMORAL_ZONE[1]))
    x = shape.points[:, 0]
    share = (x - x.min()) / np.ptp(x)
    return np.asarray((share >= TIBIAL_ZONE[0]) & (share <= TIBIAL_ZONE[1]))


def squared_distances(points: Floats, pieces: Pieces) -> Floats:
    """Squared distance [m²] of each point from the nearest straight piece, shape (n,)."""
    along = pieces.ends - pieces.begins
    offset = points[:, None, :] - pieces.begins
    squared_length = np.maximum((along**2).sum(axis=1), 1e-30)
    share = np.clip((offset * along).sum(axis=2) / squared_length, 0.0, 1.0)
    return np.asarray(((offset - share[..., None] * along) ** 2).sum(axis=2).min(axis=1))


def outside_share(points: Floats, chart: Chart, pieces: Pieces) -> float:
    """Share of the points for which the nearest bone lies further out than the point."""
    middles = 0.5 * (pieces.begins + pieces.ends)
    places, outwards = chart.place(middles), chart.outwards(middles)
    nearest = np.abs(chart.place(points)[:, None] - places).argmin(axis=1)
    return float(np.mean(outwards[nearest] > chart.outwards(points)))
