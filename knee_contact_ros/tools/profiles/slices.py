"""Cut a surface along sagittal planes, and select the articular side of the cuts.

Beside the slice itself, parallel ones within a slab are cut: the noise of a mesh differs from one to the next, the bone
does not.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.profiles.charts import Chart
from knee_contact_ros.tools.profiles.surface import Surface

DISTANCE = 0.5e-3
"""Distance of adjacent planes [m], or a little more"""
COVER = 0.5e-3
"""Distance [m] behind another part of the surface beyond which a part is not articular; noise is less"""
LEAST_POINTS = 12
BLOCK = 256
"""Number of points that are compared with all pieces at once"""
LEAST_LENGTH = 0.5e-3
"""Length [m] above which pieces that are left out are reported"""


class Pieces(NamedTuple):
    """Straight pieces in which a plane cuts a mesh."""

    begins: Floats
    """First ends, shape (n, 2) [m]"""
    ends: Floats
    """Second ends, shape (n, 2) [m]"""
    numbers: Any
    """Number of the connected line to which each piece belongs, shape (n,)"""


class Slices(NamedTuple):
    """Points of the articular side in a slice and in the slab around it."""

    points: Floats
    """Points, shape (n, 2) [m]"""
    offsets: Floats
    """Distances from the slice over the slab's half thickness, shape (n,), -1 to 1; 0 in the slice itself"""
    remarks: tuple[str, ...]
    """What was left out, as sentences"""

    @property
    def raw(self) -> Floats:
        """Points of the slice itself, shape (n, 2) [m]; for a cloud with few of them all points of the slab."""
        own = self.offsets == 0.0
        return self.points[own] if np.count_nonzero(own) >= LEAST_POINTS else self.points


def cut(surface: Surface, z: float) -> Pieces:
    """Cut a mesh with the plane at `z` [m]."""
    import pyvista

    triangles: Any = surface.triangles
    mesh: Any = pyvista.PolyData.from_regular_faces(surface.points, triangles)
    line = mesh.slice(normal="z", origin=(0.0, 0.0, z))
    if line.n_cells == 0:
        nothing = np.empty((0, 2))
        return Pieces(nothing, nothing, np.empty(0, np.int64))
    line = line.clean().connectivity("all")
    ends = line.lines.reshape(-1, 3)[:, 1:]
    points = np.asarray(line.points, np.float64)[:, :2]
    return Pieces(points[ends[:, 0]], points[ends[:, 1]], np.asarray(line.cell_data["RegionId"]))


def slices(surface: Surface, z: float, slab: float, chart_of: type[Chart]) -> Slices:
    """Select the articular side of a surface within `slab` [m] of the plane at `z` [m].

    Raises:
        UsageError: the plane misses the surface or hardly touches it.
    """
    if not len(surface.triangles):
        return of_cloud(surface, z, slab)
    middle = cut(surface, z)
    if len(middle.begins) < LEAST_POINTS:
        what = "misses" if not len(middle.begins) else "hardly touches"
        raise UsageError(f"--slice {1e3 * z:g} {what} {surface.path}, which reaches from {surface.lateral_range}")
    chart = chart_of.around(np.concatenate([middle.begins, middle.ends]))
    points, remarks = articular(middle, chart)
    chart = chart_of.around(points)
    places = chart.place(points)
    low, high = float(places.min()), float(places.max())
    found, offsets = [points], [np.zeros(len(points))]
    planes = math.ceil(slab / DISTANCE)
    for step in range(1, planes + 1):
        beside = [articular(cut(surface, z + side * slab * step / planes), chart)[0] for side in (-1.0, 1.0)]
        if min(map(len, beside)) < LEAST_POINTS:
            remarks = (*remarks, f"the slab of {1e3 * slab:g} mm reaches beyond the surface")
            break
        for side, piece in zip((-1.0, 1.0), beside, strict=True):
            at = chart.place(piece)
            kept = piece[(at >= low) & (at <= high)]
            found.append(kept)
            offsets.append(np.full(len(kept), side * step / planes))
    return Slices(np.concatenate(found), np.concatenate(offsets), remarks)


def of_cloud(surface: Surface, z: float, slab: float) -> Slices:
    """Select the points of a cloud within `slab` [m] of `z` [m], or all of a cloud without a third column."""
    flat = not surface.points[:, 2].any()
    distance = np.zeros(len(surface.points)) if flat else surface.points[:, 2] - z
    inside = np.abs(distance) <= slab
    if np.count_nonzero(inside) < LEAST_POINTS:
        raise UsageError(
            f"--slice {1e3 * z:g}: only {np.count_nonzero(inside)} points of {surface.path} lie within "
            f"{1e3 * slab:g} mm of it (--slab); it reaches from {surface.lateral_range}"
        )
    remark = "a cloud of points is taken whole: it must hold the articular side only"
    offsets = distance[inside] / slab if slab > 0.0 else distance[inside]
    return Slices(surface.points[inside, :2], offsets, (remark,))


def articular(pieces: Pieces, chart: Chart) -> tuple[Floats, tuple[str, ...]]:
    """Select the visible points of the line of which most is visible from outside; return remarks on the rest too."""
    if not len(pieces.begins):
        return np.empty((0, 2)), ()
    middles = 0.5 * (pieces.begins + pieces.ends)
    seen = outside(middles, pieces, chart)
    lengths = np.hypot(*(pieces.ends - pieces.begins).T)
    visible = np.bincount(pieces.numbers, weights=lengths * seen)
    whole = np.bincount(pieces.numbers, weights=lengths)
    best = int(visible.argmax())
    chosen = (pieces.numbers == best) & seen
    points = np.unique(np.concatenate([pieces.begins[chosen], pieces.ends[chosen]]), axis=0)
    remarks = []
    others = [length for number, length in enumerate(whole) if number != best and length > LEAST_LENGTH]
    if others:
        left = ", ".join(f"{1e3 * length:.1f}" for length in sorted(others, reverse=True)[:5])
        remarks.append(
            f"the slice has {1 + len(others)} pieces; taken is the one of which most is seen from outside "
            f"({1e3 * whole[best]:.1f} mm), left out are {left} mm"
        )
    if whole[best] - visible[best] > LEAST_LENGTH:
        hidden = 1e3 * (whole[best] - visible[best])
        remarks.append(f"{hidden:.1f} mm of the slice lie behind the rest and are left out, as no articular side")
    return points, tuple(remarks)


def outside(points: Floats, pieces: Pieces, chart: Chart) -> Any:
    """Whether no piece lies further out than each of points of shape (n, 2) [m] by more than `COVER`, shape (n,)."""
    begin, end = chart.place(pieces.begins), chart.place(pieces.ends)
    out_begin, out_end = chart.outwards(pieces.begins), chart.outwards(pieces.ends)
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    usual = high - low < chart.half_turn  # a piece round the back covers nothing
    rise = (out_end - out_begin) / np.where(end == begin, 1.0, end - begin)

    def seen(part: Floats) -> Any:
        place, out = chart.place(part)[:, None], chart.outwards(part)[:, None]
        covers = (low <= place) & (place <= high) & usual & (out_begin + rise * (place - begin) > out + COVER)
        return ~covers.any(axis=1)

    blocks = range(0, len(points), BLOCK)  # of many points at once, the table would be large
    return np.concatenate([seen(points[first : first + BLOCK]) for first in blocks])
