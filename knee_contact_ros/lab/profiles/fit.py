"""Fit a profile to the articular side of a slice, and describe the result.

The quantity v of the chart (`chart.py`) is a cubic B-spline with a penalty on its bends (P-splines: Eilers & Marx 1996,
Stat Sci 11:89-121); a femur's is kept positive. The deviation left with the smallest penalty is the slice's roughness
(noise and dents). The fit takes the largest penalty with which the deviation does not exceed the root sum of squares of
roughness and tolerance. So a mesh's noise changes how far the profile is from the slice, but not how smooth it is.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...model.types import MM, Floats
from ...system.errors import UsageError
from ..checks import Limits, refuse_outside
from .chart import Chart, circle
from .slices import CutLines, Slices, cut_surface, slices
from .surfaces import Surface

SMOOTHING_TOLERANCE = 0.05e-3
"""Default of the RMS distance from the slice that smoothing may add [m]"""
SLAB = 2e-3
"""Default of the slab's half thickness [m]"""
_LEAST_PENALTY = -5.0
"""Decimal logarithm of the smallest penalty; with a smaller one a profile would follow the mesh's noise. Tuned"""
_LARGEST_PENALTY = 4.0
"""Decimal logarithm of the largest penalty. Tuned"""
_FEMORAL_WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Windows of circles: ranges of the direction of the outward normal [deg], 0 straight down, > 0 posterior. This is the
flexion angle at which the place is in contact"""
_TIBIAL_WINDOWS = ((0.15, 0.75), (0.2, 0.8), (0.25, 0.75), (0.3, 0.7))
"""Windows of circles: ranges of the plateau's width as fractions, from posterior"""
_FEMORAL_ZONE = (-15.0, 70.0)
"""Directions of a femur's normal [deg] where gait touches"""
_TIBIAL_ZONE = (0.25, 0.75)
"""Fractions of a tibia's width where gait touches"""
_FLATTEST_FEMUR = 0.35
"""Smallest ratio of height to width of a femur's slice: a condyle has about 0.8, a plateau 0.1 to 0.2"""
GAIT_NORMALS = (0.0, 60.0)
"""Directions of the normal [deg] in contact in gait"""
_PLAUSIBLE_RADII = ((12.0, math.inf), (10.0, 50.0), (9.0, 40.0))
"""Generous ranges of a condyle's radii over `_FEMORAL_WINDOWS` [mm]: in a knee from MRI they are 20 to 84, 15 to 26 and
14 to 21 mm"""
_ROUGHEST = 1.0
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


class ProfileShape(NamedTuple):
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


class ProfileFit(NamedTuple):
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
    shape: ProfileShape
    circles: list[FittedCircle]
    thickness: Thickness | None
    remarks: tuple[str, ...]


def fit(
    surface: Surface,
    z: float,
    *,
    femur: bool = True,
    bone: Surface | None = None,
    tolerance: float = SMOOTHING_TOLERANCE,
    slab: float = SLAB,
) -> ProfileFit:
    """Fit a femur's or a tibia's profile to the slice of a surface at `z` [m]; see `smooth` for `tolerance` [m].

    Raises:
        UsageError: the slice is empty, is not a femur's or tibia's, or the bone is not behind the cartilage.
    """
    checks = _SliceChecks(surface, z, femur)
    slab_points = slices(surface, z, slab, femur)
    checks.check_outline(slab_points.raw)
    chart = Chart.around(slab_points.raw, femur)
    smoothed = smooth(slab_points, chart, tolerance)
    worst = int(np.abs(smoothed.deviations).argmax())
    off = MM * float(smoothed.deviations[worst])
    x, y = MM * smoothed.raw[worst]
    side = "outside of" if off > 0.0 else "behind"
    dent = f"{abs(off):.1f} mm {side} the profile at x = {x:.1f}, y = {y:.1f} mm"
    checks.check_distance(smoothed, tolerance, dent)
    shape = _shape_of(smoothed.points)
    circles = _circles(shape, femur)
    if femur:
        checks.check_condyle(shape, circles)
    elif z < 0.0:
        checks.check_medial_plateau(shape)
    cartilage = _thickness(shape, chart, bone, z) if bone is not None else None
    remarks = (*surface.remarks, *slab_points.remarks)
    if abs(off) >= 0.5:  # mm
        remarks = (*remarks, f"the slice lies {dent}: a dent or a step?")
    return ProfileFit(femur, z, slab, tolerance, smoothed, shape, circles, cartilage, remarks)


class _SliceChecks:
    """Refuses a slice that is no condyle or plateau."""

    def __init__(self, surface: Surface, z: float, femur: bool) -> None:
        """Check a slice at `z` [m] of a surface; a femur's or a tibia's."""
        kind = "condyle of a femur" if femur else "plateau of a tibia"
        self.where = f"{surface.path}: the slice at z = {MM * z:g} mm is no {kind}"
        self.femur = femur
        self.cure = surface.axes_cure

    def check_outline(self, points: Floats) -> None:
        """Check the points of the slice, shape (n, 2) [m]."""
        width, height = np.ptp(points, axis=0)
        limits = (_FLATTEST_FEMUR, math.inf) if self.femur else (0.0, _FLATTEST_FEMUR)
        cure = f"--side {'tibia' if self.femur else 'femur'}? (or see --axes and --slice)"
        self._check("its height over its width", height / max(width, 1e-9), "", limits, cure)
        if self.femur:
            middle = MM * float((points - circle(points)[0]).mean(axis=0)[1])
            what = "it looks up; the height of its points above its circle's centre"
            self._check(what, middle, "mm", (-math.inf, 0.0), self.cure)

    def check_distance(self, smoothed: Smoothed, tolerance: float, dent: str) -> None:
        """Check the distance of the slice from the profile; `dent` is the place where it is largest, as text."""
        cure = f"cut off parts that are not articular surface ({dent}), or see --slice, --side and --axes"
        what = "its RMS distance from any profile"
        self._check(what, MM * smoothed.roughness, "mm", (0.0, _ROUGHEST), cure)
        cure = (
            f"too few points around the slice to tell the profile ({dent}): see --slice and --slab"
        )
        what = "its RMS distance from the profile"
        self._check(what, MM * smoothed.rms, "mm", (0.0, _ROUGHEST + MM * tolerance), cure)

    def check_condyle(self, shape: ProfileShape, circles: list[FittedCircle]) -> None:
        """Check the directions and radii of a femur's profile."""
        exchanged = (
            "are front and back exchanged (then turn over two axes, as --axes=-x,y,-z; one alone makes a mirror "
            f"image)? {self.cure}"
        )
        begin, end = GAIT_NORMALS
        low, high = np.degrees([shape.normal.min(), shape.normal.max()])
        reach = f"with outward normals of {low:.0f}° to {high:.0f}° (0 down, > 0 posterior)"
        what = f"{reach}, the share of what touches in gait ({begin:g}° to {end:g}°)"
        share = (min(high, end) - max(low, begin)) / (end - begin)
        cure = "--slice through a condyle, or see --axes"
        # A condyle covers at least half of the directions that touch in gait.
        self._check(what, share, "", (0.5, 1.0), cure)
        what = f"{reach}, the reach in front beyond that behind"
        cure = f"is it the notch (--slice), or {exchanged}"
        # In a knee from MRI a condyle reaches 12 to 120 degrees further behind than in front; only near the notch it
        # reaches up to 33 further in front.
        self._check(what, -low - high, "°", (-math.inf, 40.0), cure)
        radii = {each.window: MM * each.radius for each in circles}
        for window, limits in zip(_FEMORAL_WINDOWS, _PLAUSIBLE_RADII, strict=True):
            if window in radii:
                what = f"its radius over normals of {window[0]:.0f}° to {window[1]:.0f}°"
                self._check(what, radii[window], "mm", limits, f"is --unit right? {self.cure}")
        ratio = radii.get(_FEMORAL_WINDOWS[-1], 0.0) / radii.get(_FEMORAL_WINDOWS[0], math.inf)
        what = "its rear radius over that near extension"
        # From MRI the ratio is 0.2 to 0.8.
        self._check(what, ratio, "", (0.0, 1.2), exchanged)

    def check_medial_plateau(self, shape: ProfileShape) -> None:
        """Check the profile of a medial tibia."""
        cure = (
            f"a medial one (z < 0) is hollow: is it upside down, or the lateral one? {self.cure}"
        )
        largest = float(shape.curvature.max())
        self._check("its largest concave curvature", largest, "1/m", (0.0, math.inf), cure)

    def _check(self, what: str, value: float, unit: str, limits: Limits, cure: str) -> None:
        refuse_outside(self.where, what, value, unit, limits, cure)


def smooth(slab: Slices, chart: Chart, tolerance: float) -> Smoothed:
    """Smooth a slice so that its RMS distance is at most the root sum of squares of its roughness and `tolerance` [m].

    This is linear least squares with a penalty and lower bounds, scaled so that residuals are in m. Tilt and bend
    across the slab are also unknown, but not part of the profile; they are left out where the offsets do not tell.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.optimize import lsq_linear

    place = chart.place(slab.points)
    low = float(place.min())
    high = float(place.max())
    grid = np.linspace(low, high, 2001)
    # Knots of v are 2.5 mm apart, those of the tilt across the slab 10 mm. Tuned; see test_profiles.py.
    v = _b_splines(grid, low, high, 2.5e-3 / chart.scale)
    basis = chart.columns(grid, v)
    values, metres = chart.values(slab.points)
    columns = [make_interp_spline(grid, basis, k=1)(place)]  # linear in between
    tilt = _b_splines(place, low, high, 10e-3 / chart.scale)
    # The bend across the slab is a cubic polynomial of the place.
    bend = np.polynomial.legendre.legvander(2.0 * (place - low) / (high - low) - 1.0, 3)
    powers = np.vander(slab.offsets / (np.abs(slab.offsets).max() or 1.0), 3, increasing=True)
    for power, across in enumerate((tilt, bend), 1):
        # Tilt and bend can be told apart from the profile where this is small: it is 4 for points all over the slab,
        # 3 for three planes, and infinite for a bend over two planes or a tilt over a single one.
        if np.linalg.cond(powers[:, : power + 1]) < 10.0:
            columns.append(slab.offsets[:, None] ** power * across)
    data = np.concatenate(columns, axis=1) * metres[:, None]
    bends = np.diff(np.eye(v.shape[1]), 2, axis=0)
    of_v = slice(2, 2 + v.shape[1])
    penalty = np.zeros((len(bends), data.shape[1]))
    penalty[:, of_v] = bends * chart.scale
    lower = np.full(data.shape[1], -np.inf)
    if chart.femur:
        # This keeps a femur's profile convex: the curvature is at least about this over R.
        lower[of_v] = 0.01
    orthogonal, triangle = np.linalg.qr(data)  # the same problem in as many rows as unknowns
    target = orthogonal.T @ (values * metres)
    rest = float(np.sum((values * metres - orthogonal @ target) ** 2))
    wanted = np.concatenate([target, np.zeros(len(penalty))])

    def solve(logarithm: float) -> tuple[Floats, float]:
        """Return unknowns for a penalty of 10^logarithm per point, and the RMS distance [m] of the slab's points."""
        rows = np.concatenate([triangle, math.sqrt(10.0**logarithm * len(place)) * penalty])
        found: Any = lsq_linear(rows, wanted, bounds=(lower, np.inf), method="bvls")
        squares = float(np.sum((triangle @ found.x - target) ** 2)) + rest
        return found.x, math.sqrt(squares / len(place))

    roughness = solve(_LEAST_PENALTY)[1]
    allowed = math.hypot(roughness, tolerance)
    best = _LARGEST_PENALTY
    if solve(_LARGEST_PENALTY)[1] > allowed:
        best = _LEAST_PENALTY
        too_smooth = _LARGEST_PENALTY
        for _ in range(12):
            middle = 0.5 * (best + too_smooth)
            if solve(middle)[1] <= allowed:
                best = middle
            else:
                too_smooth = middle
    unknowns, deviation = solve(best)
    curve = chart.curve(grid, basis @ unknowns[: basis.shape[1]])
    raw = slab.raw[np.argsort(chart.place(slab.raw))]
    deviations = _deviations(raw, curve, chart)
    return Smoothed(_evenly(curve), raw, deviations, roughness, deviation)


def _evenly(curve: Floats) -> Floats:
    """Return points at equal steps along a curve of shape (n, 2) [m]."""
    length = _chord_length(curve)
    # At most 0.75 mm; on a curve beyond 1 m they are larger, so that the number of points does not grow.
    steps = math.ceil(min(1.0, length[-1]) / 0.75e-3)
    places = np.linspace(0.0, length[-1], steps + 1)
    return np.column_stack([np.interp(places, length, axis) for axis in curve.T])


def _deviations(points: Floats, curve: Floats, chart: Chart) -> Floats:
    """Return the distances [m] of points from a curve, shape (n,), > 0 outside of it."""
    from scipy.spatial import cKDTree

    nearest = np.clip(cKDTree(curve).query(points)[1], 1, len(curve) - 2)
    along = curve[nearest + 1] - curve[nearest - 1]
    offset = points - curve[nearest]
    across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.hypot(*along.T)
    there = np.interp(chart.place(points), chart.place(curve), chart.outwards(curve))
    return np.asarray(np.copysign(across, chart.outwards(points) - there))


def _b_splines(places: Floats, low: float, high: float, spacing: float) -> Floats:
    """Return values of cubic B-splines on equally spaced knots from `low` to `high`, shape (places, n)."""
    from scipy.interpolate import BSpline

    pieces = max(3, math.ceil((high - low) / spacing))
    knots = low + (high - low) / pieces * np.arange(-3, pieces + 4)
    inside = np.clip(places, low, high - 1e-12 * (high - low))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


def _chord_length(points: Floats) -> Floats:
    """Return the length along the chords from the first of points of shape (n, 2) [m] to each, shape (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _shape_of(points: Floats) -> ProfileShape:
    """Evaluate the cubic spline over chord length through points of shape (n, 2) [m], as the model does."""
    from scipy.interpolate import CubicSpline

    length = _chord_length(points)
    spline = CubicSpline(length, points)
    places = np.linspace(0.0, length[-1], 10 * (len(points) - 1) + 1)
    (x1, y1), (x2, y2) = spline(places, 1).T, spline(places, 2).T
    normal = -np.unwrap(np.arctan2(y1, x1))
    normal -= 2.0 * np.pi * np.round(np.median(normal) / (2.0 * np.pi))
    return ProfileShape(spline(places), (x1 * y2 - y1 * x2) / np.hypot(x1, y1) ** 3, normal)


def _circles(shape: ProfileShape, femur: bool) -> list[FittedCircle]:
    """Fit circles over `_TIBIAL_WINDOWS`, or over those `_FEMORAL_WINDOWS` that the profile covers."""
    x = MM * shape.points[:, 0]
    along = np.degrees(shape.normal) if femur else x
    windows: Any = _FEMORAL_WINDOWS
    if not femur:
        windows = x.min() + np.array(_TIBIAL_WINDOWS) * np.ptp(x)
    circles = []
    for low, high in windows:
        part = shape.points[(along >= low) & (along <= high)]
        if len(part) >= 8 and along.min() <= low + 1.0 and along.max() >= high - 1.0:
            centre, radius = circle(part)
            convex = not femur and centre[1] <= part[:, 1].mean()
            circles.append(FittedCircle((low, high), -radius if convex else radius, part))
    return circles


def concave(shape: ProfileShape) -> list[tuple[float, float]]:
    """Return the ranges of x [m] in which a tibia's profile is concave."""
    inside = np.concatenate([[0], shape.curvature > 0.0, [0]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(inside))
    x = shape.points[:, 0]
    return [(float(x[a]), float(x[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _thickness(shape: ProfileShape, chart: Chart, bone: Surface, z: float) -> Thickness:
    """Measure the thickness at the places of a shape, from the bone cut at `z` [m]."""
    if not len(bone.triangles):
        raise UsageError(
            f"--bone {bone.path}: it must be a mesh or a label map, not a cloud of points"
        )
    lines = cut_surface(bone, z)
    if not len(lines.begins):
        raise UsageError(
            f"--slice {MM * z:g} misses --bone {bone.path}, which reaches from {bone.lateral_range}"
        )
    along = _distances(lines, shape.points)
    x = shape.points[:, 0]
    reach = np.degrees(shape.normal) if chart.femur else (x - x.min()) / np.ptp(x)
    first, last = _FEMORAL_ZONE if chart.femur else _TIBIAL_ZONE
    zone = (reach >= first) & (reach <= last)
    if not zone.any():
        raise UsageError(
            "--bone: the profile does not reach the zone that touches in gait, so the thickness is not known"
        )
    mean = float(along[zone].mean())
    middles = 0.5 * (lines.begins + lines.ends)
    points = shape.points[zone]
    nearest = np.abs(chart.place(points)[:, None] - chart.place(middles)).argmin(axis=1)
    outside = float(np.mean(chart.outwards(middles)[nearest] > chart.outwards(points)))
    # The bone may lie outside at a tenth of the places, as meshes cross at the rims. Knee cartilage has about 2 mm,
    # that of the patella up to 7 mm.
    if outside > 0.1 or mean > 0.012:
        raise UsageError(
            f"--bone {bone.path} is not behind the cartilage (distance {MM * mean:.1f} mm on average): "
            "MESH must be the cartilage's surface, --bone the bone's, both in the same axes and --unit"
        )
    return Thickness(along, mean, np.stack([lines.begins, lines.ends], axis=1))


def _distances(lines: CutLines, points: Floats) -> Floats:
    """Return the distance [m] of each point from the nearest segment, shape (n,)."""
    along = lines.ends - lines.begins
    offset = points[:, None, :] - lines.begins
    squared_length = np.maximum((along**2).sum(axis=1), 1e-30)
    share = np.clip((offset * along).sum(axis=2) / squared_length, 0.0, 1.0)
    squares = ((offset - share[..., None] * along) ** 2).sum(axis=2)
    return np.asarray(np.sqrt(squares.min(axis=1)))
