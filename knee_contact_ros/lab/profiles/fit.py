"""Fit a profile to a slice of a surface: smooth its articular side, and describe what came out.

The quantity v of the chart (see `surfaces`) is a cubic B-spline with a penalty on its bends (P-splines: Eilers & Marx
1996, Stat Sci 11:89-121); a femur's is kept positive. The deviation that is left with hardly a penalty is the slice's
roughness (noise and dents). The penalty is the largest with which the deviation is no more than roughness and tolerance
together, added as independent errors are. So the noise of a mesh changes how far the profile is from the slice, but not
how smooth it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab.profiles.surfaces import (
    TURNED,
    Chart,
    Pieces,
    Slices,
    Surface,
    circle,
    cut,
    slices,
)
from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

TOLERANCE, SLAB = 0.05e-3, 2e-3
"""Defaults of the tolerance and of the slab's half thickness [m]"""
LEAST_V = 0.01
"""Lower bound of v for a femur: a curvature of about this over R, so that a profile is convex throughout"""
KNOTS, TILT_KNOTS = 2.5e-3, 10e-3
"""Distance between the knots of v, and of the tilt across the slab [m]"""
BENDS = 3
"""Polynomial degree of the bend across the slab, as a function of the place"""
GRID = 2001
"""Number of places at which a profile is computed"""
ROUGHEST, SMOOTHEST, HALVINGS = -5.0, 4.0, 12
"""Decadic logarithms of the penalty, and steps of the search between them; with less than the first, a profile follows
the noise of a mesh"""
SPACING = 0.75e-3
"""Distance between the points of a profile [m]"""
PER_POINT = 10
"""Number of places per point at which the profile's spline is evaluated"""
FEMORAL_WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Windows of circles: ranges of the direction of the outward normal [deg], 0 straight down, > 0 posterior: the flexion
angle at which the place is in contact"""
TIBIAL_WINDOWS = ((0.15, 0.75), (0.2, 0.8), (0.25, 0.75), (0.3, 0.7))
"""Windows of circles: ranges of the share of the plateau's width, from posterior"""
LEAST_PLACES = 8
"""The least number of places to which a circle is fitted"""
FEMORAL_ZONE, TIBIAL_ZONE = (-15.0, 70.0), (0.25, 0.75)
"""What is in contact in gait: directions of a femur's normal [deg], shares of a tibia's width"""
MOST_OUTSIDE, THICKEST = 0.1, 0.012
"""Largest share of places whose bone may lie outside of the cartilage, as meshes cross at the rims; and the largest
plausible thickness [m]: human cartilage of the knee has some 2 mm, of the patella up to 7 mm"""
FLATTEST_FEMUR = 0.35
"""Smallest ratio of height and width of a femur's slice: a condyle has some 0.8, a plateau 0.1 to 0.2"""
NOTABLE = 0.5
"""Deviation of the slice from the profile [mm] from which on it is reported"""
GAIT, LEAST_REACH = (0.0, 60.0), 0.5
"""Directions of the normal [deg] that are in contact in gait, and the least share of them that a condyle has"""
MOST_IN_FRONT = 40.0
"""How much further a condyle's articular side may reach in front than behind [deg]; in a knee from MRI it reaches 12 to
120 degrees further behind, and only near the notch as much as 33 further in front"""
RADII = ((12.0, math.inf), (10.0, 50.0), (9.0, 40.0))
"""Radii over `FEMORAL_WINDOWS` that a condyle may have [mm], generously: in a knee from MRI they are 20 to 84, 15 to 26
and 14 to 21 mm"""
RADII_TEXT = "a condyle's are 12 or more, 10 to 50 and 9 to 40 mm"
MOST_GROWTH = 1.2
"""How many times larger than the radius near extension that of the rear may be; from MRI it is 0.2 to 0.8"""
WORST = 1e-3
"""Largest roughness [m] of a slice that counts as a condyle or plateau"""


class Smoothed(NamedTuple):
    """Profile, and its distance from the slice."""

    points: Floats
    """Points of the profile, shape (n, 2) [m], from posterior to anterior at equal steps of arc length"""
    raw: Floats
    """Points of the slice, shape (m, 2) [m], from posterior to anterior"""
    deviations: Floats
    """Distances of the slice's points from the profile, shape (m,) [m], > 0 outside of it"""
    roughness: float
    """RMS distance [m] that is left with the least smoothing"""
    deviation: float
    """RMS distance [m] of all points of the slab from the profile"""

    @property
    def rms(self) -> float:
        """RMS of the slice's deviations [m]."""
        return float(np.sqrt(np.mean(self.deviations**2)))

    @property
    def largest(self) -> float:
        """Largest magnitude of the slice's deviations [m]."""
        return float(np.abs(self.deviations).max())


class Shape(NamedTuple):
    """Points, curvatures and normals of a profile's spline, place by place."""

    points: Floats
    """Points, shape (n, 2) [m]"""
    curvature: Floats
    """Curvatures, shape (n,) [1/m], > 0 where a femur is convex or a tibia is concave"""
    normal: Floats
    """Directions of a femur's outward normal, shape (n,) [rad], 0 straight down, > 0 posterior"""


class FittedCircle(NamedTuple):
    """Circle fitted to a part of a profile by least squares."""

    window: tuple[float, float]
    """Ends of the part: directions of the normal [deg] for a femur, x [mm] for a tibia"""
    radius: float
    """Radius [m], < 0 where a tibia is convex"""
    part: Floats
    """Points of the part, shape (n, 2) [m]"""


class Thickness(NamedTuple):
    """Thickness of the cartilage under a profile: the distance within the slice from its surface to the bone's."""

    along: Floats
    """Thickness at the places of the shape, shape (n,) [m]"""
    mean: float
    """Mean thickness in the contact zone [m]"""
    bone: Floats
    """Straight pieces of the bone's cut, first and second end of each, shape (m, 2, 2) [m]"""


class Fit(NamedTuple):
    """Profile in the mesh's frame, with its circles, thickness of cartilage, and remarks."""

    femur: bool
    """Whether it is a femur's profile, and not a tibia's"""
    z: float
    """Place of the slice [m]"""
    slab: float
    """Half thickness of the slab [m]"""
    tolerance: float
    """RMS distance from the slice that smoothing may add [m]"""
    smoothed: Smoothed
    shape: Shape
    circles: list[FittedCircle]
    thickness: Thickness | None
    remarks: tuple[str, ...]


def fit(
    surface: Surface, z: float, *, femur: bool = True, bone: Surface | None = None,
    tolerance: float = TOLERANCE, slab: float = SLAB,
) -> Fit:  # fmt: skip
    """Fit a femur's or a tibia's profile to the slice of a surface at `z` [m]; see `smooth` for `tolerance` [m].

    Raises:
        UsageError: the slice is empty, or no femur's or tibia's; or the bone is not behind the cartilage.
    """

    def refuse(*faults: tuple[bool, str, str]) -> None:
        kind = "condyle of a femur" if femur else "plateau of a tibia"
        for wrong, what, cure in faults:
            if wrong:
                raise UsageError(f"{surface.path}: the slice at z = {1e3 * z:g} mm is no {kind}: {what}; {cure}")

    slab_points = slices(surface, z, slab, femur)
    raw, other = slab_points.raw, "--side tibia?" if femur else "--side femur?"
    width, height = 1e3 * np.ptp(raw, axis=0)
    allowed = f"must be {'more' if femur else 'less'} than {FLATTEST_FEMUR:g} times as high as wide"
    refuse(
        (femur != (height > FLATTEST_FEMUR * width), f"it is {width:.1f} mm wide and {height:.1f} mm high, "
         f"and {allowed}", f"{other} (or see --axes and --slice)"),
        (femur and (raw - circle(raw)[0]).mean(axis=0)[1] > 0.0, "it looks up, not down", surface.axes_cure),
    )  # fmt: skip
    chart = Chart.around(raw, femur)
    smoothed = smooth(slab_points, chart, tolerance)
    worst = int(np.abs(smoothed.deviations).argmax())
    off, (x, y) = 1e3 * float(smoothed.deviations[worst]), 1e3 * smoothed.raw[worst]
    shape = _shape_of(smoothed.points)
    circles = _circles(shape, femur)
    radii = {each.window: 1e3 * each.radius for each in circles} if femur else {}
    told = "radii of " + ", ".join(f"{r:.1f} mm over normals of {a:.0f}° to {b:.0f}°" for (a, b), r in radii.items())
    low, high = np.degrees([shape.normal.min(), shape.normal.max()])
    reach = f"outward normals of {low:.0f}° to {high:.0f}° (0 down, > 0 posterior)"
    refuse(
        (smoothed.roughness > WORST,
         f"no profile comes closer to it than {1e3 * smoothed.roughness:.1f} mm RMS ({abs(off):.1f} mm at x = {x:.1f}, "
         f"y = {y:.1f} mm)", "cut off what is not articular surface, or see --slice, --side and --axes"),
        (femur and min(high, GAIT[1]) - max(low, GAIT[0]) < LEAST_REACH * (GAIT[1] - GAIT[0]),
         f"{reach}, and in gait those of {GAIT[0]:g}° to {GAIT[1]:g}° touch",
         "--slice through a condyle, or see --axes"),
        (femur and -low - high > MOST_IN_FRONT, f"{reach}, further in front than behind",
         f"is it the notch (--slice), or {TURNED} {surface.axes_cure}"),
        (not _possible(radii, 1.0), f"{told}, and {RADII_TEXT}", "--unit is 10 times too small or large"
         if _possible(radii, 10.0) or _possible(radii, 0.1) else surface.axes_cure),
        (radii.get(FEMORAL_WINDOWS[-1], 0.0) > MOST_GROWTH * radii.get(FEMORAL_WINDOWS[0], math.inf),
         f"{told}, which grow towards the rear", f"{TURNED} {surface.axes_cure}"),
        (not femur and z < 0.0 and not concave(shape), "it is convex throughout, and a medial one (z < 0) is hollow",
         f"is it upside down, or the lateral one? {surface.axes_cure}"),
    )  # fmt: skip
    cartilage = _thickness(shape, chart, bone, z) if bone is not None else None
    remarks = (*surface.remarks, *slab_points.remarks)
    if abs(off) >= NOTABLE:
        where = "outside of" if off > 0.0 else "behind"
        dent = f"the slice lies {abs(off):.1f} mm {where} the profile at x = {x:.1f}, y = {y:.1f} mm: a dent or a step?"
        remarks = (*remarks, dent)
    return Fit(femur, z, slab, tolerance, smoothed, shape, circles, cartilage, remarks)


def _possible(radii: Mapping[tuple[float, float], float], factor: float) -> bool:
    """Whether a femur may have radii [mm] over the windows, times a factor."""
    limits = dict(zip(FEMORAL_WINDOWS, RADII, strict=True))
    return all(limits[window][0] <= factor * radius <= limits[window][1] for window, radius in radii.items())


class _Problem(NamedTuple):
    """Linear least-squares problem with a penalty and lower bounds; its rows are scaled so that residuals are in m."""

    data: Floats
    """Rows of the points, in as many rows as unknowns"""
    target: Floats
    rest: float
    """Sum of squares [m²] that is left of the points' own targets whatever the unknowns are"""
    points: int
    """Number of points"""
    penalty: Floats
    lower: Floats
    basis: Floats
    """Columns g on the grid for every unknown except those of tilt and bend across the slab"""
    grid: Floats
    """Places"""

    def solve(self, logarithm: float) -> Floats:
        """Solve the problem for a penalty of 10^logarithm per point; return the unknowns."""
        from scipy.optimize import lsq_linear

        rows = np.concatenate([self.data, math.sqrt(10.0**logarithm * self.points) * self.penalty])
        target = np.concatenate([self.target, np.zeros(len(self.penalty))])
        orthogonal, triangle = np.linalg.qr(rows)  # the same problem in as many rows as unknowns
        target = orthogonal.T @ target
        free = np.linalg.lstsq(triangle, target, rcond=None)[0]
        if (free >= self.lower).all():
            return np.asarray(free)
        bounded: Any = lsq_linear(triangle, target, bounds=(self.lower, np.inf), method="bvls")
        return np.asarray(bounded.x)

    def residual(self, unknowns: Floats) -> float:
        """RMS distance [m] of the slab's points from the profile, not counting tilt and bend across the slab."""
        reached = float(np.sum((self.data @ unknowns - self.target) ** 2))
        return math.sqrt((reached + self.rest) / self.points)


def smooth(slab: Slices, chart: Chart, tolerance: float) -> Smoothed:
    """Smooth a slice so that its RMS distance is at most its roughness and `tolerance` [m], added as squares."""
    problem = _pose(slab, chart)
    roughness = problem.residual(problem.solve(ROUGHEST))
    allowed = math.hypot(roughness, tolerance)
    low, high = ROUGHEST, SMOOTHEST
    if problem.residual(problem.solve(high)) <= allowed:
        low = high
    for _ in range(HALVINGS if low < high else 0):
        middle = 0.5 * (low + high)
        within = problem.residual(problem.solve(middle)) <= allowed
        low, high = (middle, high) if within else (low, middle)
    unknowns = problem.solve(low)
    curve = chart.curve(problem.grid, problem.basis @ unknowns[: problem.basis.shape[1]])
    raw = slab.raw[np.argsort(chart.place(slab.raw))]
    way = _chord_length(curve)
    evenly = np.linspace(0.0, way[-1], math.ceil(way[-1] / SPACING) + 1)
    points = np.column_stack([np.interp(evenly, way, axis) for axis in curve.T])
    return Smoothed(points, raw, _distances(raw, curve, chart), roughness, problem.residual(unknowns))


def _pose(slab: Slices, chart: Chart) -> _Problem:
    """Set up the least-squares problem of a slice."""
    from scipy.interpolate import make_interp_spline

    place = chart.place(slab.points)
    low, high = float(place.min()), float(place.max())
    grid = np.linspace(low, high, GRID)
    v = _b_splines(grid, low, high, KNOTS / chart.scale)
    basis = chart.columns(grid, v)
    values, metres = chart.values(slab.points)
    columns = [make_interp_spline(grid, basis, k=1)(place)]  # linear in between
    if slab.offsets.any():
        tilt = _b_splines(place, low, high, TILT_KNOTS / chart.scale)
        bend = np.polynomial.legendre.legvander(2.0 * (place - low) / (high - low) - 1.0, BENDS)
        columns += [slab.offsets[:, None] * tilt, slab.offsets[:, None] ** 2 * bend]
    data = np.concatenate(columns, axis=1) * metres[:, None]
    own = slice(2, 2 + v.shape[1])
    bends = np.diff(np.eye(v.shape[1]), 2, axis=0)
    penalty = np.zeros((len(bends), data.shape[1]))
    penalty[:, own] = bends * chart.scale
    lower = np.full(data.shape[1], -np.inf)
    lower[own] = LEAST_V if chart.femur else -np.inf
    orthogonal, triangle = np.linalg.qr(data)
    target = orthogonal.T @ (values * metres)
    rest = float(np.sum((values * metres - orthogonal @ target) ** 2))
    return _Problem(triangle, target, rest, len(values), penalty, lower, basis, grid)


def _b_splines(places: Floats, low: float, high: float, spacing: float) -> Floats:
    """Values of cubic B-splines on equally spaced knots from `low` to `high`, shape (places, n)."""
    from scipy.interpolate import BSpline

    pieces = max(3, math.ceil((high - low) / spacing))
    knots = low + (high - low) / pieces * np.arange(-3, pieces + 4)
    inside = np.clip(places, low, high - 1e-12 * (high - low))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


def _distances(points: Floats, curve: Floats, chart: Chart) -> Floats:
    """Shortest distances [m] of points from a curve, shape (n,), > 0 outside of it."""
    from scipy.spatial import cKDTree

    nearest = np.clip(cKDTree(curve).query(points)[1], 1, len(curve) - 2)
    along = curve[nearest + 1] - curve[nearest - 1]
    offset = points - curve[nearest]
    across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.hypot(*along.T)
    out = chart.outwards(points) - np.interp(chart.place(points), chart.place(curve), chart.outwards(curve))
    return np.asarray(np.copysign(across, out))


def _chord_length(points: Floats) -> Floats:
    """Length along the chords from the first of points of shape (n, 2) [m] to each, shape (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _shape_of(points: Floats) -> Shape:
    """Evaluate the cubic spline over chord length through points of shape (n, 2) [m], as the model does."""
    from scipy.interpolate import CubicSpline

    way = _chord_length(points)
    spline = CubicSpline(way, points)
    places = np.linspace(0.0, way[-1], PER_POINT * (len(points) - 1) + 1)
    (x1, y1), (x2, y2) = spline(places, 1).T, spline(places, 2).T
    normal = -np.unwrap(np.arctan2(y1, x1))
    normal -= 2.0 * np.pi * np.round(np.median(normal) / (2.0 * np.pi))
    return Shape(spline(places), (x1 * y2 - y1 * x2) / np.hypot(x1, y1) ** 3, normal)


def _circles(shape: Shape, femur: bool) -> list[FittedCircle]:
    """Fit circles over `TIBIAL_WINDOWS`, or over those `FEMORAL_WINDOWS` that the profile covers."""
    circles, x, degrees = [], shape.points[:, 0], np.degrees(shape.normal)
    for low, high in FEMORAL_WINDOWS if femur else ():
        part = shape.points[(degrees >= low) & (degrees <= high)]
        if len(part) >= LEAST_PLACES and degrees.min() <= low + 1.0 and degrees.max() >= high - 1.0:
            circles.append(FittedCircle((low, high), circle(part)[1], part))
    for window in () if femur else TIBIAL_WINDOWS:
        begin, end = (float(x.min() + share * np.ptp(x)) for share in window)
        part = shape.points[(x >= begin) & (x <= end)]
        centre, radius = circle(part)
        radius = radius if centre[1] > part[:, 1].mean() else -radius
        circles.append(FittedCircle((1e3 * begin, 1e3 * end), radius, part))
    return circles


def concave(shape: Shape) -> list[tuple[float, float]]:
    """Ranges of x [m] in which a tibia's profile is concave."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], shape.curvature > 0.0, [0]]).astype(np.int8)))
    x = shape.points[:, 0]
    return [(float(x[a]), float(x[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _thickness(shape: Shape, chart: Chart, bone: Surface, z: float) -> Thickness:
    """Measure the thickness at the places of a shape, from the bone cut at `z` [m]."""
    if not len(bone.triangles):
        raise UsageError(f"--bone {bone.path}: it must be a mesh or a label map, not a cloud of points")
    pieces = cut(bone, z)
    if not len(pieces.begins):
        raise UsageError(f"--slice {1e3 * z:g} misses --bone {bone.path}, which reaches from {bone.lateral_range}")
    along = _distances_to(pieces, shape.points)
    x = shape.points[:, 0]
    reach = np.degrees(shape.normal) if chart.femur else (x - x.min()) / np.ptp(x)
    first, last = FEMORAL_ZONE if chart.femur else TIBIAL_ZONE
    zone = (reach >= first) & (reach <= last)
    if not zone.any():
        raise UsageError(
            "--bone: the profile does not reach the zone that touches in gait, so the thickness is not known"
        )
    mean = float(along[zone].mean())
    middles, points = 0.5 * (pieces.begins + pieces.ends), shape.points[zone]
    nearest = np.abs(chart.place(points)[:, None] - chart.place(middles)).argmin(axis=1)
    outside = float(np.mean(chart.outwards(middles)[nearest] > chart.outwards(points)))
    if outside > MOST_OUTSIDE or mean > THICKEST:
        raise UsageError(
            f"--bone {bone.path} is not behind the cartilage (distance {1e3 * mean:.1f} mm on average): "
            "MESH must be the cartilage's surface, --bone the bone's, both in the same axes and --unit"
        )
    return Thickness(along, mean, np.stack([pieces.begins, pieces.ends], axis=1))


def _distances_to(pieces: Pieces, points: Floats) -> Floats:
    """Distance [m] of each point from the nearest straight piece, shape (n,)."""
    along = pieces.ends - pieces.begins
    offset = points[:, None, :] - pieces.begins
    squared_length = np.maximum((along**2).sum(axis=1), 1e-30)
    share = np.clip((offset * along).sum(axis=2) / squared_length, 0.0, 1.0)
    return np.asarray(np.sqrt(((offset - share[..., None] * along) ** 2).sum(axis=2).min(axis=1)))
