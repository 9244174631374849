"""The forces of the muscles at the knee that hold a net moment.

One number cannot tell several forces. The rule: the gastrocnemius takes a fixed part of the plantarflexion moment;
of extensors and flexors none pulls with less than half of a floor, which is what antagonists do beyond any need (tone,
and co-contraction that grows with the ground's force); beyond that only the side that is needed pulls.
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
    """Forces [N] >= 0 along the tibia: the tendons lie within 20 degrees of it, where their cosine is above 0.94."""

    quadriceps: float
    """By the patellar tendon"""
    hamstrings: float
    gastrocnemius: float

    @property
    def total(self) -> float:
        """[N] with which they press femur and tibia together."""
        return self.quadriceps + self.hamstrings + self.gastrocnemius


def gastrocnemius_of(plantarflexion_moment: float, ankle: float, scale: float) -> float:
    """Force [N] of the gastrocnemius at a net plantarflexion moment [N m] and a dorsiflexion [rad]."""
    return max(plantarflexion_moment, 0.0) * GASTROCNEMIUS_SHARE / (scale * arm(ACHILLES, ankle))


def muscles_of(extension_moment: float, flexion: float, gastrocnemius: float, floor: float, scale: float) -> Muscles:
    """Forces of the muscles that hold a moment.

    Args:
        extension_moment: [N m] net of all muscles at the knee.
        flexion: [rad].
        gastrocnemius: [N] what the ankle asks of it.
        floor: [N] with which antagonists pull at least, both sides together.
        scale: of the person's moment arms to those of the table.
    """
    extensor, flexor, calf = (scale * arm(muscle, flexion) for muscle in (QUADRICEPS, HAMSTRINGS, GASTROCNEMIUS))
    moment, half = extension_moment + calf * gastrocnemius, 0.5 * floor
    hamstrings = max(half - gastrocnemius, 0.0)
    quadriceps = (moment + flexor * hamstrings) / extensor
    if quadriceps < half:
        quadriceps = half
        hamstrings = max((extensor * half - moment) / flexor, hamstrings)
    return Muscles(quadriceps, hamstrings, gastrocnemius)
