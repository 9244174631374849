"""Find the smoothest profile that stays within a stated tolerance of a slice.

The quantity v of `charts` is a cubic B-spline with a penalty on its bends (P-splines: Eilers & Marx 1996, Stat Sci
11:89-121); a femur's is kept positive. The deviation that is left with hardly a penalty is the slice's roughness (noise
and dents). The penalty is the largest with which the deviation is no more than roughness and tolerance together, added
as independent errors are. So the noise of a mesh changes how far the profile is from the slice, but not how smooth it
is.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.tools.profiles.charts import Chart, chord_length
from knee_contact_ros.tools.profiles.slices import Slices

KNOTS = 2.5e-3
"""Distance between the knots of v [m]"""
TILT_KNOTS = 10e-3
"""Distance between the knots of the tilt across the slab [m]"""
BENDS = 3
"""Polynomial degree of the bend across the slab, as a function of the place"""
GRID = 2001
ROUGHEST, SMOOTHEST = -5.0, 4.0
"""Decadic logarithms of the penalty; with less than the first, a profile follows the noise of a mesh"""
HALVINGS = 12
SPACING = 0.75e-3
"""Distance between the points of a profile [m]"""


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
    """Columns g on the grid for every unknown but those of tilt and bend across the slab"""
    grid: Floats
    """Places"""


def smooth(slab: Slices, chart: Chart, tolerance: float) -> Smoothed:
    """Smooth a slice so that its RMS distance is at most its roughness and `tolerance` [m], added as squares."""
    problem = pose(slab, chart)
    roughness = residual(problem, solve(problem, ROUGHEST))
    allowed = math.hypot(roughness, tolerance)
    low, high = ROUGHEST, SMOOTHEST
    if residual(problem, solve(problem, high)) > allowed:
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            within = residual(problem, solve(problem, middle)) <= allowed
            low, high = (middle, high) if within else (low, middle)
    else:
        low = high
    unknowns = solve(problem, low)
    curve = chart.curve(problem.grid, problem.basis @ unknowns[: problem.basis.shape[1]])
    raw = slab.raw[np.argsort(chart.place(slab.raw))]
    deviations = distances(raw, curve, chart)
    return Smoothed(evenly(curve), raw, deviations, roughness, residual(problem, unknowns))


def pose(slab: Slices, chart: Chart) -> _Problem:
    """Set up the least-squares problem of a slice."""
    from scipy.interpolate import make_interp_spline

    place = chart.place(slab.points)
    low, high = float(place.min()), float(place.max())
    grid = np.linspace(low, high, GRID)
    v = b_splines(grid, low, high, KNOTS / chart.scale)
    basis = np.column_stack([chart.free(grid), chart.from_v(grid, v)])
    metres = chart.metres(slab.points)[:, None]
    columns = [make_interp_spline(grid, basis, k=1)(place)]  # linear in between
    if slab.offsets.any():
        tilt = b_splines(place, low, high, TILT_KNOTS / chart.scale)
        turn = np.polynomial.legendre.legvander(2.0 * (place - low) / (high - low) - 1.0, BENDS)
        columns += [slab.offsets[:, None] * tilt, slab.offsets[:, None] ** 2 * turn]
    data = np.concatenate(columns, axis=1) * metres
    bends = np.diff(np.eye(v.shape[1]), 2, axis=0)
    penalty = np.zeros((len(bends), data.shape[1]))
    penalty[:, 2 : 2 + v.shape[1]] = bends * chart.scale
    lower = np.full(data.shape[1], -np.inf)
    lower[2 : 2 + v.shape[1]] = chart.least
    values = chart.value(slab.points) * metres[:, 0]
    orthogonal, triangle = np.linalg.qr(data)
    target = orthogonal.T @ values
    rest = float(np.sum((values - orthogonal @ target) ** 2))
    return _Problem(triangle, target, rest, len(values), penalty, lower, basis, grid)


def b_splines(places: Floats, low: float, high: float, spacing: float) -> Floats:
    """Values of cubic B-splines on equally spaced knots from `low` to `high`, shape (places, n)."""
    from scipy.interpolate import BSpline

    pieces = max(3, math.ceil((high - low) / spacing))
    knots = low + (high - low) / pieces * np.arange(-3, pieces + 4)
    inside = np.clip(places, low, high - 1e-12 * (high - low))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


def solve(problem: _Problem, logarithm: float) -> Floats:
    """Solve the problem for a penalty of 10^logarithm per point; return the unknowns."""
    from scipy.optimize import lsq_linear

    weight = math.sqrt(10.0**logarithm * problem.points)
    rows = np.concatenate([problem.data, weight * problem.penalty])
    target = np.concatenate([problem.target, np.zeros(len(problem.penalty))])
    # The same problem in as many rows as unknowns.
    orthogonal, triangle = np.linalg.qr(rows)
    target = orthogonal.T @ target
    free = np.linalg.lstsq(triangle, target, rcond=None)[0]
    if (free >= problem.lower).all():
        return np.asarray(free)
    bounded: Any = lsq_linear(triangle, target, bounds=(problem.lower, np.inf), method="bvls")
    return np.asarray(bounded.x)


def residual(problem: _Problem, unknowns: Floats) -> float:
    """RMS distance [m] of the slab's points from the profile, not counting tilt and bend across the slab."""
    reached = float(np.sum((problem.data @ unknowns - problem.target) ** 2))
    return math.sqrt((reached + problem.rest) / problem.points)


def distances(points: Floats, curve: Floats, chart: Chart) -> Floats:
    """Shortest distances [m] of points from a curve, shape (n,), > 0 outside of it."""
    from scipy.spatial import cKDTree

    nearest = np.clip(cKDTree(curve).query(points)[1], 1, len(curve) - 2)
    along = curve[nearest + 1] - curve[nearest - 1]
    offset = points - curve[nearest]
    across = np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.hypot(*along.T)
    out = chart.outwards(points) - np.interp(chart.place(points), chart.place(curve), chart.outwards(curve))
    return np.asarray(np.copysign(across, out))


def evenly(curve: Floats) -> Floats:
    """Points of a curve at equal steps of arc length, `SPACING` [m] or a little less; shape (n, 2) [m]."""
    way = chord_length(curve)
    places = np.linspace(0.0, way[-1], math.ceil(way[-1] / SPACING) + 1)
    return np.column_stack([np.interp(places, way, axis) for axis in curve.T])
