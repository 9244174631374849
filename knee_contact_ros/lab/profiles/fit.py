"""Cut a surface, fit a profile to the articular side of the slice, and describe the result.

Parallel slices within a slab are cut too: the noise of a mesh differs from one to the next, the bone does not.

**Chart.** Coordinates in which a profile is a function g of a single number make smoothing a linear problem. Femur:
polar, about the centre of its mean circle. g = R/r over the angle α; its curvature has the sign of v = g'' + g, so that
v > 0 is convexity, and v is constant for a circle about the centre. Tibia: height over x. g = y/L over x/L, and v = g''
is free.

**Smoothing.** The quantity v of the chart is a cubic B-spline with a penalty on its bends (P-splines: Eilers & Marx
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
from knee_contact_ros.lab.profiles.surfaces import Surface
from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

DISTANCE = 0.5e-3
"""Distance of adjacent planes of the slab [m], or a little less"""
COVER = 0.5e-3
"""A part further than this behind another part of the surface is not articular [m]; noise is smaller"""
LEAST_POINTS = 12
"""Smallest number of points of a slice"""
BLOCK = 256
"""Number of points compared with all pieces at a time"""
LEAST_LENGTH = 0.5e-3
"""Length [m] above which left-out pieces are reported"""
FLEXION = np.radians(np.linspace(0.0, 60.0, 25))
"""Flexion angles [rad] of gait"""
NEAR = 0.2e-3
"""Points up to this height [m] above the lowest one count as lowest, as noise moves single points"""
STEPWISE = 1e-4
"""Step [m] to which the place of an automatic slice is rounded"""
TURNED = "are front and back exchanged (then turn over two axes, as --axes=-x,y,-z; one alone makes a mirror image)?"
TOLERANCE, SLAB = 0.05e-3, 2e-3
"""Defaults of the tolerance and of the slab's half thickness [m]"""
LEAST_V = 0.01
"""Lower bound of v for a femur, which keeps a profile convex: a curvature of about this over R"""
KNOTS, TILT_KNOTS = 2.5e-3, 10e-3
"""Distance between the knots of v, and of the tilt across the slab [m]"""
BENDS = 3
"""Polynomial degree of the bend across the slab, as a function of the place"""
APART = 10.0
"""Condition number of the powers of the offsets below which tilt and bend are told apart from the profile: it is 4 for
points all over the slab, 3 for three planes, and infinite for a bend over two planes or a tilt over a single one"""
GRID = 2001
"""Number of places at which a profile is computed"""
ROUGHEST, SMOOTHEST, HALVINGS = -5.0, 4.0, 12
"""Decimal logarithms of the smallest and largest penalty, and steps of the search between them; with a smaller penalty
a profile would follow the mesh's noise"""
SPACING, LONGEST = 0.75e-3, 1.0
"""Distance between the points of a profile [m], or a little less; more than that on a curve beyond this length [m]"""
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


class Pieces(NamedTuple):
    """The n segments in which a plane cuts a mesh."""

    begins: Floats
    """First ends, shape (n, 2) [m]"""
    ends: Floats
    """Second ends, shape (n, 2) [m]"""
    numbers: Any
    """Index of the connected line of each segment, shape (n,)"""


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
    surface: Surface,
    z: float,
    *,
    femur: bool = True,
    bone: Surface | None = None,
    tolerance: float = TOLERANCE,
    slab: float = SLAB,
) -> Fit:
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
        check(
            "it looks up; the height of its points above its circle's centre",
            middle,
            "mm",
            (-math.inf, 0.0),
            cure,
        )
    chart = Chart.around(raw, femur)
    smoothed = smooth(slab_points, chart, tolerance)
    worst = int(np.abs(smoothed.deviations).argmax())
    off, (x, y) = 1e3 * float(smoothed.deviations[worst]), 1e3 * smoothed.raw[worst]
    dent = f"{abs(off):.1f} mm {'outside of' if off > 0.0 else 'behind'} the profile at x = {x:.1f}, y = {y:.1f} mm"
    cut_off = (
        f"cut off parts that are not articular surface ({dent}), or see --slice, --side and --axes"
    )
    check(
        "its RMS distance from any profile", 1e3 * smoothed.roughness, "mm", (0.0, WORST), cut_off
    )
    untold = (
        f"too few points around the slice to tell the profile ({dent}): see --slice and --slab"
    )
    check(
        "its RMS distance from the profile",
        1e3 * smoothed.rms,
        "mm",
        (0.0, WORST + 1e3 * tolerance),
        untold,
    )
    shape = _shape_of(smoothed.points)
    circles = _circles(shape, femur)
    if femur:
        low, high = np.degrees([shape.normal.min(), shape.normal.max()])
        reach = f"with outward normals of {low:.0f}° to {high:.0f}° (0 down, > 0 posterior)"
        share = (min(high, GAIT[1]) - max(low, GAIT[0])) / (GAIT[1] - GAIT[0])
        of_gait = f"{reach}, the share of what touches in gait ({GAIT[0]:g}° to {GAIT[1]:g}°)"
        check(of_gait, share, "", (LEAST_REACH, 1.0), "--slice through a condyle, or see --axes")
        notch = f"is it the notch (--slice), or {TURNED} {cure}"
        check(
            f"{reach}, the reach in front beyond that behind",
            -low - high,
            "°",
            (-math.inf, MOST_IN_FRONT),
            notch,
        )
        radii = {each.window: 1e3 * each.radius for each in circles}
        for (low, high), limits in zip(FEMORAL_WINDOWS, RADII, strict=True):
            if (low, high) in radii:
                radius = f"its radius over normals of {low:.0f}° to {high:.0f}°"
                check(radius, radii[low, high], "mm", limits, f"is --unit right? {cure}")
        growth = radii.get(FEMORAL_WINDOWS[-1], 0.0) / radii.get(FEMORAL_WINDOWS[0], math.inf)
        check(
            "its rear radius over that near extension",
            growth,
            "",
            (0.0, MOST_GROWTH),
            f"{TURNED} {cure}",
        )
    elif z < 0.0:
        hollow = f"a medial one (z < 0) is hollow: is it upside down, or the lateral one? {cure}"
        check(
            "its largest concave curvature",
            float(shape.curvature.max()),
            "1/m",
            (0.0, math.inf),
            hollow,
        )
    cartilage = _thickness(shape, chart, bone, z) if bone is not None else None
    remarks = (*surface.remarks, *slab_points.remarks)
    if abs(off) >= NOTABLE:
        remarks = (*remarks, f"the slice lies {dent}: a dent or a step?")
    return Fit(femur, z, slab, tolerance, smoothed, shape, circles, cartilage, remarks)


def smooth(slab: Slices, chart: Chart, tolerance: float) -> Smoothed:
    """Smooth a slice so that its RMS distance is at most the root sum of squares of its roughness and `tolerance` [m].

    This is linear least squares with a penalty and lower bounds, scaled so that residuals are in m. Tilt and bend
    across the slab are also unknown, but not part of the profile; they are left out where the offsets do not tell.
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
    tilt = _b_splines(place, low, high, TILT_KNOTS / chart.scale)
    bend = np.polynomial.legendre.legvander(2.0 * (place - low) / (high - low) - 1.0, BENDS)
    powers = np.vander(slab.offsets / (np.abs(slab.offsets).max() or 1.0), 3, increasing=True)
    for power, across in enumerate((tilt, bend), 1):
        if np.linalg.cond(powers[:, : power + 1]) < APART:
            columns.append(slab.offsets[:, None] ** power * across)
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
        return found.x, math.sqrt(
            (float(np.sum((triangle @ found.x - target) ** 2)) + rest) / len(place)
        )

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
    evenly = np.linspace(0.0, way[-1], math.ceil(min(LONGEST, way[-1]) / SPACING) + 1)
    points = np.column_stack([np.interp(evenly, way, axis) for axis in curve.T])
    nearest = np.clip(cKDTree(curve).query(raw)[1], 1, len(curve) - 2)
    along, offset = curve[nearest + 1] - curve[nearest - 1], raw - curve[nearest]
    across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.hypot(*along.T)
    out = chart.outwards(raw) - np.interp(
        chart.place(raw), chart.place(curve), chart.outwards(curve)
    )
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
    of_tibia = [
        (x.min() + first * np.ptp(x), x.min() + last * np.ptp(x)) for first, last in TIBIAL_WINDOWS
    ]
    for low, high in FEMORAL_WINDOWS if femur else of_tibia:
        part = shape.points[(along >= low) & (along <= high)]
        if len(part) >= LEAST_PLACES and along.min() <= low + 1.0 and along.max() >= high - 1.0:
            centre, radius = circle(part)
            convex = not femur and centre[1] <= part[:, 1].mean()
            circles.append(FittedCircle((low, high), -radius if convex else radius, part))
    return circles


def concave(shape: Shape) -> list[tuple[float, float]]:
    """Ranges of x [m] in which a tibia's profile is concave."""
    edges = np.flatnonzero(
        np.diff(np.concatenate([[0], shape.curvature > 0.0, [0]]).astype(np.int8))
    )
    x = shape.points[:, 0]
    return [(float(x[a]), float(x[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _thickness(shape: Shape, chart: Chart, bone: Surface, z: float) -> Thickness:
    """Measure the thickness at the places of a shape, from the bone cut at `z` [m]."""
    if not len(bone.triangles):
        raise UsageError(
            f"--bone {bone.path}: it must be a mesh or a label map, not a cloud of points"
        )
    pieces = cut(bone, z)
    if not len(pieces.begins):
        raise UsageError(
            f"--slice {1e3 * z:g} misses --bone {bone.path}, which reaches from {bone.lateral_range}"
        )
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


def contact_centre(surface: Surface, femur: bool, medial: bool) -> float:
    """Find the place z [m] of the slice through the contact centre of a compartment; medial is z < 0.

    Femur: the mean place of its lowest points while it flexes from 0° to 60°. Tibia: the middle of the plateau, with
    triangles weighted by their area seen from above.

    Raises:
        UsageError: the surface has nothing on that side, or is a point cloud.
    """
    if not len(surface.triangles):
        raise UsageError(
            f"--slice auto needs a mesh; {surface.path} is a cloud of points: give the slice in mm"
        )
    side = surface.points[:, 2] * (-1.0 if medial else 1.0) > 0.0
    if np.count_nonzero(side) < LEAST_POINTS:
        name = "medial side, z < 0" if medial else "lateral side, z > 0"
        raise UsageError(
            f"--slice auto: {surface.path} has nothing on the {name}; it reaches from {surface.lateral_range} (see "
            "--compartment and --axes)"
        )
    if femur:
        points, places = surface.points[side], []
        for angle in FLEXION:
            height = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
            places.append(points[height <= height.min() + NEAR, 2].mean())
        z = np.mean(places)
    else:
        corners = surface.points[surface.triangles[side[surface.triangles].all(axis=1)]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        z = np.average(corners[:, :, 2].mean(axis=1), weights=np.abs(normal[:, 1]) + 1e-30)
    return float(np.round(float(z) / STEPWISE) * STEPWISE)


def cut(surface: Surface, z: float) -> Pieces:
    """Cut a mesh with the plane at `z` [m]."""
    import pyvista

    triangles: Any = surface.triangles
    mesh: Any = pyvista.PolyData.from_regular_faces(surface.points, triangles)
    line = mesh.slice(normal="z", origin=(0.0, 0.0, z))
    if line.n_cells == 0:
        return Pieces(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64))
    line = line.clean().connectivity("all")
    ends = line.lines.reshape(-1, 3)[:, 1:]
    points = np.asarray(line.points, np.float64)[:, :2]
    return Pieces(points[ends[:, 0]], points[ends[:, 1]], np.asarray(line.cell_data["RegionId"]))


class Chart(NamedTuple):
    """Coordinates of a slice: the place along the profile, and the function g across it."""

    femur: bool
    middle: Floats
    """Origin, shape (2,) [m]: centre of a femur's circle, middle of a tibia's plateau"""
    scale: float
    """Approximate length [m] of one unit of the place: radius of a femur's circle, or half the width of a plateau"""
    direction: float
    """Direction from a femur's centre to the middle of the profile [rad]"""

    @classmethod
    def around(cls, points: Floats, femur: bool) -> Chart:
        """Make the chart for points of shape (n, 2) [m]; a femur's has the centre of Coope's circle as origin."""
        if not femur:
            x, y = points.T
            middle = np.array([(x.min() + x.max()) / 2.0, y.mean()])
            return cls(False, middle, max(float(np.ptp(x)) / 2.0, 1e-9), 0.0)
        centre, radius = circle(points)
        x, y = (points - centre).mean(axis=0)
        return cls(True, centre, radius, math.atan2(y, x))

    def place(self, points: Floats) -> Floats:
        """Places along the profile from posterior to anterior, shape (n,): angles [rad], or half widths."""
        x, y = (points - self.middle).T
        angle = (np.arctan2(y, x) - self.direction + math.pi) % math.tau - math.pi
        return np.asarray(angle if self.femur else x / self.scale)

    def outwards(self, points: Floats) -> Floats:
        """Distances of points towards the joint [m], shape (n,): from a femur's centre, or heights."""
        x, y = (points - self.middle).T
        return np.asarray(np.hypot(x, y) if self.femur else y)

    def values(self, points: Floats) -> tuple[Floats, Floats]:
        """Values g of points, and the distance across the profile per unit of g there [m], shape (n,) each."""
        out = self.outwards(points)
        return (
            (self.scale / out, out**2 / self.scale)
            if self.femur
            else (out / self.scale, 0.0 * out + self.scale)
        )

    def columns(self, grid: Floats, v: Floats) -> Floats:
        """Columns g: the two straight lines, for which v = 0, and one for each column of v, shape (grid, 2 + n)."""
        if not self.femur:
            return np.column_stack([np.ones_like(grid), grid, _integral(grid, _integral(grid, v))])
        sine, cosine = (
            np.sin(grid)[:, None],
            np.cos(grid)[:, None],
        )  # g'' + g = v: the integral of sin(α - β) v(β)
        curved = sine * _integral(grid, cosine * v) - cosine * _integral(grid, sine * v)
        return np.column_stack([cosine, sine, curved])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points of the profile, shape (grid, 2) [m], from g on a grid of places."""
        if not self.femur:
            return self.middle + self.scale * np.column_stack([grid, g])
        angle = grid + self.direction
        return np.asarray(
            self.middle
            + (self.scale / g)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        )


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
        return self.points[own] if np.count_nonzero(own) >= LEAST_POINTS else self.points


def slices(surface: Surface, z: float, slab: float, femur: bool) -> Slices:
    """Select the articular side of a surface within `slab` [m] of the plane at `z` [m].

    Raises:
        UsageError: the plane misses the surface or hardly touches it.
    """
    if not len(surface.triangles):
        return _of_cloud(surface, z, slab)
    middle = cut(surface, z)
    if len(middle.begins) < LEAST_POINTS:
        what = "misses" if not len(middle.begins) else "hardly touches"
        raise UsageError(
            f"--slice {1e3 * z:g} {what} {surface.path}, which reaches from {surface.lateral_range}; or see --axes"
        )
    points, remarks = _articular(
        middle, Chart.around(np.concatenate([middle.begins, middle.ends]), femur)
    )
    chart = Chart.around(points, femur)
    places = chart.place(points)
    found, offsets = [points], [np.zeros(len(points))]
    planes = math.ceil(slab / DISTANCE)
    for step in range(1, planes + 1):
        beside = [
            _articular(cut(surface, z + side * slab * step / planes), chart)[0]
            for side in (-1.0, 1.0)
        ]
        if min(map(len, beside)) < LEAST_POINTS:
            remarks = [*remarks, f"the slab of {1e3 * slab:g} mm reaches beyond the surface"]
            break
        for side, piece in zip((-1.0, 1.0), beside, strict=True):
            at = chart.place(piece)
            found.append(piece[(at >= places.min()) & (at <= places.max())])
            offsets.append(np.full(len(found[-1]), side * step / planes))
    return Slices(np.concatenate(found), np.concatenate(offsets), tuple(remarks))


def _of_cloud(surface: Surface, z: float, slab: float) -> Slices:
    """Select the points of a cloud within `slab` [m] of `z` [m], or all points if there is no third column."""
    flat = not surface.points[:, 2].any()
    distance = np.zeros(len(surface.points)) if flat else surface.points[:, 2] - z
    inside = np.abs(distance) <= slab + 1e-9  # a plane at its edge, whatever the rounding
    if np.count_nonzero(inside) < LEAST_POINTS:
        raise UsageError(
            f"--slice {1e3 * z:g}: only {np.count_nonzero(inside)} points of {surface.path} lie within "
            f"{1e3 * slab:g} mm of it (--slab); it reaches from {surface.lateral_range}"
        )
    nearest = np.abs(distance).argmin()
    remarks = ["all points of a cloud are used: it must hold the articular side only"]
    if abs(distance[nearest]) > DISTANCE:
        z_there = 1e3 * surface.points[nearest, 2]
        remarks.append(
            f"no point lies within {1e3 * DISTANCE:g} mm of the slice; the nearest has z = {z_there:.2f} mm"
        )
    return Slices(
        surface.points[inside, :2], np.round(distance[inside] / (slab or 1.0), 6), tuple(remarks)
    )


def _articular(pieces: Pieces, chart: Chart) -> tuple[Floats, list[str]]:
    """Select the visible points of the line that is most visible from outside; also return remarks on the rest."""
    if not len(pieces.begins):
        return np.empty((0, 2)), []
    seen = _seen(0.5 * (pieces.begins + pieces.ends), pieces, chart)
    lengths = np.hypot(*(pieces.ends - pieces.begins).T)
    visible = np.bincount(pieces.numbers, weights=lengths * seen)
    best = int(visible.argmax())
    chosen = (pieces.numbers == best) & seen
    points = np.unique(np.concatenate([pieces.begins[chosen], pieces.ends[chosen]]), axis=0)
    if lengths.sum() - visible[best] <= LEAST_LENGTH:
        return points, []
    return points, [
        f"{1e3 * visible[best]:.1f} of {1e3 * lengths.sum():.1f} mm of the slice are used, the outer side of one "
        f"of {len(visible)} pieces; the rest lies behind it, or is apart from it"
    ]


def _seen(points: Floats, pieces: Pieces, chart: Chart) -> Any:
    """Whether no segment covers each of the points, shape (n, 2) [m], by more than `COVER` from outside; shape (n,)."""
    begin, end = chart.place(pieces.begins), chart.place(pieces.ends)
    out_begin, out_end = chart.outwards(pieces.begins), chart.outwards(pieces.ends)
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    usual = high - low < (
        math.pi if chart.femur else math.inf
    )  # a piece round the back of a femur covers nothing
    rise = (out_end - out_begin) / np.where(end == begin, 1.0, end - begin)
    seen = []
    for first in range(0, len(points), BLOCK):  # of many points at once, the table would be large
        part = points[first : first + BLOCK]
        place, out = chart.place(part)[:, None], chart.outwards(part)[:, None]
        covers = (
            (low <= place)
            & (place <= high)
            & usual
            & (out_begin + rise * (place - begin) > out + COVER)
        )
        seen.append(~covers.any(axis=1))
    return np.concatenate(seen)


def _integral(grid: Floats, columns: Floats) -> Floats:
    """Integrate each column from the beginning of the grid, by trapezoids; shape (grid, n)."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(columns, grid, axis=0, initial=0.0))


def circle(points: Floats) -> tuple[Floats, float]:
    """Fit a circle to points of shape (n, 2) [m] by least squares; return its centre, shape (2,), and radius [m].

    Coope's linear form: (x² + y²) = 2 a x + 2 b y + c. I. D. Coope 1993, J Optim Theory Appl 76:381-388.
    """
    middle = points.mean(axis=0)
    local = points - middle
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution = np.linalg.lstsq(rows, (local**2).sum(axis=1), rcond=None)[0]
    centre = solution[:2]
    return centre + middle, math.sqrt(max(float(solution[2] + centre @ centre), 0.0))
