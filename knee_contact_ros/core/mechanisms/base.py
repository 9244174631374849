"""What a knee mechanism is: the anterior-posterior translation that goes with flexion."""

from __future__ import annotations

from typing import Protocol


class Mechanism(Protocol):
    """Prescribes where the femoral reference point lies along the tibia's x axis."""

    def translation(self, angle: float) -> tuple[float, float]:
        """Return x [m], anterior positive, and dx/dangle [m/rad] at a flexion angle [rad]; C1 for all finite angles."""
        ...
