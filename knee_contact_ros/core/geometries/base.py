"""What a femoral geometry is to a plane: its support function.

With the femur turned by θ, the lowest point of its surface lies h(θ) below the reference point,
h(θ) = max over the curve of -(sin θ pₓ + cos θ p_y), and h'(θ) = -x of that lowest point relative to the reference
point (Eq. 7 of the paper in closed form). So depth = h(θ) - y with no search, and its rate is exact.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class FemoralGeometry(Protocol):
    """A femoral surface in the sagittal plane, about its reference point."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """Angles in [0, 2π) [rad], increasing, at which dh/dangle jumps: the lowest point leaps over a dent."""
        ...

    @property
    def grain(self) -> float:
        """Turn [rad] between two places where the surface is not smooth (a spline's points); infinite if it is."""
        ...

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and dh/dangle [m/rad] at an angle [rad], positive in flexion."""
        ...

    def outline(self) -> NDArray[np.float64]:
        """Points along the surface, shape (n, 2) [m] in the femur frame, for drawing."""
        ...
