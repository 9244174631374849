"""Knee mechanisms: the anterior-posterior translation that goes with flexion."""

from __future__ import annotations

from typing import Protocol

from knee_contact_ros.core.kernel_source import kernel_interface


@kernel_interface
class Mechanism(Protocol):
    """Prescribes where the femoral reference point lies along the tibia's x axis: a named tuple."""

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m], anterior positive, and dx/dangle [m/rad] at a flexion angle [rad]; C1 for all finite angles."""
        ...

    def largest_slope(self) -> float:
        """Return an upper bound of |dx/dangle| [m/rad] over all angles."""
        ...
