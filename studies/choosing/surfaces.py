"""The measured surfaces for the reference solution, written down once more: nothing of the package is used here.

Curves are SciPy's C2 cubic splines through the points of the CSV files, as docs/explanation/model.md says. The deepest
point is the best of a dense row of points of the femur, made exact by Newton's method on the conditions of the common
normal. Compiled, as a solution asks some million times.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]
Jet = tuple[float, float, float]
"""A value and its first and second derivative"""
F = TypeVar("F")

PER_SEGMENT = 8
"""Points of the dense row between two measured points"""
NEWTON_STEPS = 30
SMALL_STEP = 1e-12
"""Step [m] at which Newton's method has converged, as it squares its errors"""
FIRST_ORDER, SECOND_ORDER = 2e-5, 5.0
"""Errors of the dense row's distances: [m], and [1/m] times their square (curvature times squared slope)"""

RECENT = 8
"""Number of poses that are kept, as a solver needs the same one several times"""


def compiled(function: F) -> F:
    """Compile a function with Numba."""
    return cast("F", njit(cache=True)(function))


class Spline(NamedTuple):
    """Cubic spline of one coordinate over a parameter."""

    knots: Floats
    """Knots, shape (n,)"""
    coefficients: Floats
    """Coefficients, shape (4, n - 1), the cubic term first"""


class Femur(NamedTuple):
    """A condyle over its chord length, with a dense row of its points."""

    x: Spline
    y: Spline
    row: Floats
    """Chord lengths [m], shape (m,), and the points there [m]"""
    row_x: Floats
    row_y: Floats


class Normal(NamedTuple):
    """Common normal of femur and tibia at a pose."""

    depth: float
    """Depth along the normal [m]"""
    x: float
    """x of the femur's deepest point, relative to the reference point [m]"""
    y: float
    slope: float
    """Slope of the tibia at its point"""
    foot: float
    """x of the tibia's point [m]"""


def read_points(path: Path) -> Floats:
    """Read the columns of a profile's CSV file [m], shape (2, n)."""
    lines = [
        line
        for line in path.read_text(encoding="utf-8").splitlines()
        if line and not line.startswith("#")
    ]
    return np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]]).T


def spline_through(knots: Floats, values: Floats) -> Spline:
    """Build the C2 spline through knots, with SciPy's ends: the outer two cubics are one."""
    found = CubicSpline(knots, values)
    return Spline(found.x, np.ascontiguousarray(found.c))


def femur_through(points: Floats) -> Femur:
    """Build a condyle through points of shape (2, n) [m]."""
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points)))])
    row = np.interp(
        np.arange(PER_SEGMENT * (len(chords) - 1) + 1) / PER_SEGMENT,
        np.arange(len(chords)),
        chords,
    )
    x, y = spline_through(chords, points[0]), spline_through(chords, points[1])
    return Femur(
        x, y, row, np.array([at(x, s)[0] for s in row]), np.array([at(y, s)[0] for s in row])
    )


def plateau_through(points: Floats) -> Spline:
    """Build a tibial surface y(x) through points of shape (2, n) [m]."""
    return spline_through(points[0], points[1])


@compiled
def at(spline: Spline, place: float) -> Jet:
    """Value and derivatives of a spline at a place; the outer cubics extend beyond the ends."""
    i = min(
        max(int(np.searchsorted(spline.knots, place, side="right")) - 1, 0), len(spline.knots) - 2
    )
    c3, c2, c1, c0 = spline.coefficients[:, i]
    u = place - spline.knots[i]
    return (
        c0 + u * (c1 + u * (c2 + u * c3)),
        c1 + u * (2.0 * c2 + 3.0 * c3 * u),
        2.0 * c2 + 6.0 * c3 * u,
    )


@compiled
def plateau_at(plateau: Spline, x: float) -> Jet:
    """Height [m], slope and second derivative [1/m] of a plateau, which is straight beyond the ends."""
    edge = min(max(x, plateau.knots[0]), plateau.knots[-1])
    height, slope, bend = at(plateau, edge)
    return (height, slope, bend) if x == edge else (height + slope * (x - edge), slope, 0.0)


@compiled
def turned(femur: Femur, place: float, sine: float, cosine: float) -> tuple[Jet, Jet]:
    """Position of a place of the femur along the axes of the tibia, relative to the reference point [m]."""
    x0, x1, x2 = at(femur.x, place)
    y0, y1, y2 = at(femur.y, place)
    return (
        (cosine * x0 - sine * y0, cosine * x1 - sine * y1, cosine * x2 - sine * y2),
        (sine * x0 + cosine * y0, sine * x1 + cosine * y1, sine * x2 + cosine * y2),
    )


@compiled
def lowest(femur: Femur, angle: float) -> tuple[float, float]:
    """Lowest point of the femur relative to the reference point [m]."""
    sine, cosine = math.sin(angle), math.cos(angle)
    place = femur.row[np.argmin(sine * femur.row_x + cosine * femur.row_y)]
    for _ in range(NEWTON_STEPS):
        _, (_, slope, bend) = turned(femur, place, sine, cosine)
        place = min(max(place - slope / bend, 0.0), femur.row[-1])
        if abs(slope / bend) < SMALL_STEP:
            break
    (x, _, _), (y, _, _) = turned(femur, place, sine, cosine)
    return x, y


@compiled
def deepest(femur: Femur, plateau: Spline, angle: float, height: float) -> Normal:
    """Common normal at the femur's deepest point, with the reference point at a height [m] above x = 0."""
    sine, cosine = math.sin(angle), math.cos(angle)
    distances = np.empty_like(femur.row)
    for i in range(len(distances)):
        level, slope, _ = plateau_at(plateau, cosine * femur.row_x[i] - sine * femur.row_y[i])
        above = sine * femur.row_x[i] + cosine * femur.row_y[i] + height - level
        distances[i] = above / math.sqrt(1.0 + slope * slope)
    least = distances.min()
    most = least + FIRST_ORDER + SECOND_ORDER * least * least
    best = Normal(-math.inf, 0.0, 0.0, 0.0, 0.0)
    for i in range(1, len(distances) - 1):
        if distances[i] <= min(distances[i - 1], distances[i + 1], most):
            found = common_normal(femur, plateau, sine, cosine, height, femur.row[i])
            if found.depth > best.depth:
                best = found
    return best


@compiled
def common_normal(
    femur: Femur, plateau: Spline, sine: float, cosine: float, height: float, place: float
) -> Normal:
    """Find the common normal from a place of the femur, by Newton's method (Eqs. 4 and 5 of the paper)."""
    foot = turned(femur, place, sine, cosine)[0][0]
    for _ in range(NEWTON_STEPS):
        (x, x1, x2), (y, y1, y2) = turned(femur, place, sine, cosine)
        level, slope, bend = plateau_at(plateau, foot)
        over = y + height - level
        parallel, along = x1 * slope - y1, x - foot + over * slope
        a, b, c, d = x2 * slope - y2, x1 * bend, x1 + y1 * slope, over * bend - 1.0 - slope * slope
        determinant = a * d - b * c
        step, step_foot = (
            (parallel * d - along * b) / determinant,
            (along * a - parallel * c) / determinant,
        )
        place, foot = place - step, foot - step_foot
        if abs(step) + abs(step_foot) < SMALL_STEP:
            break
    (x, _, _), (y, _, _) = turned(femur, place, sine, cosine)
    level, slope, _ = plateau_at(plateau, foot)
    depth = ((x - foot) * slope - (y + height - level)) / math.sqrt(1.0 + slope * slope)
    return Normal(depth, x, y, slope, foot)


class OnPlane:
    """A measured femur on the level plane: the pose of `reference.ByHeight`."""

    def __init__(self, femur: Femur) -> None:
        self._lowest = lru_cache(maxsize=RECENT)(lambda angle: lowest(femur, angle))

    def __call__(self, angle: float, turn: float, height: float) -> tuple[float, float, float]:
        """Depth [m], its rate at rest [m/s], and n_y."""
        x, y = self._lowest(angle)
        return -y - height, -x * turn, 1.0

    def contact_x(self, angle: float, height: float) -> float:
        """Position x of the contact point on the tibia [m]."""
        return float(self._lowest(angle)[0])


class OnPlateau:
    """A measured femur on a measured plateau: the pose of `reference.ByHeight`."""

    def __init__(self, femur: Femur, plateau: Spline) -> None:
        self._deepest = lru_cache(maxsize=RECENT)(
            lambda angle, height: deepest(femur, plateau, angle, height)
        )

    def __call__(self, angle: float, turn: float, height: float) -> tuple[float, float, float]:
        """Depth [m], its rate at rest [m/s], and n_y."""
        found = self._deepest(angle, height)
        lean = 1.0 / math.sqrt(1.0 + found.slope * found.slope)
        return found.depth, -turn * lean * (found.slope * found.y + found.x), lean

    def contact_x(self, angle: float, height: float) -> float:
        """Position x of the contact point on the tibia [m]."""
        return float(self._deepest(angle, height).foot)
