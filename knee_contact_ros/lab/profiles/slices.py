"""Cut a surface at a place, and select the points of its articular side.

Parallel slices within a slab are cut too: the noise of a mesh differs from one to the next, the bone does not.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...model.types import MM, Floats
from ...system.errors import UsageError
from .chart import Chart
from .surfaces import Surface

_PLANE_DISTANCE = 0.5e-3
"""Distance of adjacent planes of the slab [m], or a little less"""
_COVER_DEPTH = 0.5e-3
"""A part further than this behind another part of the surface is not articular [m]; noise is smaller"""
_LEAST_POINTS = 12
"""Smallest number of points of a slice"""
_LEAST_WIDTH = 0.045
"""Smallest width [m] of a surface with both compartments: condyles and plateaus are 20 to 35 mm wide"""
_POINTS_AT_ONCE = 256
"""Number of points compared with all segments at a time, as the table would be large for more"""
_MOST_POINTS = 50_000
"""Largest number of points of a cloud in a slab: they lie some micrometres apart"""
_MOST_SEGMENTS = 20_000
"""Largest number of triangles that a plane cuts: five times those of the finest mesh that is read"""
_PLACE_STEP = 1e-4
"""Step [m] to which the place of an automatic slice is rounded"""


class CutLines(NamedTuple):
    """The lines in which a plane cuts a mesh, as n segments."""

    begins: Floats
    """First ends, shape (n, 2) [m]"""
    ends: Floats
    """Second ends, shape (n, 2) [m]"""
    numbers: Any
    """Index of the connected line of each segment, shape (n,)"""


class Slices(NamedTuple):
    """Points of the articular side in a slice and the slab around it."""

    points: Floats
    """Points, shape (n, 2) [m]"""
    offsets: Floats
    """Distances from the slice relative to the slab's half thickness, shape (n,), -1 to 1; 0 in the slice"""
    remarks: tuple[str, ...]
    """What was left out, as sentences"""

    @property
    def raw(self) -> Floats:
        """Points of the slice itself, shape (n, 2) [m]; for a cloud with few of them, all points of the slab."""
        own = self.offsets == 0.0
        return self.points[own] if np.count_nonzero(own) >= _LEAST_POINTS else self.points


def slices(surface: Surface, z: float, slab: float, femur: bool) -> Slices:
    """Select the articular side of a surface within `slab` [m] of the plane at `z` [m].

    Raises:
        UsageError: the plane misses the surface or hardly touches it.
    """
    if not len(surface.triangles):
        return _of_cloud(surface, z, slab)
    middle = cut_surface(surface, z)
    if len(middle.begins) < _LEAST_POINTS:
        what = "misses" if not len(middle.begins) else "hardly touches"
        raise UsageError(
            f"--slice {MM * z:g} {what} {surface.path}, which reaches from {surface.lateral_range}; or see --axes"
        )
    all_ends = np.concatenate([middle.begins, middle.ends])
    points, remarks = _articular(middle, Chart.around(all_ends, femur))
    chart = Chart.around(points, femur)
    places = chart.place(points)
    found = [points]
    offsets = [np.zeros(len(points))]
    planes = math.ceil(slab / _PLANE_DISTANCE)
    for plane in range(1, planes + 1):
        both = [
            _articular(cut_surface(surface, z + side * slab * plane / planes), chart)[0]
            for side in (-1.0, 1.0)
        ]
        if min(map(len, both)) < _LEAST_POINTS:
            remarks = [*remarks, f"the slab of {MM * slab:g} mm reaches beyond the surface"]
            break
        for side, beside in zip((-1.0, 1.0), both, strict=True):
            at = chart.place(beside)
            found.append(beside[(at >= places.min()) & (at <= places.max())])
            offsets.append(np.full(len(found[-1]), side * plane / planes))
    return Slices(np.concatenate(found), np.concatenate(offsets), tuple(remarks))


def _of_cloud(surface: Surface, z: float, slab: float) -> Slices:
    """Select the points of a cloud within `slab` [m] of `z` [m], or all points if there is no third column."""
    flat = not surface.points[:, 2].any()
    distance = np.zeros(len(surface.points)) if flat else surface.points[:, 2] - z
    # A plane may lie at its edge, whatever the rounding.
    inside = np.flatnonzero(np.abs(distance) <= slab + 1e-9)
    count = len(inside)
    if count < _LEAST_POINTS:
        raise UsageError(
            f"--slice {MM * z:g}: only {count} points of {surface.path} lie within "
            f"{MM * slab:g} mm of it (--slab); it reaches from {surface.lateral_range}"
        )
    nearest = np.abs(distance).argmin()
    remarks = ["all points of a cloud are used: it must hold the articular side only"]
    if count > _MOST_POINTS:
        remarks = [
            f"of the slab's {count} points {_MOST_POINTS} are used, spread evenly over the file; they must be on the "
            "articular side only"
        ]
        inside = inside[np.linspace(0, count - 1, _MOST_POINTS).astype(np.int64)]
    if abs(distance[nearest]) > _PLANE_DISTANCE:
        there = MM * surface.points[nearest, 2]
        remarks.append(
            f"no point lies within {MM * _PLANE_DISTANCE:g} mm of the slice; the nearest has z = {there:.2f} mm"
        )
    offsets = np.round(distance[inside] / (slab or 1.0), 6)
    return Slices(surface.points[inside, :2], offsets, tuple(remarks))


def _articular(lines: CutLines, chart: Chart) -> tuple[Floats, list[str]]:
    """Select the visible points of the line that is most visible from outside; also return remarks on the rest."""
    if not len(lines.begins):
        return np.empty((0, 2)), []
    seen = _seen(0.5 * (lines.begins + lines.ends), lines, chart)
    lengths = np.hypot(*(lines.ends - lines.begins).T)
    visible = np.bincount(lines.numbers, weights=lengths * seen)
    best = int(visible.argmax())
    chosen = (lines.numbers == best) & seen
    points = np.unique(np.concatenate([lines.begins[chosen], lines.ends[chosen]]), axis=0)
    # What is shorter than 0.5 mm is not worth a remark.
    if lengths.sum() - visible[best] <= 0.5e-3:
        return points, []
    return points, [
        f"{MM * visible[best]:.1f} of {MM * lengths.sum():.1f} mm of the slice are used, the outer side of one "
        f"of {len(visible)} pieces; the rest lies behind it, or is apart from it"
    ]


def _seen(points: Floats, lines: CutLines, chart: Chart) -> Any:
    """Return which points, shape (n, 2) [m], no segment covers by more than `_COVER_DEPTH`; booleans, shape (n,)."""
    begin = chart.place(lines.begins)
    end = chart.place(lines.ends)
    out_begin = chart.outwards(lines.begins)
    low = np.minimum(begin, end)
    high = np.maximum(begin, end)
    # A segment round the back of a femur covers nothing.
    usual = high - low < (math.pi if chart.femur else math.inf)
    length = np.where(end == begin, 1.0, end - begin)
    rise = (chart.outwards(lines.ends) - out_begin) / length
    seen = []
    for first in range(0, len(points), _POINTS_AT_ONCE):
        part = points[first : first + _POINTS_AT_ONCE]
        place = chart.place(part)[:, None]
        out = chart.outwards(part)[:, None]
        above = out_begin + rise * (place - begin) > out + _COVER_DEPTH
        covers = (low <= place) & (place <= high) & usual & above
        seen.append(~covers.any(axis=1))
    return np.concatenate(seen)


def cut_surface(surface: Surface, z: float) -> CutLines:
    """Cut a mesh with the plane at `z` [m]."""
    import pyvista

    height = surface.points[:, 2]
    above = (height >= z)[surface.triangles].sum(axis=1)
    below = (height <= z)[surface.triangles].sum(axis=1)
    triangles: Any = surface.triangles[(above > 0) & (below > 0)]
    if len(triangles) > _MOST_SEGMENTS:
        raise UsageError(
            f"--slice {MM * z:g} cuts {len(triangles)} triangles of {surface.path}, and at most {_MOST_SEGMENTS} can "
            "be used: reduce its triangles"
        )
    if not len(triangles):
        return CutLines(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64))
    mesh: Any = pyvista.PolyData.from_regular_faces(surface.points, triangles)
    line = mesh.slice(normal="z", origin=(0.0, 0.0, z))
    if line.n_cells == 0:
        return CutLines(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64))
    line = line.clean().connectivity("all")
    ends = line.lines.reshape(-1, 3)[:, 1:]
    points = np.asarray(line.points, np.float64)[:, :2]
    return CutLines(points[ends[:, 0]], points[ends[:, 1]], np.asarray(line.cell_data["RegionId"]))


def contact_centre(surface: Surface, femur: bool, medial: bool) -> float:
    """Find the place z [m] of the slice through the contact centre of a compartment; medial is z < 0.

    Of a surface with both compartments the middle lies between these, whatever the origin of its axes.

    Femur: the mean place of its lowest points while it flexes from 0° to 60°. Tibia: the middle of the plateau, with
    triangles weighted by their area seen from above.

    Raises:
        UsageError: the surface has nothing on that side, or is a point cloud.
    """
    if not len(surface.triangles):
        raise UsageError(
            f"--slice auto needs a mesh; {surface.path} is a cloud of points: give the slice in mm"
        )
    middle = _middle(surface, femur)
    side = (surface.points[:, 2] - middle) * (-1.0 if medial else 1.0) > 0.0
    if np.count_nonzero(side) < _LEAST_POINTS:
        name = "medial side, z < 0" if medial else "lateral side, z > 0"
        raise UsageError(
            f"--slice auto: {surface.path} has nothing on the {name}; it reaches from {surface.lateral_range} (see "
            "--compartment and --axes)"
        )
    if femur:
        z = _lowest(surface.points[side])
    else:
        corners = surface.points[surface.triangles[side[surface.triangles].all(axis=1)]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        z = np.average(corners[:, :, 2].mean(axis=1), weights=np.abs(normal[:, 1]) + 1e-30)
    return float(np.round(float(z) / _PLACE_STEP) * _PLACE_STEP)


def _lowest(points: Floats) -> float:
    """Return the mean place z [m] of the lowest points of a femur while it flexes as in gait."""
    places = []
    for angle in np.radians(np.linspace(0.0, 60.0, 25)):
        height = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
        # Noise moves single points, so all within 0.2 mm of the lowest one count.
        places.append(points[height <= height.min() + 0.2e-3, 2].mean())
    return float(np.mean(places))


def _middle(surface: Surface, femur: bool) -> float:
    """Return the place z [m] between the condyles, or 0 for a surface with one compartment.

    A femur's condyles are the lowest places of either half of its width; a plateau's middle is that of its width.
    """
    z = surface.points[:, 2]
    low, high = float(z.min()), float(z.max())
    if high - low < _LEAST_WIDTH:
        return 0.0
    middle = 0.5 * (low + high)
    if not femur:
        return middle
    halves = (surface.points[z < middle], surface.points[z >= middle])
    return 0.5 * sum(map(_lowest, halves)) if min(map(len, halves)) >= _LEAST_POINTS else middle
