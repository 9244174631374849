"""How a profile is written as a function g of one number, so that smoothing is linear.

Femur: polar, about the centre of its mean circle. g = R/r over the angle α; its curvature has the sign of v = g'' + g,
so that v > 0 is convexity, and v is constant for a circle about the centre. Tibia: height over x. g = y/L over x/L, and
v = g'' is free. v is what is smoothed.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from knee_contact_ros.core.arrays import Floats

LEAST_V = 0.01
"""Of a femur: a curvature of about this over R; a profile is convex throughout"""


class Chart(Protocol):
    """Coordinates of a slice."""

    @property
    def scale(self) -> float:
        """[m] that a unit of the place is long, about."""
        ...

    @property
    def half_turn(self) -> float:
        """A step of the place that only going round the back makes."""
        ...

    @property
    def least(self) -> float:
        """Lower bound of v."""
        ...

    @classmethod
    def around(cls, points: Floats) -> Chart:
        """The chart for points of shape (n, 2) [m]."""
        ...

    def place(self, points: Floats) -> Floats:
        """Along the profile, from posterior to anterior."""
        ...

    def outwards(self, points: Floats) -> Floats:
        """Towards the joint [m]."""
        ...

    def value(self, points: Floats) -> Floats:
        """The function g."""
        ...

    def metres(self, points: Floats) -> Floats:
        """What a unit of g amounts to across the profile [m], shape (n,)."""
        ...

    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """The columns g of columns v, shape (grid, n), which are 0 with their first derivative at the grid's begin."""
        ...

    def free(self, grid: Floats) -> Floats:
        """The two columns g that have v = 0, shape (grid, 2)."""
        ...

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points of shape (grid, 2) [m]."""
        ...


class _Polar(NamedTuple):
    centre: tuple[float, float]
    radius: float
    middle: float


class Polar(_Polar):
    """A femur's: the angle about a centre [rad], from the middle of the profile."""

    __slots__ = ()
    half_turn = math.pi
    least = LEAST_V

    @classmethod
    def around(cls, points: Floats) -> Polar:
        """Coope's circle; the middle is where most of the points lie."""
        centre, radius = circle(points)
        aside = (points - centre).mean(axis=0)
        return cls((float(centre[0]), float(centre[1])), radius, math.atan2(aside[1], aside[0]))

    @property
    def scale(self) -> float:
        """The radius."""
        return self.radius

    def place(self, points: Floats) -> Floats:
        """Counter-clockwise, which is from posterior over distal to anterior."""
        x, y = (points - np.array(self.centre)).T
        angle: Floats = (np.arctan2(y, x) - self.middle + math.pi) % math.tau - math.pi
        return angle

    def outwards(self, points: Floats) -> Floats:
        """Distance from the centre."""
        return np.asarray(np.hypot(*(points - np.array(self.centre)).T))

    def value(self, points: Floats) -> Floats:
        """R/r."""
        return np.asarray(self.radius / self.outwards(points))

    def metres(self, points: Floats) -> Floats:
        """|dr/dg| = r²/R."""
        return np.asarray(self.outwards(points) ** 2 / self.radius)

    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """The solution of g'' + g = v: the integral of sin(α - β) v(β)."""
        sine, cosine = np.sin(grid)[:, None], np.cos(grid)[:, None]
        return sine * integral(grid, cosine * v) - cosine * integral(grid, sine * v)

    def free(self, grid: Floats) -> Floats:
        """Straight lines."""
        return np.column_stack([np.cos(grid), np.sin(grid)])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points at the distance R/g."""
        angle = grid + self.middle
        return np.asarray(
            np.array(self.centre) + (self.radius / g)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        )


class _Flat(NamedTuple):
    middle: tuple[float, float]
    half: float


class Flat(_Flat):
    """A tibia's: x from the middle of the plateau in half widths."""

    __slots__ = ()
    half_turn = math.inf
    least = -math.inf

    @classmethod
    def around(cls, points: Floats) -> Flat:
        """The box around the points."""
        x, y = points.T
        return cls((float(x.min() + x.max()) / 2.0, float(y.mean())), max(float(np.ptp(x)) / 2.0, 1e-9))

    @property
    def scale(self) -> float:
        """Half the width."""
        return self.half

    def place(self, points: Floats) -> Floats:
        """To anterior."""
        return np.asarray((points[:, 0] - self.middle[0]) / self.half)

    def outwards(self, points: Floats) -> Floats:
        """Upwards."""
        return np.asarray(points[:, 1] - self.middle[1])

    def value(self, points: Floats) -> Floats:
        """Height."""
        return self.outwards(points) / self.half

    def metres(self, points: Floats) -> Floats:
        """The half width throughout; slopes of a plateau are small."""
        return np.full(len(points), self.half)

    def from_v(self, grid: Floats, v: Floats) -> Floats:
        """The double integral."""
        return integral(grid, integral(grid, v))

    def free(self, grid: Floats) -> Floats:
        """Straight lines."""
        return np.column_stack([np.ones_like(grid), grid])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points at the height g."""
        return np.array(self.middle) + self.half * np.column_stack([grid, g])


def integral(grid: Floats, columns: Floats) -> Floats:
    """From the grid's begin, column by column; trapezoids."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(columns, grid, axis=0, initial=0.0))


def circle(points: Floats) -> tuple[Floats, float]:
    """Centre and radius [m] of the circle of least squares through points of shape (n, 2) [m].

    Coope's linear form: (x² + y²) = 2 a x + 2 b y + c. I. D. Coope 1993, J Optim Theory Appl 76:381-388.
    """
    middle = points.mean(axis=0)
    local = points - middle
    solution = np.linalg.lstsq(np.column_stack([2.0 * local, np.ones(len(local))]), (local**2).sum(axis=1), rcond=None)[
        0
    ]
    centre = solution[:2]
    return centre + middle, math.sqrt(max(float(solution[2] + centre @ centre), 0.0))
