"""Charts: coordinates in which a profile is a function g of a single number, so that smoothing it is a linear problem.

Femur: polar, about the centre of its mean circle. g = R/r over the angle α; its curvature has the sign of v = g'' + g,
so that v > 0 is convexity, and v is constant for a circle about the centre. Tibia: height over x. g = y/L over x/L, and
v = g'' is free. The smoothed quantity is v.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from knee_contact_ros.model.types import Floats

LEAST_V = 0.01
"""Lower bound of v for a femur: a curvature of about this over R, so that a profile is convex throughout"""


@dataclass(frozen=True)
class Chart(ABC):
    """Coordinates of a slice: a place along the profile, and the function g across it."""

    middle: Floats
    """Origin of the chart, shape (2,) [m]: centre of a femur's circle, middle of a tibia's plateau"""
    scale: float
    """Length of a unit of the place, about [m]: radius of a femur's circle, half the width of a tibia's plateau"""
    half_turn: ClassVar[float]
    """Smallest step of the place that only a piece round the back of a closed slice makes"""
    least: ClassVar[float]
    """Lower bound of v"""

    @classmethod
    @abstractmethod
    def around(cls, points: Floats) -> Chart:
        """Make the chart for points of shape (n, 2) [m]."""

    @abstractmethod
    def place(self, points: Floats) -> Floats:
        """Places along the profile, increasing from posterior to anterior, shape (n,)."""

    @abstractmethod
    def outwards(self, points: Floats) -> Floats:
        """Distances of points towards the joint [m], shape (n,)."""

    @abstractmethod
    def value(self, points: Floats) -> Floats:
        """Values of the function g at points, shape (n,)."""

    @abstractmethod
    def metres(self, points: Floats) -> Floats:
        """Distances across the profile that correspond to a unit of g at points [m], shape (n,)."""

    @abstractmethod
    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """Columns g for columns v, shape (grid, n), zero with zero slope at the beginning of the grid."""

    @abstractmethod
    def free(self, grid: Floats) -> Floats:
        """The two columns g for which v = 0, shape (grid, 2): straight lines."""

    @abstractmethod
    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points of the profile, shape (grid, 2) [m], from g on a grid of places."""


@dataclass(frozen=True)
class Polar(Chart):
    """Chart of a femur: the place is the angle about a centre [rad], counted from the middle of the profile."""

    turn: float
    """Direction from the centre to the middle of the profile [rad]"""
    half_turn = math.pi
    least = LEAST_V

    @classmethod
    def around(cls, points: Floats) -> Polar:
        """Make the chart about the centre of Coope's circle; its middle is where most of the points lie."""
        centre, radius = circle(points)
        offset = (points - centre).mean(axis=0)
        return cls(centre, radius, math.atan2(offset[1], offset[0]))

    def place(self, points: Floats) -> Floats:
        """Angles counter-clockwise, which is from posterior over distal to anterior."""
        x, y = (points - self.middle).T
        angle: Floats = (np.arctan2(y, x) - self.turn + math.pi) % math.tau - math.pi
        return angle

    def outwards(self, points: Floats) -> Floats:
        """Distances r from the centre [m]."""
        return np.asarray(np.hypot(*(points - self.middle).T))

    def value(self, points: Floats) -> Floats:
        """Values g = R/r."""
        return np.asarray(self.scale / self.outwards(points))

    def metres(self, points: Floats) -> Floats:
        """Distances |dr/dg| = r²/R [m]."""
        return np.asarray(self.outwards(points) ** 2 / self.scale)

    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """Solution of g'' + g = v: the integral of sin(α - β) v(β)."""
        sine, cosine = np.sin(grid)[:, None], np.cos(grid)[:, None]
        return sine * integral(grid, cosine * v) - cosine * integral(grid, sine * v)

    def free(self, grid: Floats) -> Floats:
        """Cosine and sine, which are straight lines in this chart."""
        return np.column_stack([np.cos(grid), np.sin(grid)])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points at the distance R/g from the centre."""
        angle = grid + self.turn
        return np.asarray(self.middle + (self.scale / g)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


@dataclass(frozen=True)
class Flat(Chart):
    """Chart of a tibia: the place is x from the middle of the plateau, in half widths."""

    half_turn = math.inf
    least = -math.inf

    @classmethod
    def around(cls, points: Floats) -> Flat:
        """Make the chart about the middle of the box around the points."""
        x, y = points.T
        return cls(np.array([(x.min() + x.max()) / 2.0, y.mean()]), max(float(np.ptp(x)) / 2.0, 1e-9))

    def place(self, points: Floats) -> Floats:
        """Places towards anterior, -1 to 1."""
        return np.asarray((points[:, 0] - self.middle[0]) / self.scale)

    def outwards(self, points: Floats) -> Floats:
        """Heights above the middle [m]."""
        return np.asarray(points[:, 1] - self.middle[1])

    def value(self, points: Floats) -> Floats:
        """Heights in half widths."""
        return self.outwards(points) / self.scale

    def metres(self, points: Floats) -> Floats:
        """The half width for every point, as the slopes of a plateau are small."""
        return np.full(len(points), self.scale)

    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """Solution of g'' = v: the double integral."""
        return integral(grid, integral(grid, v))

    def free(self, grid: Floats) -> Floats:
        """One and the place, which are straight lines."""
        return np.column_stack([np.ones_like(grid), grid])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points at the height g."""
        return self.middle + self.scale * np.column_stack([grid, g])


def integral(grid: Floats, columns: Floats) -> Floats:
    """Integrate each column from the beginning of the grid, by trapezoids; shape (grid, n)."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(columns, grid, axis=0, initial=0.0))


def chord_length(points: Floats) -> Floats:
    """Length along the chords from the first of points of shape (n, 2) [m] to each, shape (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


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
