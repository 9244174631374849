"""Femoral geometries: their support functions, by which they touch a plane.

With the femur turned by θ, the lowest point of its surface lies h(θ) below the reference point,
h(θ) = max over the curve of -(sin θ pₓ + cos θ p_y), and h'(θ) = -x of that lowest point relative to the reference
point (Eq. 7 of the paper in closed form). So the depth is h(θ) - y without a search, and its rate is exact.
"""

from __future__ import annotations

from typing import Protocol

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.kernel_source import kernel_interface


@kernel_interface
class Support(Protocol):
    """The part of a femoral geometry that the kernel calls."""

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
        ...

    def next_kink(self, start: float, end: float) -> float:
        """The first angle [rad] strictly between `start` and `end` at which dh/dangle jumps; NaN if there is none.

        There the lowest point leaps over a dent. `start` may be the larger one of the two.
        """
        ...

    def knot_spacing(self) -> float:
        """The mean turn [rad] between two points where the surface is not smooth (of a spline); infinite if it is."""
        ...

    def largest_radius(self) -> float:
        """Return an upper bound of the distance [m] of the surface's points from the reference point."""
        ...


class FemoralGeometry(Support, Protocol):
    """A femoral surface in the sagittal plane, about its reference point: a named tuple."""

    def outline(self) -> Floats:
        """Return points along the surface, shape (n, 2) [m] in the femur frame, for drawing."""
        ...
