"""Coordinates in which a profile is a function of one number, which makes smoothing a linear problem.

Femur: polar, about the centre of its mean circle. g = R/r over the angle α; its curvature has the sign of v = g'' + g,
so that v > 0 is convexity, and v is constant for a circle about the centre. Tibia: height over x. g = y/L over x/L, and
v = g'' is free.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...model.types import Floats


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
        if self.femur:
            return self.scale / out, out**2 / self.scale
        return out / self.scale, np.full_like(out, self.scale)

    def columns(self, grid: Floats, v: Floats) -> Floats:
        """Columns g: the two straight lines, for which v = 0, and one for each column of v, shape (grid, 2 + n)."""
        if not self.femur:
            return np.column_stack([np.ones_like(grid), grid, _integral(grid, _integral(grid, v))])
        # g'' + g = v: the integral of sin(α - β) v(β)
        sine = np.sin(grid)[:, None]
        cosine = np.cos(grid)[:, None]
        curved = sine * _integral(grid, cosine * v) - cosine * _integral(grid, sine * v)
        return np.column_stack([cosine, sine, curved])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points of the profile, shape (grid, 2) [m], from g on a grid of places."""
        if not self.femur:
            return self.middle + self.scale * np.column_stack([grid, g])
        angle = grid + self.direction
        outwards = np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(self.middle + (self.scale / g)[:, None] * outwards)


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


def _integral(grid: Floats, columns: Floats) -> Floats:
    """Integrate each column from the beginning of the grid, by trapezoids; shape (grid, n)."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(columns, grid, axis=0, initial=0.0))
