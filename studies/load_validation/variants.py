"""Other rules than that of `joint_reaction/muscles.py`, as they were tried before it stayed as it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.moment_arms import (
    ACHILLES,
    GASTROCNEMIUS,
    GASTROCNEMIUS_SHARE,
    HAMSTRINGS,
    QUADRICEPS,
    arm,
)
from knee_contact_ros.joint_reaction.muscles import muscles_of
from studies.load_validation.walks import Constants, Floats, Walk

COSINE = math.cos(math.radians(20.0))
COACTIVE = 0.2
"""Of what the agonist does beyond the floor, that the antagonist does as well"""


class Held(NamedTuple):
    """What muscles have to hold, and how."""

    extension: float
    """[N m]"""
    flexion: float
    """[rad]"""
    calf: float
    """[N] of the gastrocnemius"""
    floor: float
    """[N]"""
    scale: float
    """Of the moment arms"""

    def arms(self) -> tuple[float, float]:
        """[m] of extensors and flexors."""
        return self.scale * arm(QUADRICEPS, self.flexion), self.scale * arm(HAMSTRINGS, self.flexion)

    def alone(self) -> float:
        """[N] of the side that is needed, without a floor and without the gastrocnemius' own."""
        extensor, flexor = self.arms()
        moment = self.extension + self.scale * arm(GASTROCNEMIUS, self.flexion) * self.calf
        return moment / extensor if moment > 0.0 else -moment / flexor


Rule = Callable[[Held], float]
"""[N] with which muscles press"""


def shipped(held: Held) -> float:
    """The rule of the package."""
    return muscles_of(held.extension, held.flexion, held.calf, held.floor, held.scale).total


def at_least(held: Held) -> float:
    """The floor is one for all muscles together: nothing beyond the agonists, where they pull that much."""
    return max(held.alone() + held.calf, held.floor)


def on_top(held: Held) -> float:
    """The floor comes on top of the agonists."""
    return held.alone() + held.calf + held.floor


def coactive(held: Held) -> float:
    """Antagonists pull with a part of what the agonists do, and these hold it too."""
    extensor, flexor = held.arms()
    holding = held.extension + held.scale * arm(GASTROCNEMIUS, held.flexion) * held.calf
    antagonist_to_agonist = flexor / extensor if holding > 0.0 else extensor / flexor
    return shipped(held) + COACTIVE * held.alone() * (1.0 + antagonist_to_agonist)


def inclined(held: Held) -> float:
    """Tendons at 20 degrees to the tibia."""
    return COSINE * shipped(held)


def passive(held: Held) -> float:
    """What passive structures hold is no muscle's (Riener & Edrich 1999, doi:10.1016/S0021-9290(99)00009-3).

    Hip and ankle at 0 degrees.
    """
    degrees = math.degrees(held.flexion)
    flexing = math.exp(1.8 - 0.0352 * degrees) - math.exp(-3.971 + 0.0495 * degrees)
    flexing += math.exp(2.22 - 0.15 * degrees) - 4.82
    return shipped(held._replace(extension=held.extension + flexing))


class Variant(NamedTuple):
    """A rule, and what else is other with it."""

    name: str
    rule: Rule = shipped
    share: float = GASTROCNEMIUS_SHARE
    most_scale: float = 2.0

    @property
    def of_the_calf(self) -> bool:
        """Whether it is another one only where the ankle is known."""
        return self.share != GASTROCNEMIUS_SHARE


VARIANTS = (
    Variant("as it is"),
    Variant("moment arms of up to 3 times the published ones", most_scale=3.0),
    Variant("moment arms as published", most_scale=1.001),
    Variant("gastrocnemius share 0.2", share=0.2),
    Variant("gastrocnemius share 0.5", share=0.5),
    Variant("the floor is the least of all muscles together", at_least),
    Variant("the floor comes on top of the agonists", on_top),
    Variant(f"antagonists also pull with {COACTIVE:g} of what agonists do beyond the floor", coactive),
    Variant("tendons at 20° to the tibia", inclined),
    Variant("passive moment of the knee (Riener & Edrich 1999)", passive),
)


def force_by(variant: Variant, walk: Walk, level: str, constants: Constants) -> Floats:
    """The axial force [N], shape (n,), as `walks.axial` gives it, by a variant's rule."""
    person, found = walk.person(constants), []
    for joints, net, vertical in zip(walk.joints, walk.nets[level], walk.vertical.tolist(), strict=True):
        ankle = joints.ankle if math.isfinite(joints.ankle) else 0.0
        plantarflexion = max(net.plantarflexion, 0.0) if math.isfinite(net.plantarflexion) else 0.0
        calf = plantarflexion * variant.share / (person.moment_arm_scale * arm(ACHILLES, ankle))
        held = Held(net.extension, joints.flexion, calf, person.floor(vertical), person.moment_arm_scale)
        found.append(net.compression + variant.rule(held))
    return np.array(found)
