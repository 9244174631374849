"""A walk whose joint reaction is known, whoever measured or computed it, and what the estimator makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.leg import Joints, NetMoments
from knee_contact_ros.joint_reaction.muscles import Person, reaction_of
from knee_contact_ros.parameters.schema import PersonParameters
from studies.validation.data import ON_PLATE

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Constants(NamedTuple):
    """Personal constants of the muscles, as in `Person`."""

    moment_arm_scale: float
    co_contraction: float
    tone: float


def _defaults() -> Constants:
    person = PersonParameters()
    return Constants(person.moment_arm_scale, person.co_contraction, person.tone)


DEFAULTS = _defaults()
"""Constants by the default parameters"""
PUBLISHED = DEFAULTS._replace(moment_arm_scale=1.0)
"""Default constants with the published moment arms"""


class Walk(NamedTuple):
    """One leg in one trial, at n samples."""

    name: str
    mass: float
    """Mass [kg]"""
    height: float
    """Height [m]"""
    time: Floats
    """Times [s], shape (n,)"""
    vertical: Floats
    """Vertical ground force [N], shape (n,)"""
    joints: Sequence[Joints]
    """Joint angles and velocities, length n"""
    nets: Mapping[str, Sequence[NetMoments]]
    """Net moments by level, length n each"""
    reference: Floats
    """Axial force of the knee [N], compression positive, shape (n,)"""
    used: Flags
    """Samples that are judged and fitted to, shape (n,)"""

    @property
    def weight(self) -> float:
        """Body weight [N]."""
        return self.person(DEFAULTS).weight

    def person(self, constants: Constants) -> Person:
        """Person of this walk with constants."""
        return Person(self.mass, self.height, *constants)

    @property
    def stance(self) -> Flags:
        """Whether the foot is on the ground, shape (n,)."""
        on: Flags = self.vertical > ON_PLATE
        return on

    def steps(self) -> list[tuple[int, int]]:
        """First sample of every stance and the first one behind it, for whole stances whose samples are all used."""
        on = self.stance
        strikes = np.flatnonzero(on[1:] & ~on[:-1]) + 1
        leaves = np.flatnonzero(~on[1:] & on[:-1]) + 1
        pairs = [(int(first), int(leaves[leaves > first][0])) for first in strikes if (leaves > first).any()]
        return [(first, last) for first, last in pairs if self.used[first:last].all()]


def axial(walk: Walk, level: str, constants: Constants) -> Floats:
    """Joint reaction [N] of a walk by a level, shape (n,): `reaction_of`, sample by sample."""
    person = walk.person(constants)
    rows = zip(walk.joints, walk.nets[level], walk.vertical.tolist(), strict=True)
    return np.array([reaction_of(person, joints, net, vertical).axial for joints, net, vertical in rows])
