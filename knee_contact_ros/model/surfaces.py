"""Contact pairs: a femoral surface over a tibial one, and where they are closest or overlap most.

Generalized contact kinematics of the paper, Eqs. 1 to 6: at the two points of closest approach the normals are parallel
(n x n' = 0) and the vector between the points lies along them (d x n = 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from knee_contact_ros.model.compiler import in_kernel, inlined
from knee_contact_ros.model.mechanisms import Mechanism, translation
from knee_contact_ros.model.profiles import (
    NOTHING,
    NOWHERE,
    SHRUNK,
    Circle,
    Profile,
    Table,
    support_at,
)
from knee_contact_ros.model.types import Floats, Integers

__all__ = ["Circle", "Closest", "ContactPair", "Cup", "Plane", "Plateau", "Profile"]
ON_PLANE, IN_CUP, ON_CURVE = 0, 1, 2
"""Kinds of contact pairs"""
COSINE, SINE = 0.5, math.sqrt(0.75)
"""Cosine and sine of a cup's half angle, 60 degrees: far beyond any plateau, and the surface stays open upwards"""
LEVELS: Floats = 1e-3 * np.array(
    [-35, -22, -13, -7, -3.5, -1.5, -0.5, 0, 0.5, 1, 1.7, 2.5, 3.5, 10]
)
"""Depths [m] for which starts are tabulated"""
WIDTH, WIDER = 0.0125, 8.0
"""Width [rad] of that table's columns of angles, and the factor for the wider columns on both sides"""
OUTSIDE, INSIDE, FIRST_ANGLE = 100, 272, -0.6
"""Numbers of wide columns on each side and of others between, which begin at `FIRST_ANGLE` [rad]"""
BEYOND: Floats = WIDER * np.arange(OUTSIDE + 1, dtype=np.float64)
EDGES: Floats = FIRST_ANGLE + WIDTH * np.concatenate(
    [-BEYOND[:0:-1], np.arange(INSIDE), BEYOND + INSIDE]
)
"""Edges of the columns [rad]"""
SLACK, SLACK_OF_ALL = 0.1, 2e-5
"""A place may be the deepest inside a cell if it is less deep by this at a corner [m]: per distance, and always"""
APART, OUTWARD = 4e-4, 1e-4
"""Distance [m] above which tibial places are two starts; first step [m] of a search by halving"""
STEEPEST = 1.4
"""Largest slope angle [rad] of a tibia that is searched for contacts"""
MOST_STEPS, MOST_HALVES = 40, 80
"""Largest numbers of Newton steps and of halvings"""
FAR = 1.0
"""Height [m] beyond which no contact is searched: only a diverged iterate gets there"""
STEP, PARTS = 5e-5, 8
"""Distance of the envelopes' and the tibia's points [m]; number of points in a femoral segment"""
ARC_POINTS, BALLS, SAFE = 1201, 6, 0.8
"""Number of points of a cup's spline; of balls in a tibial piece, and part of their radii that is safe"""
TAILS: Floats = np.geomspace(1e-4, 0.1, 20)
"""Places [m] beyond the measured tibia against which balls are checked"""
LAST_STEP, LAST_BUMPY, FINEST = 5e-7, 1e-7, 1e-14
"""Newton's step [m] after which the error is a rounding error, and that of bumpy surfaces; where halving ends [m]"""
LONGEST, SHORT, PER_DISTANCE = 1e-3, 1e-4, 0.05
"""Largest step [m] of surfaces in contact; of bumpy ones, so that it leads to no other bump; and more, of a distance"""
NO_TABLE = Table(NOTHING, NOWHERE, NOTHING, NOTHING, NOTHING[0, :0])
OUTLINE_POINTS = 201
"""Number of points of an outline, besides the measured ones"""


class Closest(NamedTuple):
    """The common normal of femur and tibia in one pose, in the tibia frame; the unit n points from tibia to femur."""

    depth: float
    """Signed penetration depth along n [m]: > 0 in overlap, < 0 apart"""
    extent: float
    """Distance of the femur's deepest point from the reference point, against n [m]: -r·n"""
    turning: float
    """Change of the depth when the femur turns about its reference point [m/rad]: -r·t, with t = (n_y, -n_x)"""
    normal_x: float
    """x of the unit normal n"""
    normal_y: float
    """y of the unit normal n"""

    def point(self, x: float, height: float) -> tuple[float, float]:
        """Return the contact point on the tibia [m], for the femoral reference point at (x, height) [m]."""
        along, across = -self.turning, self.depth - self.extent
        return (
            x + along * self.normal_y + across * self.normal_x,
            height - along * self.normal_x + across * self.normal_y,
        )


class Surfaces(NamedTuple):
    """A contact pair in the form that the kernel takes, of the same types for every pair."""

    kind: int
    """`ON_PLANE`, `IN_CUP` or `ON_CURVE`"""
    slope: float
    """Slope of a plane tibia [rad]"""
    sine: float
    cosine: float
    """Sine and cosine of that slope"""
    femoral_radius: float
    tibial_radius: float
    """Radii of a circle and a cup [m], else 0"""
    cells: Floats
    begins: Integers
    starts: Floats
    cubics: Floats
    """On a plane, as in `profiles.Table`; on a curved tibia, the table of `_starts`"""
    kinks: Floats
    """Flexion angles in [0, 2π) [rad], increasing, at which the depth's rate on a plane jumps"""
    pieces: Floats
    """The mechanism; see `Mechanism`"""
    tibia: Floats
    """Shape (n, 6): a curved tibia: start [m] and c0 to c3 of y = c0 + u (c1 + u (c2 + u c3)) with u = x - start, as in
    `Mechanism`, and the radius [m] of a ball that touches the piece from below and lies below all of the surface"""
    non_convex: float
    """1 if the contact may leap between bumps at angles that `next_kink` does not know, else 0"""
    knot_spacing: float
    """Mean turn [rad] between two points where the femur is not smooth; infinite if it is"""
    largest_radius: float
    """Upper bound of the distance [m] of the femur's points from its reference point"""
    largest_slope: float
    """Upper bound of the mechanism's |dx/dangle| [m/rad]"""
    largest_bend: float
    """Upper bound of the mechanism's |d²x/dangle²| [m/rad²]"""
    concave: float
    """Upper bound of the tibia's curvature [1/m], >= 0"""


@inlined
def touch(
    surfaces: Surfaces, angle: float, angle_rate: float, height: float
) -> tuple[float, float, float]:
    """Return signed depth [m], its rate at a held height [m/s], and n_y, at an angle [rad], its rate and a height [m].

    The rate of the depth is the second number minus n_y times the height's velocity. The force along the height is n_y
    times the contact force.
    """
    x, x_slope = translation(surfaces.pieces, angle)
    depth, _, turning, normal_x, normal_y = closest(surfaces, angle, x, height)
    return depth, turning * angle_rate - normal_x * (x_slope * angle_rate), normal_y


@inlined
def closest(
    surfaces: Surfaces, angle: float, x: float, height: float
) -> tuple[float, float, float, float, float]:
    """Return the fields of `Closest` for the reference point at (x, height) [m].

    On a plane the depth is h - n·(x, height), where h is the femur's support at the angle minus the slope.
    """
    if surfaces.kind != ON_PLANE:
        return common_normal(surfaces, angle, x, height)
    sine, cosine, h, turning = surfaces.sine, surfaces.cosine, surfaces.femoral_radius, 0.0
    if h == 0.0:
        turned = angle - surfaces.slope
        h, turning = support_at(
            surfaces.cells, surfaces.begins, surfaces.starts, surfaces.cubics, turned
        )
    return h + x * sine - cosine * height, h, turning, -sine, cosine


@in_kernel
def common_normal(
    surfaces: Surfaces, angle: float, x: float, height: float
) -> tuple[float, float, float, float, float]:
    """Return the fields of `Closest` on a curved tibia: the deepest of the contacts found from some starts.

    From each start Newton's method finds a common normal. If it does not reach a smallest distance, or if its foot may
    not be the nearest one to a point below the surface, a search by halving takes over.
    """
    if (
        surfaces.kind == IN_CUP
    ):  # the circle's deepest point is in the direction of its centre's nearest tibial point
        radius, below = surfaces.tibial_radius, surfaces.tibial_radius - height
        if COSINE * abs(x) >= SINE * below:
            distance = COSINE * height - SINE * abs(x) + (1.0 - COSINE) * radius
            normal_x, normal_y = -math.copysign(SINE, x), COSINE
        else:
            from_centre = math.sqrt(x * x + below * below)
            distance = (height * (radius + below) - x * x) / (radius + from_centre)
            normal_x, normal_y = -x / from_centre, below / from_centre
        return surfaces.femoral_radius - distance, surfaces.femoral_radius, 0.0, normal_x, normal_y
    turned = (
        0.0 if surfaces.femoral_radius > 0.0 else angle
    )  # a circle looks the same from everywhere
    sine, cosine, cubics, tibia = (
        math.sin(turned),
        math.cos(turned),
        surfaces.cubics,
        surfaces.tibia,
    )
    heights = surfaces.cells
    part, row, rows = (angle - FIRST_ANGLE) / WIDTH, 0, heights.shape[1] - 1
    part += (max(part - INSIDE, 0.0) + min(part, 0.0)) * (1.0 / WIDER - 1.0)
    column = max(min(int(part + OUTSIDE), len(heights) - 1), 0)
    while row < rows - 1 and height < heights[column, row + 1]:
        row += 1
    inner = SHRUNK * surfaces.femoral_radius
    shortest, last_step = (
        (SHORT, LAST_BUMPY) if surfaces.non_convex > 0.0 else (LONGEST, LAST_STEP)
    )
    best, extent, turning, normal_x, normal_y = -math.inf, 0.0, 0.0, 0.0, 1.0
    cell = column * rows + row
    for k in range(int(surfaces.begins[cell]), int(surfaces.begins[cell + 1])):
        i, u = int(surfaces.starts[k, 0]), float(surfaces.starts[k, 1])
        j, place = int(surfaces.starts[k, 2]), float(surfaces.starts[k, 3])
        steps, found, trusted, depth, norm = 0, False, False, 0.0, 1.0
        while True:
            px, py, px1, py1, px2, py2 = femoral_point(cubics, sine, cosine, i, u)
            rise, slope, bend = tibial_point(tibia, j, place)
            dx, dy, square = x + px - place, height + py - rise, 1.0 + slope * slope
            if found or steps == MOST_STEPS:
                norm = math.sqrt(square)
                depth = (slope * dx - dy) / norm
                if trusted or (found and depth < tibia[j, 5]) or abs(height) > FAR:
                    break
                i, u = int(surfaces.starts[k, 0]), float(surfaces.starts[k, 1])
                i, u, j, place = searched(cubics, tibia, sine, cosine, x, height, i, u)
                found, trusted = True, True
                continue
            # Both P'·N and (P - Q)·T shall be 0, with N = (-slope, 1) and T = (1, slope).
            aside, aside_u, room = dx + slope * dy, px1 + slope * py1, square - dy * bend
            least = room > 0.0
            room = room if least else square
            along = bend * px1 / room
            fall, curved = py1 - slope * px1 - along * aside, py2 - slope * px2 - along * aside_u
            longest = shortest + abs(dy) * PER_DISTANCE
            step = (
                -fall / curved if abs(fall) < longest * curved else -math.copysign(longest, fall)
            )
            i, u, beyond = carried_on(cubics, i, u + step)
            step -= beyond
            step_place = max(min((aside + aside_u * step) / room, longest), -longest)
            place += step_place
            j = piece_at(tibia, j, place)
            steps += 1
            found = (
                abs(step) + abs(step_place) < last_step
                and least
                and (curved > 0.0 or beyond != 0.0)
            )
        if depth > best:
            best, normal_x, normal_y = depth, -slope / norm, 1.0 / norm
            extent, turning = -(px * normal_x + py * normal_y), normal_x * py - normal_y * px
    return best + inner, extent + inner, turning, normal_x, normal_y


@in_kernel
def femoral_point(
    cubics: Floats, sine: float, cosine: float, i: int, u: float
) -> tuple[float, float, float, float, float, float]:
    """Return x, y [m] of a point of the turned femur about its reference point, and their derivatives by u."""
    a1, a2, a3 = float(cubics[i, 3]), float(cubics[i, 4]), float(cubics[i, 5])
    b1, b2, b3 = float(cubics[i, 7]), float(cubics[i, 8]), float(cubics[i, 9])
    x, y = (
        float(cubics[i, 2]) + u * (a1 + u * (a2 + u * a3)),
        float(cubics[i, 6]) + u * (b1 + u * (b2 + u * b3)),
    )
    x1, y1 = a1 + u * (2.0 * a2 + u * 3.0 * a3), b1 + u * (2.0 * b2 + u * 3.0 * b3)
    x2, y2 = 2.0 * a2 + 6.0 * u * a3, 2.0 * b2 + 6.0 * u * b3
    return (
        cosine * x - sine * y,
        sine * x + cosine * y,
        cosine * x1 - sine * y1,
        sine * x1 + cosine * y1,
        cosine * x2 - sine * y2,
        sine * x2 + cosine * y2,
    )


@in_kernel
def carried_on(cubics: Floats, i: int, u: float) -> tuple[int, float, float]:
    """Return segment and parameter u [m] of a place that may be beyond segment i, and how far beyond the curve."""
    while u < 0.0 and i > 0:
        i -= 1
        u += float(cubics[i, 0])
    while u > cubics[i, 0] and i < len(cubics) - 1:
        u -= float(cubics[i, 0])
        i += 1
    inside = max(min(u, float(cubics[i, 0])), 0.0)
    return i, inside, u - inside


@in_kernel
def tibial_point(tibia: Floats, j: int, x: float) -> tuple[float, float, float]:
    """Return height [m], slope and second derivative [1/m] of piece j of a curved tibia at x [m]."""
    u, c1, c2, c3 = (
        x - float(tibia[j, 0]),
        float(tibia[j, 2]),
        float(tibia[j, 3]),
        float(tibia[j, 4]),
    )
    rise = float(tibia[j, 1]) + u * (c1 + u * (c2 + u * c3))
    return rise, c1 + u * (2.0 * c2 + u * 3.0 * c3), 2.0 * c2 + 6.0 * c3 * u


@in_kernel
def piece_at(tibia: Floats, j: int, x: float) -> int:
    """Return the piece of a curved tibia at x [m], searched from a piece nearby."""
    while j > 0 and x < tibia[j, 0]:
        j -= 1
    while j < len(tibia) - 1 and x >= tibia[j + 1, 0]:
        j += 1
    return j


@in_kernel
def searched(
    cubics: Floats,
    tibia: Floats,
    sine: float,
    cosine: float,
    x: float,
    height: float,
    i: int,
    u: float,
) -> tuple[int, float, int, float]:
    """Find a place of the femur that is deeper than its neighbours, with the nearest of all tibial points.

    Where the depth is largest, there may be a nearest point on either side: then the depth has an edge there.

    Returns segment and parameter u [m], tibial piece and x [m].
    """
    low, high, way, j, place, at, at_u = 0.0, 0.0, 0.0, 0, 0.0, i, u
    for n in range(MOST_HALVES):
        outward = way == 0.0 or low == -math.inf or high == math.inf
        middle = way if outward else 0.5 * (low + high)
        at, at_u, beyond = carried_on(cubics, i, u + middle)
        px, py, px1, py1, _, _ = femoral_point(cubics, sine, cosine, at, at_u)
        j, place = nearest(tibia, x + px, height + py)
        _, slope, _ = tibial_point(tibia, j, place)
        falls = py1 - slope * px1 < 0.0  # the distance, along the curve
        if n == 0:
            low, high, way = (0.0, math.inf, OUTWARD) if falls else (-math.inf, 0.0, -OUTWARD)
            continue
        if falls:
            low = middle
        else:
            high = middle
        if outward:
            if beyond != 0.0:
                break
            way *= 2.0
        if high - low < FINEST:
            break
    return at, at_u, j, place


@in_kernel
def nearest(tibia: Floats, x: float, y: float) -> tuple[int, float]:
    """Return piece and x [m] of the point of a curved tibia that is nearest to (x, y) [m]."""
    j = piece_at(tibia, 0, x)
    rise, _, _ = tibial_point(tibia, j, x)
    reach, count = abs(y - rise), len(tibia)
    best, best_j, best_place = math.inf, j, x
    for j in range(piece_at(tibia, 0, x - reach), piece_at(tibia, 0, x + reach) + 1):
        low = max(float(tibia[j, 0]), x - reach) if j > 0 else x - reach
        high = min(float(tibia[j + 1, 0]), x + reach) if j < count - 1 else x + reach
        place = 0.5 * (low + high)
        for _ in range(MOST_STEPS):
            rise, slope, bend = tibial_point(tibia, j, place)
            aside, room = x - place + slope * (y - rise), 1.0 + slope * slope - (y - rise) * bend
            goal = place + aside / room if room > 0.0 else math.copysign(math.inf, aside)
            goal = max(min(goal, high), low)
            step, place = goal - place, goal
            if abs(step) < FINEST:
                break
        rise, _, _ = tibial_point(tibia, j, place)
        squared = (x - place) * (x - place) + (y - rise) * (y - rise)
        if squared < best:
            best, best_j, best_place = squared, j, place
    return best_j, best_place


@in_kernel
def next_kink(surfaces: Surfaces, start: float, end: float) -> float:
    """Return the first flexion angle [rad] strictly between two at which the depth's rate jumps at any height, or NaN.

    There the lowest point of a profile on a plane leaps over a dent. `start` may also be the larger angle; the first
    kink is the one nearest to it.
    """
    count, way = len(surfaces.kinks), 1 if start < end else -1
    for turn in range(math.floor(start / math.tau), math.floor(end / math.tau) + way, way):
        for i in range(count):
            kink = float(surfaces.kinks[i if way > 0 else count - 1 - i]) + turn * math.tau
            if (kink - start) * way > 0.0 and (end - kink) * way > 0.0:
                return kink
    return math.nan


@dataclass(frozen=True)
class Plane:
    """A plane through the origin of the tibia frame."""

    slope: float = 0.0
    """Slope [rad], > 0 if the anterior edge is higher; less than a quarter turn"""
    curvature = 0.0
    """Upper bound of the concave curvature [1/m], >= 0"""

    def __str__(self) -> str:
        return "plane"

    def outline(self, reach: float) -> Floats:
        """Return the ends of the plane, shape (2, 2) [m], at `reach` [m] on both sides."""
        return np.outer([-reach, reach], [math.cos(self.slope), math.sin(self.slope)])


@dataclass(frozen=True)
class Cup:
    """A concave plateau (95 mm in the paper): an arc of +-60 degrees, continued straight.

    Its lowest point is the origin of the tibia frame.


    Raises:
        ValueError: the radius is not a finite positive number.
    """

    radius: float
    """Radius of the arc [m], > 0"""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(f"a tibial radius must be finite and > 0, got {self.radius}")

    def __str__(self) -> str:
        return "circle"

    @property
    def curvature(self) -> float:
        """Upper bound of the curvature [1/m]."""
        return 1.0 / self.radius

    @cached_property
    def pieces(self) -> Floats:
        """The arc as a spline that is 1e-12 m close; see `Surfaces.tibia`."""
        x = self.radius * np.sin(np.linspace(-math.pi / 3.0, math.pi / 3.0, ARC_POINTS))
        steepest = SINE / COSINE
        return _tibial_pieces(
            x, self.radius - np.sqrt(self.radius**2 - x * x), ((1, -steepest), (1, steepest))
        )

    def outline(self, reach: float) -> Floats:
        """Return points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        x = np.linspace(-reach, reach, OUTLINE_POINTS)
        on_arc = np.minimum(np.abs(x), SINE * self.radius)
        y = (
            on_arc**2 / (self.radius + np.sqrt(self.radius**2 - on_arc**2))
            + (np.abs(x) - on_arc) * SINE / COSINE
        )
        return np.stack([x, y], axis=1)


@dataclass(frozen=True, eq=False)
class Plateau:
    """A measured plateau through points of the tibia frame: a C2 cubic spline y(x), straight beyond its ends.

    The points are ordered along x in either direction; a repeated point counts once.

    Raises:
        ValueError: fewer than 4 different points, a number that is not finite, or points that turn back in x.
    """

    x: ArrayLike
    """[m], anterior positive"""
    y: ArrayLike
    """[m], superior positive"""
    pieces: Floats = field(init=False, repr=False)
    """See `Surfaces.tibia`"""

    def __post_init__(self) -> None:
        x, y = np.asarray(self.x, float), np.asarray(self.y, float)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ValueError("a tibial profile point is not finite")
        repeated = 1 + np.flatnonzero((np.diff(x) == 0.0) & (np.diff(y) == 0.0))
        x, y = np.delete(x, repeated), np.delete(y, repeated)
        if x.size < 4:
            raise ValueError(f"a tibial profile needs at least 4 different points, got {x.size}")
        if x[0] > x[-1]:
            x, y = x[::-1], y[::-1]
        if not (np.diff(x) > 0.0).all():
            raise ValueError("a tibial profile must not turn back in x")
        pieces = _tibial_pieces(x, y, "not-a-knot")
        # Balls below: through a point u of a piece, tangent there, and any point v
        inner = np.linspace(x[:-1], x[1:], BALLS, endpoint=False, axis=1).ravel()
        u = np.concatenate([x[0] - TAILS[::-1], inner, x[-1] + TAILS])
        rise, slope = _rise(pieces, u), _rise(pieces, u, 1)
        dx, dy = u - u[:, None], rise - rise[:, None]
        inward = (slope[:, None] * dx - dy) / np.sqrt(1.0 + slope**2)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            radius = np.where(inward > 1e-12, (dx * dx + dy * dy) / (2.0 * inward), math.inf).min(
                axis=1
            )
        np.minimum.at(pieces[:, 5], np.searchsorted(x, u, side="right"), SAFE * radius)
        object.__setattr__(self, "pieces", pieces)

    def __str__(self) -> str:
        return "profile"

    @property
    def curvature(self) -> float:
        """Upper bound of the curvature [1/m]."""
        (_, _, c1, c2, c3), width = (
            self.pieces[1:, :5].T,
            np.diff(self.pieces[1:, 0], append=self.pieces[-1, 0]),
        )
        bends = np.stack([2.0 * c2, 2.0 * c2 + 6.0 * c3 * width])
        flattest = np.maximum(np.abs(c1) - np.abs(bends).max(axis=0) * width, 0.0)
        return max(0.0, float((bends / (1.0 + flattest**2) ** 1.5).max()))

    def outline(self, reach: float) -> Floats:
        """Return points along the measured surface, shape (n, 2) [m], to `reach` [m] on both sides at most."""
        nodes = self.pieces[1:, 0]
        low, high = max(-reach, float(nodes[0])), min(reach, float(nodes[-1]))
        x = np.unique(np.concatenate([np.linspace(low, high, OUTLINE_POINTS), nodes]))
        x = x[np.abs(x) <= reach]
        return np.stack([x, _rise(self.pieces, x)], axis=1)


def _tibial_pieces(x: Floats, y: Floats, ends: Any) -> Floats:
    """Return `Surfaces.tibia` of a spline through points x, y [m] with SciPy's condition at its ends."""
    from scipy.interpolate import (
        CubicSpline,
    )  # 0.9 s to import, which a circle on a plane need not pay

    spline = CubicSpline(x, y, bc_type=ends)
    before, behind = np.column_stack([x, y, spline(x, 1), 0.0 * x, 0.0 * x])[[0, -1]]
    pieces = np.vstack([before, np.column_stack([x[:-1], spline.c[::-1].T]), behind])
    return np.column_stack([pieces, np.full(len(pieces), math.inf)])


def _rise(pieces: Floats, x: Floats, derivative: int = 0) -> Floats:
    """Return the height [m], or slope, of a curved tibia at places x [m]."""
    start, c0, c1, c2, c3 = pieces[np.searchsorted(pieces[1:, 0], x, side="right"), :5].T
    u = x - start
    return np.asarray(
        c1 + u * (2.0 * c2 + u * 3.0 * c3) if derivative else c0 + u * (c1 + u * (c2 + u * c3))
    )


FemoralSurface = Circle | Profile
TibialSurface = Plane | Cup | Plateau


@dataclass(frozen=True, eq=False)
class ContactPair:
    """A femoral surface over a tibial one, and the mechanism that prescribes where the femur lies along x."""

    femur: FemoralSurface
    tibia: TibialSurface
    mechanism: Mechanism

    def __str__(self) -> str:
        return f"{self.femur} on {self.tibia}, {self.mechanism}"

    def outline(self, reach: float) -> Floats:
        """Return points along the tibial surface, shape (n, 2) [m] in the tibia frame, to `reach` [m] on both sides."""
        return self.tibia.outline(reach)

    def closest(self, angle: float, height: float) -> Closest:
        """Return the common normal at a flexion angle [rad] and a height of the femoral reference point [m]."""
        return Closest(
            *closest(self.surfaces, angle, self.mechanism.translation(angle)[0], height)
        )

    @cached_property
    def femoral_radius(self) -> float:
        """Radius [m] of the circle that fits the femoral surface best, wherever its reference point is.

        Least squares of x² + y² = 2 a x + 2 b y + c (Kåsa's fit); infinite for points on a line.
        """
        points = self.femur.outline()
        centred = points - points.mean(axis=0)
        matrix = np.column_stack([2.0 * centred, np.ones(len(centred))])
        (a, b, c), _, rank, _ = np.linalg.lstsq(matrix, (centred**2).sum(axis=1), rcond=None)
        return math.sqrt(c + a * a + b * b) if rank == 3 else math.inf

    @cached_property
    def surfaces(self) -> Surfaces:
        """The pair in the form that the kernel takes."""
        femur, tibia, mechanism = self.femur, self.tibia, self.mechanism
        slope = float(tibia.slope) if isinstance(tibia, Plane) else 0.0
        kind, table, pieces, non_convex = IN_CUP, NO_TABLE, NOTHING, False
        if isinstance(tibia, Plane):
            kind, table = ON_PLANE, femur.on_plane
        elif isinstance(femur, Profile) or isinstance(tibia, Plateau):
            kind, pieces = ON_CURVE, tibia.pieces
            table = _starts(femur, pieces, mechanism)
            # One kink is that of an open curve's two ends; a hollow narrower than the femur holds it on two edges.
            leaps = isinstance(femur, Profile) and len(femur.on_plane.kinks) > 1
            non_convex = leaps or tibia.curvature > 1.0 / femur.support(0.0)[0]
        return Surfaces(
            kind=kind,
            slope=slope,
            sine=math.sin(slope),
            cosine=math.cos(slope),
            femoral_radius=float(femur.radius) if isinstance(femur, Circle) else 0.0,
            tibial_radius=float(tibia.radius) if isinstance(tibia, Cup) else 0.0,
            cells=table.cells,
            begins=table.begins,
            starts=table.starts,
            cubics=table.cubics,
            kinks=np.sort((table.kinks + slope) % math.tau),
            pieces=mechanism.pieces,
            tibia=np.ascontiguousarray(pieces),
            non_convex=float(non_convex),
            knot_spacing=femur.knot_spacing,
            largest_radius=femur.largest_radius,
            largest_slope=mechanism.largest_slope,
            largest_bend=mechanism.largest_bend,
            concave=tibia.curvature,
        )

    def table(self) -> dict[str, Floats]:
        """Return the tables as arrays to plot; on a curved tibia also the edges of the columns [rad]."""
        arrays = {
            name: one
            for name, one in self.surfaces._asdict().items()
            if isinstance(one, np.ndarray)
        }
        return arrays | ({"edges": EDGES} if self.surfaces.kind == ON_CURVE else {})


def _starts(femur: Circle | Profile, tibia: Floats, mechanism: Mechanism) -> Table:
    """Tabulate where a search for the common normal starts, by brute force over angles, depths and femoral points.

    The femur has a gap g where it touches the upper envelope of balls of radius g about the tibia's points, and a depth
    d where it touches the lower envelope. A corner of the table has an angle and a depth. There, the femoral points
    that may be deepest are those with the smallest vertical clearance above the envelope, each with all tibial points
    that may be nearest.
    """
    turns, cubics = isinstance(femur, Profile), femur.cubics
    parts, inner = (1, SHRUNK * femur.radius) if isinstance(femur, Circle) else (PARTS, 0.0)
    segments, part = np.divmod(np.arange(parts * len(cubics) + 1), parts)
    segments[-1], part[-1] = len(cubics) - 1, parts
    length, _, x0, x1, x2, x3, y0, y1, y2, y3 = cubics[segments].T
    u = length * part / parts
    px, py = x0 + u * (x1 + u * (x2 + u * x3)), y0 + u * (y1 + u * (y2 + u * y3))
    angles = EDGES
    sine, cosine = (np.sin(angles)[:, None], np.cos(angles)[:, None]) if turns else (0.0, 1.0)
    x = (
        np.array([mechanism.translation(angle)[0] for angle in angles.tolist()])[:, None]
        + cosine * px
        - sine * py
    )
    y = sine * px + cosine * py + np.zeros_like(x)
    place = np.arange(x.min(), x.max() + STEP, STEP)
    found, heights = [], np.empty((len(angles), len(LEVELS)))
    for level, depth in enumerate((LEVELS - inner).tolist()):
        # Balls whose feet are on the tibia, and which touch the femur at `place`: their highest or lowest tops
        sign, reach = (
            -1.0 if depth > 0.0 else 1.0,
            math.ceil(abs(depth) * math.sin(STEEPEST) / STEP) + 1,
        )
        offset = STEP * np.arange(-reach, reach + 1)
        ball = np.where(
            abs(offset) <= abs(depth), np.sqrt(np.maximum(depth * depth - offset**2, 0.0)), -FAR
        )
        rise = _rise(tibia, place[0] + STEP * np.arange(-reach, len(place) + reach))
        tops = sliding_window_view(sign * rise, len(offset)) + ball
        best = np.clip(tops.argmax(axis=1), 1, 2 * reach - 1)
        before, at, behind = (tops[np.arange(len(place)), best + k] for k in (-1, 0, 1))
        bend = np.maximum(2.0 * at - before - behind, 1e-12)
        envelope = sign * (at + (behind - before) ** 2 / (8.0 * bend))  # a parabola's
        clear = y - np.interp(x, place, envelope)
        lowest = clear.argmin(axis=1)
        least = clear[np.arange(len(angles)), lowest]
        heights[:, level] = -least
        edge = np.full((len(angles), 1), math.inf)
        dips = (clear <= np.hstack([edge, clear[:, :-1]])) & (
            clear < np.hstack([clear[:, 1:], edge])
        )
        columns, points = np.nonzero(dips)
        deepest = lowest[columns]
        touched, other = (
            ((x[columns, one] - place[0]) / STEP + 0.5).astype(int) for one in (points, deepest)
        )
        away = np.hypot(px[points] - px[deepest], py[points] - py[deepest])
        higher, shift = (
            clear[columns, points] - least[columns],
            place[touched] - place[other] - offset[best[other]],
        )
        kept = higher <= SLACK * (away + abs(shift + offset[best[touched]])) + SLACK_OF_ALL
        columns, points, touched, away, higher, shift = (
            one[kept] for one in (columns, points, touched, away, higher, shift)
        )
        which, foot = np.arange(len(points)), best[touched]
        if (
            depth < 0.0
        ):  # apart, other tops of the tibia may become the nearest ones to the same femoral point
            near = tops[touched]
            which, foot = np.nonzero(
                (near[:, 1:-1] > near[:, :-2]) & (near[:, 1:-1] >= near[:, 2:])
            )
            foot += 1
        lower = at[touched[which]] - tops[touched[which], foot]
        kept = (
            higher[which] + lower
            <= SLACK * (away[which] + abs(shift[which] + offset[foot])) + SLACK_OF_ALL
        )
        which, foot = which[kept], foot[kept]
        feet = place[touched[which]] + offset[foot]
        found.append(np.stack([columns[which], np.full(len(which), level), points[which], feet]))
    return _cells(np.concatenate(found, axis=1), heights, cubics, tibia, parts)


def _cells(corners: Floats, heights: Floats, cubics: Floats, tibia: Floats, parts: int) -> Table:
    """Assign each cell of the table the starts of its four corners: column, level, femoral point and tibial x [m]."""
    rows, (columns, levels, points, places) = len(LEVELS) - 1, corners
    middle = 0.5 * (heights[1:] + heights[:-1])
    around = [(columns - i, levels - j, points, places) for i in (0, 1) for j in (0, 1)]
    columns, levels, points, places = np.concatenate(np.array(around), axis=1)
    inside = (columns >= 0) & (columns < len(heights) - 1) & (levels >= 0) & (levels < rows)
    cells, points, places = (
        (columns * rows + levels)[inside].astype(np.int64),
        points[inside],
        places[inside],
    )
    order = np.lexsort((places, points, cells))
    cells, points, places = cells[order], points[order], places[order]
    crowded = (
        np.bincount(cells)[cells] > 4
    )  # else there is one place, which moves from corner to corner
    apart = np.abs(np.diff(places, prepend=-9.0)) > np.where(crowded, APART, 4.0 * APART)
    apart |= crowded & (np.diff(points, prepend=-9.0) > 1.0)
    new = np.flatnonzero((np.diff(cells, prepend=-1) != 0) | apart)
    number = np.diff(new, append=len(cells))
    points, places = np.add.reduceat(points, new) / number, np.add.reduceat(places, new) / number
    segments = np.minimum(points // parts, len(cubics) - 1)
    u = (points / parts - segments) * cubics[segments.astype(np.int64), 0]
    pieces = np.searchsorted(tibia[1:, 0], places, side="right")
    begins = np.searchsorted(cells[new], np.arange(len(middle) * rows + 1)).astype(np.int64)
    return Table(
        middle, begins, np.column_stack([segments, u, pieces, places]), cubics, NOTHING[0, :0]
    )


GEOMETRIES: dict[str, type[Circle] | type[Profile]] = {"circle": Circle, "profile": Profile}
"""Femoral surfaces by the names that the parameter `femur.geometry` uses"""
TIBIAL_GEOMETRIES: dict[str, type[Plane] | type[Cup] | type[Plateau]] = {
    "plane": Plane,
    "circle": Cup,
    "profile": Plateau,
}
"""Tibial surfaces by the names that the parameter `tibia.geometry` uses"""
