"""Fit a profile to a slice of a surface: smooth its articular side, and describe the result.

The quantity v of the chart (see `surfaces`) is a cubic B-spline with a penalty on its bends (P-splines: Eilers & Marx
1996, Stat Sci 11:89-121); a femur's is kept positive. The deviation left with the smallest penalty is the slice's
roughness (noise and dents). The fit takes the largest penalty with which the deviation does not exceed the root sum of
squares of roughness and tolerance. So a mesh's noise changes how far the profile is from the slice, but not how smooth
it is.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab import checks
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
"""Lower bound of v for a femur, which keeps a profile convex: a curvature of about this over R"""
KNOTS, TILT_KNOTS = 2.5e-3, 10e-3
"""Distance between the knots of v, and of the tilt across the slab [m]"""
BENDS = 3
"""Polynomial degree of the bend across the slab, as a function of the place"""
GRID = 2001
"""Number of places at which a profile is computed"""
ROUGHEST, SMOOTHEST, HALVINGS = -5.0, 4.0, 12
"""Decimal logarithms of the smallest and largest penalty, and steps of the search between them; with a smaller penalty
a profile would follow the mesh's noise"""
SPACING = 0.75e-3
"""Distance between the points of a profile [m]"""
PER_POINT = 10
"""Number of places per point at which the profile's spline is evaluated"""
FEMORAL_WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Windows of circles: ranges of the direction of the outward normal [deg], 0 straight down, > 0 posterior. This is the
flexion angle at which the place is in contact"""
TIBIAL_WINDOWS = ((0.15, 0.75), (0.2, 0.8), (0.25, 0.75), (0.3, 0.7))
"""Windows of circles: ranges of the plateau's width as fractions, from posterior"""
LEAST_PLACES = 8
"""Smallest number of places to which a circle is fitted"""
FEMORAL_ZONE, TIBIAL_ZONE = (-15.0, 70.0), (0.25, 0.75)
"""Zones in contact in gait: directions of a femur's normal [deg], fractions of a tibia's width"""
MOST_OUTSIDE, THICKEST = 0.1, 0.012
"""Largest fraction of places where the bone may lie outside the cartilage, as meshes cross at the rims; and the largest
plausible thickness [m]: knee cartilage has about 2 mm, that of the patella up to 7 mm"""
FLATTEST_FEMUR = 0.35
"""Smallest ratio of height to width of a femur's slice: a condyle has about 0.8, a plateau 0.1 to 0.2"""
NOTABLE = 0.5
"""Deviation of the slice from the profile [mm] above which it is reported"""
GAIT, LEAST_REACH = (0.0, 60.0), 0.5
"""Directions of the normal [deg] in contact in gait, and the smallest fraction of them that a condyle covers"""
MOST_IN_FRONT = 40.0
"""How much further a condyle's articular side may reach in front than behind [deg]. In a knee from MRI it reaches 12 to
120 degrees further behind; only near the notch it reaches up to 33 further in front"""
RADII = ((12.0, math.inf), (10.0, 50.0), (9.0, 40.0))
"""Generous ranges of a condyle's radii over `FEMORAL_WINDOWS` [mm]: in a knee from MRI they are 20 to 84, 15 to 26 and
14 to 21 mm"""
MOST_GROWTH = 1.2
"""Largest ratio of the rear radius to the one near extension; from MRI it is 0.2 to 0.8"""
WORST = 1.0
"""Largest roughness [mm] of a slice that counts as a condyle or plateau"""


class Smoothed(NamedTuple):
    """Profile, and its distance from the slice."""

    points: Floats
    """Points of the profile, shape (n, 2) [m], from posterior to anterior at equal steps of arc length"""
    raw: Floats
    """Points of the slice, shape (m, 2) [m], from posterior to anterior"""
    deviations: Floats
    """Distances of the slice's points from the profile, shape (m,) [m], > 0 outside of it"""
    roughness: float
    """RMS distance [m] with the least smoothing"""
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
    """Cartilage thickness under a profile: the distance within the slice from its surface to the bone."""

    along: Floats
    """Thickness at the places of the shape, shape (n,) [m]"""
    mean: float
    """Mean thickness in the contact zone [m]"""
    bone: Floats
    """Segments of the bone's cut, both ends of each, shape (m, 2, 2) [m]"""


class Fit(NamedTuple):
    """Profile in the mesh's frame, with its circles, thickness of cartilage, and remarks."""

    femur: bool
    """Whether it is a femur's profile (else a tibia's)"""
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
        UsageError: the slice is empty, is not a femur's or tibia's, or the bone is not behind the cartilage.
    """
    kind = "condyle of a femur" if femur else "plateau of a tibia"

    def check(what: str, value: float, unit: str, limits: tuple[float, float], cure: str) -> None:
        where = f"{surface.path}: the slice at z = {1e3 * z:g} mm is no {kind}"
        checks.refuse(checks.outside(where, what, value, unit, limits, cure))

    slab_points = slices(surface, z, slab, femur)
    raw, cure = slab_points.raw, surface.axes_cure
    width, height = np.ptp(raw, axis=0)
    steep = (FLATTEST_FEMUR, math.inf) if femur else (0.0, FLATTEST_FEMUR)
    other = f"--side {'tibia' if femur else 'femur'}? (or see --axes and --slice)"
    check("its height over its width", height / max(width, 1e-9), "", steep, other)
    if femur:
        middle = 1e3 * float((raw - circle(raw)[0]).mean(axis=0)[1])
        check("it looks up; the height of its points above its circle's centre", middle, "mm", (-math.inf, 0.0), cure)
    chart = Chart.around(raw, femur)
    smoothed = smooth(slab_points, chart, tolerance)
    worst = int(np.abs(smoothed.deviations).argmax())
    off, (x, y) = 1e3 * float(smoothed.deviations[worst]), 1e3 * smoothed.raw[worst]
    dent = f"{abs(off):.1f} mm {'outside of' if off > 0.0 else 'behind'} the profile at x = {x:.1f}, y = {y:.1f} mm"
    cut_off = f"cut off what is not articular surface (it lies {dent}), or see --slice, --side and --axes"
    check("its RMS distance from any profile", 1e3 * smoothed.roughness, "mm", (0.0, WORST), cut_off)
    shape = _shape_of(smoothed.points)
    circles = _circles(shape, femur)
    if femur:
        low, high = np.degrees([shape.normal.min(), shape.normal.max()])
        reach = f"with outward normals of {low:.0f}° to {high:.0f}° (0 down, > 0 posterior)"
        share = (min(high, GAIT[1]) - max(low, GAIT[0])) / (GAIT[1] - GAIT[0])
        of_gait = f"{reach}, the share of what touches in gait ({GAIT[0]:g}° to {GAIT[1]:g}°)"
        check(of_gait, share, "", (LEAST_REACH, 1.0), "--slice through a condyle, or see --axes")
        notch = f"is it the notch (--slice), or {TURNED} {cure}"
        check(f"{reach}, the reach in front beyond that behind", -low - high, "°", (-math.inf, MOST_IN_FRONT), notch)
        radii = {each.window: 1e3 * each.radius for each in circles}
        for (low, high), limits in zip(FEMORAL_WINDOWS, RADII, strict=True):
            if (low, high) in radii:
                radius = f"its radius over normals of {low:.0f}° to {high:.0f}°"
                check(radius, radii[low, high], "mm", limits, f"is --unit right? {cure}")
        growth = radii.get(FEMORAL_WINDOWS[-1], 0.0) / radii.get(FEMORAL_WINDOWS[0], math.inf)
        check("its rear radius over that near extension", growth, "", (0.0, MOST_GROWTH), f"{TURNED} {cure}")
    elif z < 0.0:
        hollow = f"a medial one (z < 0) is hollow: is it upside down, or the lateral one? {cure}"
        check("its largest concave curvature", float(shape.curvature.max()), "1/m", (0.0, math.inf), hollow)
    cartilage = _thickness(shape, chart, bone, z) if bone is not None else None
    remarks = (*surface.remarks, *slab_points.remarks)
    if abs(off) >= NOTABLE:
        remarks = (*remarks, f"the slice lies {dent}: a dent or a step?")
    return Fit(femur, z, slab, tolerance, smoothed, shape, circles, cartilage, remarks)


def smooth(slab: Slices, chart: Chart, tolerance: float) -> Smoothed:
    """Smooth a slice so that its RMS distance is at most the root sum of squares of its roughness and `tolerance` [m].

    This is linear least squares with a penalty and lower bounds, scaled so that residuals are in m. Tilt and bend
    across the slab are also unknown, but not part of the profile.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.optimize import lsq_linear
    from scipy.spatial import cKDTree

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
    bends = np.diff(np.eye(v.shape[1]), 2, axis=0)
    penalty, lower = np.zeros((len(bends), data.shape[1])), np.full(data.shape[1], -np.inf)
    own = slice(2, 2 + v.shape[1])
    penalty[:, own] = bends * chart.scale
    lower[own] = LEAST_V if chart.femur else -np.inf
    orthogonal, triangle = np.linalg.qr(data)  # the same problem in as many rows as unknowns
    target = orthogonal.T @ (values * metres)
    rest = float(np.sum((values * metres - orthogonal @ target) ** 2))

    def solve(logarithm: float) -> tuple[Floats, float]:
        """Unknowns for a penalty of 10^logarithm per point, and the RMS distance [m] of the slab's points."""
        rows = np.concatenate([triangle, math.sqrt(10.0**logarithm * len(place)) * penalty])
        wanted = np.concatenate([target, np.zeros(len(penalty))])
        found: Any = lsq_linear(rows, wanted, bounds=(lower, np.inf), method="bvls")
        return found.x, math.sqrt((float(np.sum((triangle @ found.x - target) ** 2)) + rest) / len(place))

    roughness = solve(ROUGHEST)[1]
    allowed = math.hypot(roughness, tolerance)
    rough, smoothest = ROUGHEST, SMOOTHEST
    if solve(smoothest)[1] <= allowed:
        rough = smoothest
    for _ in range(HALVINGS if rough < smoothest else 0):
        middle = 0.5 * (rough + smoothest)
        rough, smoothest = (middle, smoothest) if solve(middle)[1] <= allowed else (rough, middle)
    unknowns, deviation = solve(rough)
    curve = chart.curve(grid, basis @ unknowns[: basis.shape[1]])
    raw = slab.raw[np.argsort(chart.place(slab.raw))]
    way = _chord_length(curve)
    evenly = np.linspace(0.0, way[-1], math.ceil(way[-1] / SPACING) + 1)
    points = np.column_stack([np.interp(evenly, way, axis) for axis in curve.T])
    nearest = np.clip(cKDTree(curve).query(raw)[1], 1, len(curve) - 2)
    along, offset = curve[nearest + 1] - curve[nearest - 1], raw - curve[nearest]
    across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.hypot(*along.T)
    out = chart.outwards(raw) - np.interp(chart.place(raw), chart.place(curve), chart.outwards(curve))
    return Smoothed(points, raw, np.copysign(across, out), roughness, deviation)


def _b_splines(places: Floats, low: float, high: float, spacing: float) -> Floats:
    """Values of cubic B-splines on equally spaced knots from `low` to `high`, shape (places, n)."""
    from scipy.interpolate import BSpline

    pieces = max(3, math.ceil((high - low) / spacing))
    knots = low + (high - low) / pieces * np.arange(-3, pieces + 4)
    inside = np.clip(places, low, high - 1e-12 * (high - low))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


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
    circles, x = [], 1e3 * shape.points[:, 0]
    along = np.degrees(shape.normal) if femur else x
    of_tibia = [(x.min() + first * np.ptp(x), x.min() + last * np.ptp(x)) for first, last in TIBIAL_WINDOWS]
    for low, high in FEMORAL_WINDOWS if femur else of_tibia:
        part = shape.points[(along >= low) & (along <= high)]
        if len(part) >= LEAST_PLACES and along.min() <= low + 1.0 and along.max() >= high - 1.0:
            centre, radius = circle(part)
            convex = not femur and centre[1] <= part[:, 1].mean()
            circles.append(FittedCircle((low, high), -radius if convex else radius, part))
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
    along = _distances(pieces, shape.points)
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


def _distances(pieces: Pieces, points: Floats) -> Floats:
    """Distance [m] of each point from the nearest segment, shape (n,)."""
    along, offset = pieces.ends - pieces.begins, points[:, None, :] - pieces.begins
    squared_length = np.maximum((along**2).sum(axis=1), 1e-30)
    share = np.clip((offset * along).sum(axis=2) / squared_length, 0.0, 1.0)
    return np.asarray(np.sqrt(((offset - share[..., None] * along) ** 2).sum(axis=2).min(axis=1)))
