"""Forces of the muscles at the knee that balance a net moment.

One moment does not determine several forces, so there is a rule: the gastrocnemius bears a fixed share of the
plantarflexion moment. Extensors and flexors each pull with at least half of a floor, by which antagonists pull without
need (tone, and co-contraction that grows with the ground force). Beyond that, only the side that is needed pulls.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.joint_reaction.moment_arms import (
    ACHILLES,
    GASTROCNEMIUS,
    GASTROCNEMIUS_SHARE,
    HAMSTRINGS,
    QUADRICEPS,
    arm,
)


class Muscles(NamedTuple):
    """Muscle forces [N], 0 or more, taken along the tibia: tendons are within 20 degrees of it (cosine above 0.94)."""

    quadriceps: float
    """Force of the quadriceps through the patellar tendon"""
    hamstrings: float
    gastrocnemius: float

    @property
    def total(self) -> float:
        """Sum of the forces [N], which press femur and tibia together."""
        return self.quadriceps + self.hamstrings + self.gastrocnemius


def gastrocnemius_of(plantarflexion_moment: float, ankle: float, scale: float) -> float:
    """Compute the force [N] of the gastrocnemius.

    Args:
        plantarflexion_moment: Net moment of the muscles at the ankle [N m].
        ankle: Dorsiflexion [rad].
        scale: Ratio of the person's moment arms to the published ones.
    """
    return max(plantarflexion_moment, 0.0) * GASTROCNEMIUS_SHARE / (scale * arm(ACHILLES, ankle))


def muscles_of(extension_moment: float, flexion: float, gastrocnemius: float, floor: float, scale: float) -> Muscles:
    """Compute the forces of the muscles that balance a moment at the knee.

    Args:
        extension_moment: Net moment of the muscles at the knee [N m].
        flexion: Flexion angle [rad].
        gastrocnemius: Force of the gastrocnemius [N], see `gastrocnemius_of`.
        floor: The least force [N] of extensors and flexors together.
        scale: Ratio of the person's moment arms to the published ones.
    """
    extensor, flexor, calf = (scale * arm(muscle, flexion) for muscle in (QUADRICEPS, HAMSTRINGS, GASTROCNEMIUS))
    moment, half = extension_moment + calf * gastrocnemius, 0.5 * floor
    hamstrings = max(half - gastrocnemius, 0.0)
    quadriceps = (moment + flexor * hamstrings) / extensor
    if quadriceps < half:
        quadriceps = half
        hamstrings = max((extensor * half - moment) / flexor, hamstrings)
    return Muscles(quadriceps, hamstrings, gastrocnemius)
