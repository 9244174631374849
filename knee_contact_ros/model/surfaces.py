"""Tibial surfaces, and pairs of a femoral and a tibial one."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .closest import CUP_COSINE, CUP_SINE, IN_CUP, ON_CURVE, ON_PLANE, Closest, Surfaces, closest
from .mechanisms import Mechanism
from .profiles import NO_TABLE, NOTHING, Circle, Profile, distinct_points
from .splines import NOT_A_KNOT, Ends, pieces_through, sines
from .starts import height_and_slope, starts_table
from .types import Floats

_ARC_POINTS = 1201
"""Number of points of a cup's spline, which makes it 1e-12 m close"""
_BALLS_PER_PIECE = 6
"""Number of points of a tibial piece at which a ball touches it from below"""
_BALL_SAFETY = 0.8
"""Part of the largest radius of these balls that is taken for every point between them"""
_BALL_TAILS: Floats = np.geomspace(1e-4, 0.1, 20)
"""Places [m] beyond the measured tibia against which balls are checked"""
_OUTLINE_POINTS = 201
"""Number of points of an outline, besides the measured ones"""


@dataclass(frozen=True)
class Plane:
    """A plane through the origin of the tibia frame."""

    slope: float = 0.0
    """Slope [rad], > 0 if the anterior edge is higher; less than a quarter turn"""
    curvature = 0.0
    """Upper bound of the concave curvature [1/m], >= 0"""
    convex = 0.0
    """Upper bound of the convex curvature [1/m], >= 0"""

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
    convex = 0.0
    """Upper bound of the convex curvature [1/m]"""

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
        x = self.radius * sines(np.linspace(-math.pi / 3.0, math.pi / 3.0, _ARC_POINTS))
        y = self.radius - np.sqrt(self.radius**2 - x * x)
        steepest = CUP_SINE / CUP_COSINE
        return _tibial_pieces(x, y, (-steepest, steepest))

    def outline(self, reach: float) -> Floats:
        """Return points along the surface, shape (n, 2) [m], to `reach` [m] on both sides."""
        x = np.linspace(-reach, reach, _OUTLINE_POINTS)
        on_arc = np.minimum(np.abs(x), CUP_SINE * self.radius)
        arc = on_arc**2 / (self.radius + np.sqrt(self.radius**2 - on_arc**2))
        straight = (np.abs(x) - on_arc) * CUP_SINE / CUP_COSINE
        return np.stack([x, arc + straight], axis=1)


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
        x, y = distinct_points(self.x, self.y, "tibial profile")
        if x[0] > x[-1]:
            x, y = x[::-1], y[::-1]
        if not (np.diff(x) > 0.0).all():
            raise ValueError("a tibial profile must not turn back in x")
        pieces = _tibial_pieces(x, y, NOT_A_KNOT)
        # Balls below: through a point u of a piece, tangent there, and any point v
        inner = np.linspace(x[:-1], x[1:], _BALLS_PER_PIECE, endpoint=False, axis=1).ravel()
        u = np.concatenate([x[0] - _BALL_TAILS[::-1], inner, x[-1] + _BALL_TAILS])
        rise, slope = height_and_slope(pieces, u)
        dx = u - u[:, None]
        dy = rise - rise[:, None]
        inward = (slope[:, None] * dx - dy) / np.sqrt(1.0 + slope**2)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            radii = (dx * dx + dy * dy) / (2.0 * inward)
        # Where v is within a rounding error of the tangent, no ball is too large.
        radius = np.where(inward > 1e-12, radii, math.inf).min(axis=1)
        np.minimum.at(pieces[:, 5], np.searchsorted(x, u, side="right"), _BALL_SAFETY * radius)
        object.__setattr__(self, "pieces", pieces)

    def __str__(self) -> str:
        return "profile"

    @cached_property
    def curvatures(self) -> Floats:
        """Bounds of the curvatures of all pieces [1/m], > 0 where they are concave."""
        start, _, c1, c2, c3 = self.pieces[1:, :5].T
        width = np.diff(start, append=start[-1])
        bends = np.stack([2.0 * c2, 2.0 * c2 + 6.0 * c3 * width])
        flattest = np.maximum(np.abs(c1) - np.abs(bends).max(axis=0) * width, 0.0)
        stretch = np.sqrt(1.0 + flattest**2)
        return np.asarray(bends / (stretch * stretch * stretch))

    @property
    def curvature(self) -> float:
        """Upper bound of the concave curvature [1/m]."""
        return max(0.0, float(self.curvatures.max()))

    @property
    def convex(self) -> float:
        """Upper bound of the convex curvature [1/m]."""
        return max(0.0, float(-self.curvatures.min()))

    def outline(self, reach: float) -> Floats:
        """Return points along the measured surface, shape (n, 2) [m], to `reach` [m] on both sides at most."""
        nodes = self.pieces[1:, 0]
        low, high = max(-reach, float(nodes[0])), min(reach, float(nodes[-1]))
        x = np.unique(np.concatenate([np.linspace(low, high, _OUTLINE_POINTS), nodes]))
        x = x[np.abs(x) <= reach]
        return np.stack([x, height_and_slope(self.pieces, x)[0]], axis=1)


def _tibial_pieces(x: Floats, y: Floats, ends: Ends) -> Floats:
    """Return `Surfaces.tibia` of a spline through points x, y [m]."""
    pieces = pieces_through(x, y, ends)
    return np.column_stack([pieces, np.full(len(pieces), math.inf)])


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

    def closest(self, angle: float, height: float) -> Closest:
        """Return the common normal at a flexion angle [rad] and a height of the femoral reference point [m]."""
        x, _ = self.mechanism.translation(angle)
        return closest(self.surfaces, angle, x, height)

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
        kind = IN_CUP
        table = NO_TABLE
        pieces = NOTHING
        non_convex = False
        if isinstance(tibia, Plane):
            kind = ON_PLANE
            table = femur.on_plane
        elif isinstance(femur, Profile) or isinstance(tibia, Plateau):
            kind = ON_CURVE
            pieces = tibia.pieces
            table = starts_table(femur, pieces, mechanism)
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
            convex=tibia.convex,
        )


GEOMETRIES: dict[str, type[Circle] | type[Profile]] = {"circle": Circle, "profile": Profile}
"""Femoral surfaces by the names that the parameter `femur.geometry` uses"""
TIBIAL_GEOMETRIES: dict[str, type[Plane] | type[Cup] | type[Plateau]] = {
    "plane": Plane,
    "circle": Cup,
    "profile": Plateau,
}
"""Tibial surfaces by the names that the parameter `tibia.geometry` uses"""
