"""Where a femoral surface and a tibial one are closest or overlap most, in the kernel's form.

Generalized contact kinematics of the paper, Eqs. 1 to 6: at the two points of closest approach the normals are parallel
(n x n' = 0) and the vector between the points lies along them (d x n = 0).
"""

import math
from typing import NamedTuple

from .compiler import in_kernel, inlined
from .mechanisms import translation
from .profiles import SHRUNK, support_at
from .starts import COLUMN_WIDTH, FIRST_ANGLE, NARROW_COLUMNS, WIDE_COLUMNS, WIDE_FACTOR
from .types import Floats, Integers

ON_PLANE = 0
"""Kind of a pair with a plane tibia: the femur's support function gives the depth"""
IN_CUP = 1
"""Kind of a circle in a cup: the depth has a closed form"""
ON_CURVE = 2
"""Kind of every other pair: a search finds the common normal"""
CUP_COSINE = 0.5
"""Cosine of a cup's half angle, 60 degrees: far beyond any plateau, and the surface stays open upwards"""
CUP_SINE = math.sqrt(0.75)
"""Sine of that half angle"""
_MAX_NEWTON_STEPS = 40
"""Largest number of Newton's steps from a start, after which the search by halving takes over"""
_MAX_HALVINGS = 80
"""Largest number of steps of that search: halving 1 m 50 times reaches the rounding error, the others widen it first"""
_MAX_HEIGHT = 1.0
"""Height [m] beyond which no contact is searched: only a diverged iterate gets there"""
_FIRST_OUTWARD_STEP = 1e-4
"""First step [m] of the search by halving, doubled until the place is enclosed"""
_LAST_STEP = 5e-7
"""Newton's step [m] after which the error, of its square, is a rounding error"""
_LAST_BUMPY_STEP = 1e-7
"""The same for bumpy surfaces, which bend more"""
_FINEST = 1e-14
"""Distance [m] of two bounds at which halving ends, and Newton's step on the tibia: the rounding error of 0.1 m"""
_MAX_STEP = 1e-3
"""Largest of Newton's steps [m] of surfaces in contact"""
_MAX_BUMPY_STEP = 1e-4
"""The same for bumpy surfaces, so that a step leads to no other bump. Tuned; tests/model/test_surfaces.py would
notice."""
_MAX_STEP_PER_DISTANCE = 0.05
"""What is added to that largest step, per vertical distance of the two points"""


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
    """Upper bound of the tibia's concave curvature [1/m], >= 0"""
    convex: float
    """The same of its convex curvature [1/m]"""


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
def closest(surfaces: Surfaces, angle: float, x: float, height: float) -> Closest:
    """Return the common normal for the reference point at (x, height) [m].

    On a plane the depth is h - n·(x, height), where h is the femur's support at the angle minus the slope.
    """
    if surfaces.kind != ON_PLANE:
        return common_normal(surfaces, angle, x, height)
    h = surfaces.femoral_radius
    turning = 0.0
    if h == 0.0:
        turned = angle - surfaces.slope
        h, turning = support_at(
            surfaces.cells, surfaces.begins, surfaces.starts, surfaces.cubics, turned
        )
    depth = h + x * surfaces.sine - surfaces.cosine * height
    return Closest(depth, h, turning, -surfaces.sine, surfaces.cosine)


@inlined
def contact_point(found: Closest, x: float, height: float) -> tuple[float, float]:
    """Return the contact point on the tibia [m], for the femoral reference point at (x, height) [m]."""
    along, across = -found.turning, found.depth - found.extent
    point_x = x + along * found.normal_y + across * found.normal_x
    return point_x, height - along * found.normal_x + across * found.normal_y


@in_kernel
def normal_in_cup(surfaces: Surfaces, x: float, height: float) -> Closest:
    """Return the common normal of a circle in a cup.

    The circle's deepest point is in the direction of its centre's nearest tibial point.
    """
    radius = surfaces.tibial_radius
    below = radius - height
    if CUP_COSINE * abs(x) >= CUP_SINE * below:  # on the straight continuation of the arc
        distance = CUP_COSINE * height - CUP_SINE * abs(x) + (1.0 - CUP_COSINE) * radius
        normal_x = -math.copysign(CUP_SINE, x)
        normal_y = CUP_COSINE
    else:
        from_centre = math.sqrt(x * x + below * below)
        distance = (height * (radius + below) - x * x) / (radius + from_centre)
        normal_x = -x / from_centre
        normal_y = below / from_centre
    femoral = surfaces.femoral_radius
    return Closest(femoral - distance, femoral, 0.0, normal_x, normal_y)


@in_kernel
def start_cell(surfaces: Surfaces, angle: float, height: float) -> int:
    """Return the cell of the table of starts for a flexion angle [rad] and a femoral height [m]."""
    heights = surfaces.cells
    rows = int(heights.shape[1]) - 1
    part = (angle - FIRST_ANGLE) / COLUMN_WIDTH
    part += (max(part - NARROW_COLUMNS, 0.0) + min(part, 0.0)) * (1.0 / WIDE_FACTOR - 1.0)
    column = max(min(int(part + WIDE_COLUMNS), len(heights) - 1), 0)
    row = 0
    while row < rows - 1 and height < heights[column, row + 1]:
        row += 1
    return column * rows + row


@in_kernel
def common_normal(surfaces: Surfaces, angle: float, x: float, height: float) -> Closest:
    """Return the common normal on a curved tibia: the deepest of the contacts found from some starts.

    From each start Newton's method finds a common normal. If it does not reach a smallest distance, or if its foot may
    not be the nearest one to a point below the surface, a search by halving takes over.
    """
    if surfaces.kind == IN_CUP:
        return normal_in_cup(surfaces, x, height)
    cubics = surfaces.cubics
    tibia = surfaces.tibia
    # A circle looks the same from everywhere.
    turned = 0.0 if surfaces.femoral_radius > 0.0 else angle
    sine = math.sin(turned)
    cosine = math.cos(turned)
    bumpy = surfaces.non_convex > 0.0
    shortest = _MAX_BUMPY_STEP if bumpy else _MAX_STEP
    last_step = _LAST_BUMPY_STEP if bumpy else _LAST_STEP
    # The deepest contact until now
    best, extent, turning, normal_x, normal_y = -math.inf, 0.0, 0.0, 0.0, 1.0
    cell = start_cell(surfaces, angle, height)
    for k in range(int(surfaces.begins[cell]), int(surfaces.begins[cell + 1])):
        i = int(surfaces.starts[k, 0])
        u = float(surfaces.starts[k, 1])
        j = int(surfaces.starts[k, 2])
        place = float(surfaces.starts[k, 3])
        steps = 0
        found = False  # Newton's method has converged
        trusted = False  # the search by halving has found the place
        depth = 0.0
        norm = 1.0
        while True:
            px, py, px1, py1, px2, py2 = femoral_point(cubics, sine, cosine, i, u)
            rise, slope, bend = tibial_point(tibia, j, place)
            dx = x + px - place
            dy = height + py - rise
            square = 1.0 + slope * slope
            if found or steps == _MAX_NEWTON_STEPS:
                norm = math.sqrt(square)
                depth = (slope * dx - dy) / norm
                # Inside the ball below this tibial piece, no other tibial point is nearer.
                if trusted or (found and depth < tibia[j, 5]) or abs(height) > _MAX_HEIGHT:
                    break
                i = int(surfaces.starts[k, 0])
                u = float(surfaces.starts[k, 1])
                i, u, j, place = deepest_by_halving(cubics, tibia, sine, cosine, x, height, i, u)
                found = True
                trusted = True
                continue
            # Both P'·N and (P - Q)·T must be 0, with N = (-slope, 1) and T = (1, slope). The second gives the tibial
            # place as a function of u, with which the first becomes one equation for u.
            aside = dx + slope * dy
            aside_u = px1 + slope * py1
            room = square - dy * bend
            least = room > 0.0  # the distance of the tibial point is smallest, and not largest
            room = room if least else square
            along = bend * px1 / room
            fall = py1 - slope * px1 - along * aside
            curved = py2 - slope * px2 - along * aside_u
            longest = shortest + abs(dy) * _MAX_STEP_PER_DISTANCE
            is_short = abs(fall) < longest * curved
            step = -fall / curved if is_short else -math.copysign(longest, fall)
            i, u, beyond = carried_on(cubics, i, u + step)
            step -= beyond
            step_place = max(min((aside + aside_u * step) / room, longest), -longest)
            place += step_place
            j = piece_at(tibia, j, place)
            steps += 1
            # At an end of the femoral curve the distance need not have a minimum inside it.
            settled = abs(step) + abs(step_place) < last_step
            found = settled and least and (curved > 0.0 or beyond != 0.0)
        # The deepest of all common normals is the contact: the others are saddles, or lie on other bumps.
        if depth > best:
            best = depth
            normal_x = -slope / norm
            normal_y = 1.0 / norm
            extent = -(px * normal_x + py * normal_y)
            turning = normal_x * py - normal_y * px
    # The spline of a circle is a smaller circle; see `Circle.cubics`.
    inner = SHRUNK * surfaces.femoral_radius
    return Closest(best + inner, extent + inner, turning, normal_x, normal_y)


@in_kernel
def femoral_point(
    cubics: Floats, sine: float, cosine: float, i: int, u: float
) -> tuple[float, float, float, float, float, float]:
    """Return x, y [m] of a point of the turned femur about its reference point, and their derivatives by u."""
    a1, a2, a3 = float(cubics[i, 3]), float(cubics[i, 4]), float(cubics[i, 5])
    b1, b2, b3 = float(cubics[i, 7]), float(cubics[i, 8]), float(cubics[i, 9])
    x = float(cubics[i, 2]) + u * (a1 + u * (a2 + u * a3))
    y = float(cubics[i, 6]) + u * (b1 + u * (b2 + u * b3))
    x1 = a1 + u * (2.0 * a2 + u * 3.0 * a3)
    y1 = b1 + u * (2.0 * b2 + u * 3.0 * b3)
    x2 = 2.0 * a2 + 6.0 * u * a3
    y2 = 2.0 * b2 + 6.0 * u * b3
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
    u = x - float(tibia[j, 0])
    c1, c2, c3 = float(tibia[j, 2]), float(tibia[j, 3]), float(tibia[j, 4])
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
def deepest_by_halving(
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
    low, high = 0.0, 0.0  # bounds of the way along the curve [m]; infinite: not yet enclosed
    way = 0.0
    j, place = 0, 0.0
    at, at_u = i, u
    for n in range(_MAX_HALVINGS):
        outward = way == 0.0 or low == -math.inf or high == math.inf
        middle = way if outward else 0.5 * (low + high)
        at, at_u, beyond = carried_on(cubics, i, u + middle)
        px, py, px1, py1, _, _ = femoral_point(cubics, sine, cosine, at, at_u)
        j, place = nearest(tibia, x + px, height + py)
        _, slope, _ = tibial_point(tibia, j, place)
        falls = py1 - slope * px1 < 0.0  # the distance, along the curve
        if n == 0:
            if falls:
                high = math.inf
                way = _FIRST_OUTWARD_STEP
            else:
                low = -math.inf
                way = -_FIRST_OUTWARD_STEP
            continue
        if falls:
            low = middle
        else:
            high = middle
        if outward:
            if beyond != 0.0:
                break
            way *= 2.0
        if high - low < _FINEST:
            break
    return at, at_u, j, place


@in_kernel
def nearest(tibia: Floats, x: float, y: float) -> tuple[int, float]:
    """Return piece and x [m] of the point of a curved tibia that is nearest to (x, y) [m]."""
    j = piece_at(tibia, 0, x)
    rise, _, _ = tibial_point(tibia, j, x)
    reach = abs(y - rise)
    count = len(tibia)
    best, best_j, best_place = math.inf, j, x
    for j in range(piece_at(tibia, 0, x - reach), piece_at(tibia, 0, x + reach) + 1):
        low = max(float(tibia[j, 0]), x - reach) if j > 0 else x - reach
        high = min(float(tibia[j + 1, 0]), x + reach) if j < count - 1 else x + reach
        place = 0.5 * (low + high)
        for _ in range(_MAX_NEWTON_STEPS):
            rise, slope, bend = tibial_point(tibia, j, place)
            aside = x - place + slope * (y - rise)
            room = 1.0 + slope * slope - (y - rise) * bend
            goal = place + aside / room if room > 0.0 else math.copysign(math.inf, aside)
            goal = max(min(goal, high), low)
            step = goal - place
            place = goal
            if abs(step) < _FINEST:
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
    count = len(surfaces.kinks)
    way = 1 if start < end else -1
    for turn in range(math.floor(start / math.tau), math.floor(end / math.tau) + way, way):
        for i in range(count):
            kink = float(surfaces.kinks[i if way > 0 else count - 1 - i]) + turn * math.tau
            if (kink - start) * way > 0.0 and (end - kink) * way > 0.0:
                return kink
    return math.nan
