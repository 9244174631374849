"""Rules that were tried instead of that of `joint_reaction/muscles.py`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.muscles import (
    ACHILLES,
    GASTROCNEMIUS,
    GASTROCNEMIUS_SHARE,
    HAMSTRINGS,
    QUADRICEPS,
    arm,
    muscles_of,
)
from studies.load_validation.walks import Constants, Floats, Walk

COSINE = math.cos(math.radians(20.0))
COACTIVE = 0.2
"""Part of the agonist's force beyond the floor that the antagonist exerts as well"""


class Held(NamedTuple):
    """Moment that muscles must balance, and the constants of the person."""

    extension: float
    """Net extending moment [N m]"""
    flexion: float
    """Flexion angle [rad]"""
    calf: float
    """Force of the gastrocnemius [N]"""
    floor: float
    """Least force of the muscles [N]"""
    scale: float
    """Scale of the moment arms"""

    def arms(self) -> tuple[float, float]:
        """Moment arms of extensors and flexors [m]."""
        return self.scale * arm(QUADRICEPS, self.flexion), self.scale * arm(HAMSTRINGS, self.flexion)

    def alone(self) -> float:
        """Force [N] of the side that is needed, without a floor and without the gastrocnemius' own."""
        extensor, flexor = self.arms()
        moment = self.extension + self.scale * arm(GASTROCNEMIUS, self.flexion) * self.calf
        return moment / extensor if moment > 0.0 else -moment / flexor


Rule = Callable[[Held], float]
"""Force [N] with which muscles compress the knee, as a function of the moment that they hold"""


def shipped(held: Held) -> float:
    """The rule of the package."""
    return muscles_of(held.extension, held.flexion, held.calf, held.floor, held.scale).total


def at_least(held: Held) -> float:
    """The floor counts for all muscles together: there is no force beyond the agonists' where they pull that much."""
    return max(held.alone() + held.calf, held.floor)


def on_top(held: Held) -> float:
    """The floor is added to the agonists' force."""
    return held.alone() + held.calf + held.floor


def coactive(held: Held) -> float:
    """Antagonists pull with a part of the agonists' force, which must balance these too."""
    extensor, flexor = held.arms()
    holding = held.extension + held.scale * arm(GASTROCNEMIUS, held.flexion) * held.calf
    antagonist_to_agonist = flexor / extensor if holding > 0.0 else extensor / flexor
    return shipped(held) + COACTIVE * held.alone() * (1.0 + antagonist_to_agonist)


def inclined(held: Held) -> float:
    """Tendons are inclined to the tibia by 20 degrees."""
    return COSINE * shipped(held)


def passive(held: Held) -> float:
    """Passive structures bear a part of the moment (Riener & Edrich 1999, doi:10.1016/S0021-9290(99)00009-3).

    Hip and ankle at 0 degrees.
    """
    degrees = math.degrees(held.flexion)
    flexing = math.exp(1.8 - 0.0352 * degrees) - math.exp(-3.971 + 0.0495 * degrees)
    flexing += math.exp(2.22 - 0.15 * degrees) - 4.82
    return shipped(held._replace(extension=held.extension + flexing))


class Variant(NamedTuple):
    """A rule, and the other changes that belong to it."""

    name: str
    rule: Rule = shipped
    share: float = GASTROCNEMIUS_SHARE
    most_scale: float = 2.0

    @property
    def of_the_calf(self) -> bool:
        """Whether it differs only where the ankle is known."""
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
